"""Poses and intrinsics of Forest Inspection: AirSim's records and WildUAV's metadata."""

from __future__ import annotations

from collections.abc import Iterator
import json
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import canonical, numbers_of, read_text
from persem_ros.convert.poses import Poses, rigid
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from pathlib import Path

AIRSIM = ('POS_X', 'POS_Y', 'POS_Z', 'Q_W', 'Q_X', 'Q_Y', 'Q_Z', 'ImageFile')


def is_airsim(path: Path) -> bool:
    """Return whether a text file is a recording of AirSim (airsim_rec.txt)."""
    return read_text(path).split('\n', 1)[0].split()[-1:] == ['ImageFile']


def airsim_poses(path: Path, pitch: float = 0.0) -> Poses:
    """
    Return the Poses of AirSim's airsim_rec.txt by the name of the image, without its ending.

    Parameters
    ----------
    path : Path
        Lines of words, the names of the columns first.
    pitch : float
        Of the camera on the vehicle, degrees, positive is up: the record has the vehicle's pose.

    """
    lines = [line.split() for line in read_text(path).splitlines() if line.strip()]
    head, poses = lines[0], Poses()
    missing = [name for name in AIRSIM if name not in head]
    if missing:
        raise PersemError(f'{path}: expected the columns {", ".join(AIRSIM)}; no '
                          f'{", ".join(missing)}')
    half = np.radians(pitch) / 2
    T_body_camera = transform(np.zeros(3), [0.0, np.sin(half), 0.0, np.cos(half)])
    for number, words in enumerate(lines[1:], 2):
        if len(words) != len(head):
            raise PersemError(f'{path}, line {number}: expected {len(head)} words, got '
                              f'{len(words)}')
        row = dict(zip(head, words))
        x, y, z, qw, qx, qy, qz = numbers_of([row[name] for name in AIRSIM[:7]],
                                             f'{path}, line {number}')
        norm = np.linalg.norm([qx, qy, qz, qw])
        if not abs(norm - 1) <= 1e-2:
            raise PersemError(f'{path}, line {number}: expected a quaternion of norm 1, got '
                              f'{norm:.3g}')
        T = transform([x, y, z], np.array([qx, qy, qz, qw]) / norm) @ T_body_camera
        # AirSim separates several images by semicolons; all have one name but for a prefix.
        for image in row['ImageFile'].split(';'):
            poses.by_key[image.rpartition('/')[2].rpartition('.')[0]] = T
    return poses


def metadata_poses(files: dict[str, Path]) -> tuple[Poses, dict[str, NDArray[np.float64]]]:
    """
    Return (Poses, {key: K}) of WildUAV's metadata, {key: path} of one JSON file per image.

    The names of the entries are not documented, so they are told by their content: K is 3 x 3
    and upper triangular, the rotation is one, the translation has three numbers. Matrices are
    stored column by column; the rotation maps camera to world.

    """
    poses, intrinsics = Poses(), {}
    for key, path in files.items():
        try:
            content = json.loads(read_text(path))
        except (ValueError, RecursionError):
            raise PersemError(f'{path}: expected JSON') from None
        R: NDArray[np.float64] | None = None
        K: NDArray[np.float64] | None = None
        t: NDArray[np.float64] | None = None
        for values in _arrays(content):
            if values.size == 3 and t is None:
                t = values
            elif values.size == 9:
                matrix = values.reshape(3, 3).T         # column by column
                if np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-2):
                    R = matrix if R is None else R
                elif np.allclose(matrix[2], [0, 0, 1]) and matrix[0, 0] > 0:
                    K = matrix if K is None else K
        if R is None or t is None or K is None:
            missing = [name for name, value in (
                ('rotation of 9 numbers', R), ('translation of 3 numbers', t),
                ('camera matrix of 9 numbers', K)) if value is None]
            raise PersemError(f'{path}: found no {" and no ".join(missing)}; matrices are stored '
                              'column by column')
        poses.by_key[key] = rigid(np.column_stack([R, t]), path)
        intrinsics[key] = K
    return poses, intrinsics


def _arrays(content: object) -> Iterator[NDArray[np.float64]]:
    """Yield every list of numbers in parsed JSON, nested ones flat, in the file's order."""
    values = content.values() if isinstance(content, dict) else \
        content if isinstance(content, list) else ()
    if isinstance(content, list):
        try:
            yield np.array(content, float).ravel()
            return
        except (ValueError, TypeError, OverflowError):
            pass
    for value in values:
        yield from _arrays(value)


def pose_of_image(poses: Poses, key: str) -> NDArray[np.float64] | None:
    """Return the pose of an image, by its name or by its number; None where there is none."""
    if key in poses.by_key:
        return poses.by_key[key]
    names = {canonical(name): name for name in poses.by_key}
    name = names.get(canonical(key))
    return None if name is None else poses.by_key[name]


def fov_matrix(width: int, height: int, fov: float) -> NDArray[np.float64]:
    """Return the pinhole matrix of a horizontal field of view in degrees, centred."""
    f = width / 2 / np.tan(np.radians(fov) / 2)
    return np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])
