"""Files with all poses of a data set: TUM, KITTI, EuRoC csv, SceneNN .log, ARKitScenes .traj."""

from __future__ import annotations

from dataclasses import dataclass
import logging
from pathlib import Path
import re

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import canonical, numbers_of, read_lines, read_text
from persem_ros.convert.poses import pose_of_numbers, Poses
from persem_ros.convert.stamps import number_of_name, seconds_to_ns, stamp_of_name
from persem_ros.core.transforms import inverse, matrix_to_quaternion, transform
from persem_ros.errors import PersemError

LOG = logging.getLogger(__name__)
X_FIRST, W_FIRST = 'x y z w', 'w x y z'
DIGITS = 19         # of nanoseconds since 1970
EUROC = 17          # columns: stamp, position, quaternion, velocity and two biases
Row = tuple[int, list[str]]
Matrices = list[NDArray[np.float64] | None]


@dataclass
class Header:
    """What a trajectory says of itself: order of quaternions ('' unsaid), unit of stamps."""

    order: str = ''
    nanoseconds: bool = False


def poses_from_trajectory(path: Path, keys: list[str], stamped: bool) -> Poses:
    """
    Return the Poses of a file with all poses.

    Parameters
    ----------
    path : Path
        Lines of "stamp x y z qx qy qz qw" (TUM; w first where the comment in front says so),
        "ns x y z qw qx qy qz …" (EuRoC, .csv), "stamp" with an axis-angle rotation (rad) and a
        translation, both from world to camera (ARKitScenes, .traj), "number x y z qx qy qz qw",
        or 12, 16 or 7 numbers in the order of the frames (KITTI); or blocks of "i i i+1" and
        a 4x4 matrix (SceneNN, .log).
    keys : list of str
        The frames, in order.
    stamped : bool
        Whether the frames have stamps of their own that a trajectory's can be compared with.

    Returns
    -------
    Poses
        From camera to world for .traj; for the others as the file has them.

    Raises
    ------
    PersemError
        When the lines are of different length, hold no poses or do not fit to the frames.

    """
    path = Path(path)
    rows, header = _table(path)
    if _is_log(rows):
        return _poses_of_log(path, rows, keys)
    if len({len(words) for _, words in rows}) > 1:
        raise PersemError(f'{path}: lines of different length; expected the same numbers in each')
    if path.suffix == '.traj' and len(rows[0][1]) == 7:
        return _stamped(path, [words[0] for _, words in rows], _axis_angle(path, rows))
    rows, order, said, nanoseconds = _quaternions(path, rows, header)
    poses = _poses(path, rows, keys, stamped, nanoseconds)
    poses.order = order
    if order and not said:
        poses.other = _reordered(poses)
    return poses


def _table(path: Path) -> tuple[list[Row], Header]:
    """Return the rows of numbers, and what the first line says where it names the columns."""
    first = next((line for line in read_text(path).splitlines() if line.strip()), '')
    names = re.split(r'[\s,#]+', first.lower())
    found = ''.join(m[1] for m in (re.fullmatch(r'q(?:_?|_\w+_)([wxyz])', name)
                                   for name in names) if m)
    order = {'xyzw': X_FIRST, 'wxyz': W_FIRST}.get(found, '')
    rows = read_lines(path)
    if order and not first.lstrip().startswith('#'):
        rows = rows[1:]
    if not rows:
        raise PersemError(f'{path}: no poses below its first line')
    return rows, Header(order, '[ns]' in first.lower())


def _quaternions(path: Path, rows: list[Row], header: Header) -> tuple[list[Row], str, bool, bool]:
    """
    Return rows whose quaternions are x y z w, and how they were found.

    Returns
    -------
    list of Row
        EuRoC's without what follows the pose.
    str
        The order in the file, '' without quaternions.
    bool
        Whether the header says so.
    bool
        Whether stamps are nanoseconds.

    """
    width = len(rows[0][1])
    csv = path.suffix == '.csv' and all(re.fullmatch(r'\d{13,19}', row[0]) for _, row in rows)
    if width == EUROC and (header.order or csv and rows[0][1][13:] != ['0', '0', '0', '1']):
        rows, width = [(number, row[:8]) for number, row in rows], 8
    if width not in (7, 8):
        return rows, '', True, header.nanoseconds
    order = header.order or (W_FIRST if csv and width == 8 else X_FIRST)
    if order == W_FIRST:
        rows = [(number, [*row[:-4], *row[-3:], row[-4]]) for number, row in rows]
        LOG.info('%s: quaternions are read in the order w x y z', path)
    return rows, order, bool(header.order), header.nanoseconds or csv and width == 8


def _reordered(poses: Poses) -> Poses:
    """Return the same poses with their quaternions read in the other order."""
    order = W_FIRST if poses.order == X_FIRST else X_FIRST
    shift = -1 if order == W_FIRST else 1

    def turned(T: NDArray[np.float64]) -> NDArray[np.float64]:
        return transform(T[:3, 3], np.roll(matrix_to_quaternion(T[:3, :3]), shift))

    return Poses({key: turned(T) for key, T in poses.by_key.items()}, poses.stamps,
                 [turned(T) for T in poses.matrices], poses.lost, order)


def _poses(path: Path, rows: list[Row], keys: list[str], stamped: bool,
           nanoseconds: bool) -> Poses:
    """Return the Poses of lines with a tag and a pose, or a pose alone."""
    tagged = len(rows[0][1]) in (8, 13, 17)
    tags = [words[0] for _, words in rows] if tagged else None
    matrices = [pose_of_numbers(numbers_of(words[tagged:], f'{path}, line {number}'),
                                f'{path}, line {number}') for number, words in rows]
    if tags is not None and (nanoseconds or stamped or not all(t.isdecimal() for t in tags)):
        return _stamped(path, tags, matrices, nanoseconds)
    return _numbered(tags or _tags_of_lines(path, len(rows), keys), matrices, keys)


def _numbered(tags: list[str], matrices: Matrices, keys: list[str]) -> Poses:
    """Return the Poses of the frames that *tags* name."""
    known = {canonical(key): key for key in keys}
    if not any(canonical(tag) in known for tag in tags):    # 'frame-000005' and '5'
        known = {str(number_of_name(key)): key for key in keys}
    poses = Poses()
    for tag, T in zip(tags, matrices, strict=True):
        key = known.get(canonical(tag))
        if key is not None:
            poses.add(key, T)
    return poses


def _is_log(rows: list[Row]) -> bool:
    """Return whether rows are blocks of three integers and a 4x4 matrix."""
    lengths = [len(words) for _, words in rows]
    return len(rows) % 5 == 0 and lengths == [3, 4, 4, 4, 4] * (len(rows) // 5)


def _poses_of_log(path: Path, rows: list[Row], keys: list[str]) -> Poses:
    """Return the Poses of a SceneNN .log; frames are told by the number in their names."""
    numbers = {number_of_name(key): key for key in keys}
    heads = [numbers_of(words, f'{path}, line {number}').astype(int).tolist()
             for number, words in rows[::5]]
    # Images of SceneNN count from 1, the blocks from 0: their third number is the image's.
    by_third = max((n for n in numbers if n is not None), default=0) > max(h[0] for h in heads)
    if by_third:
        LOG.info('%s: frames count from 1: the third number of a block is the frame', path)
    poses = Poses()
    for i, head in enumerate(heads):
        key = numbers.get(head[2 if by_third else 0])
        where = f'{path}, line {rows[5 * i + 1][0]}'
        words = [word for _, line in rows[5 * i + 1:5 * i + 5] for word in line]
        if key is not None:
            poses.add(key, pose_of_numbers(numbers_of(words, where), where))
    return poses


def _axis_angle(path: Path, rows: list[Row]) -> Matrices:
    """Return T_world_camera of ARKitScenes' lines, which hold T_camera_world; None if lost."""
    matrices: Matrices = []
    for number, words in rows:
        values = numbers_of(words[1:], f'{path}, line {number}')
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(values[:3])[0], values[3:]
        matrices.append(inverse(T) if np.isfinite(values).all() else None)
    return matrices


def _stamped(path: Path, tags: list[str], matrices: Matrices, nanoseconds: bool = False) -> Poses:
    """Return the Poses of a trajectory with stamps; the first of two equal stamps counts."""
    poses = Poses()
    order: dict[int, NDArray[np.float64]] = {}
    for tag, T in zip(tags, matrices, strict=True):
        stamp = _stamp(tag, nanoseconds, path)
        if T is None:
            poses.lost.append(tag)
        else:
            order.setdefault(stamp, T)
    poses.stamps = sorted(order)
    poses.matrices = [order[stamp] for stamp in poses.stamps]
    repeated = len(matrices) - len(order) - len(poses.lost)
    if repeated:
        LOG.warning('%s: %d poses repeat a stamp; the first of each counts', path, repeated)
    return poses


def _stamp(tag: str, nanoseconds: bool, path: Path) -> int:
    """Return a stamp in ns: digits as in file names, else seconds."""
    if nanoseconds and tag.isdecimal():
        if len(tag) > DIGITS:
            raise PersemError(f'{path}: expected nanoseconds of up to {DIGITS} digits, got '
                              f'{tag[:60]!r}')
        return int(tag)
    named = stamp_of_name(tag) if tag.isdecimal() else None
    return seconds_to_ns(tag, str(path)) if named is None else int(named)


def _tags_of_lines(path: Path, count: int, keys: list[str]) -> list[str]:
    """Return the frame that each line of a file without stamps belongs to."""
    if count == len(keys):
        return keys
    numbers = [number_of_name(key) for key in keys]
    if all(key.isdecimal() for key in keys) and max(n or 0 for n in numbers) < count:
        return [str(i) for i in range(count)]
    raise PersemError(f'{path}: {count} poses for {len(keys)} frames; expected one a line and '
                      'frame, or stamps in front (TUM format)')
