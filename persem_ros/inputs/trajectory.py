"""Corrected trajectories on their way in: files of TUM lines, and nav_msgs/Path."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.trajectory import Trajectory
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.guard.words import short
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.decode.pose_messages import unit_quaternion

PATH = 'nav_msgs/msg/Path'
LINE = 'stamp x y z qx qy qz qw'
LATEST = 1 << 62        # ns, beyond which no stamp can lie
FARTHEST = 1e12         # m, beyond which no pose can


def from_tum(path: str | Path) -> Trajectory:
    """
    Return the Trajectory in a file of lines "stamp x y z qx qy qz qw" (TUM), stamps in seconds.

    Raises
    ------
    PersemError
        Where the file cannot be read, or a line is no pose or not later than the one before.

    """
    try:
        text = Path(path).read_text(encoding='utf-8')
    except OSError as error:
        raise PersemError(f'{path}: cannot be read ({error.strerror}); expected a trajectory, '
                          f'lines of {LINE!r}') from None
    except UnicodeDecodeError:
        raise PersemError(f'{path}: not a text file; expected a trajectory, lines of '
                          f'{LINE!r}') from None
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split('#')[0].replace(',', ' ').split()
        if words:
            rows.append((f'{path}, line {number}', words))
    stamps, poses = [], []
    for where, words in rows:
        if len(words) != 8:
            raise PersemError(f'{where}: expected {LINE!r}, got {len(words)} '
                              f'word{"s" if len(words) > 1 else ""}')
        stamps.append(_nanoseconds(words[0], where))
        poses.append(pose_of_numbers([_number(word, where) for word in words[1:]], where))
    return _checked(stamps, poses, [where for where, _ in rows], str(path))


def from_path(msg: Any, map_frame: str, topic: str) -> Trajectory:
    """
    Return the Trajectory in a nav_msgs/Path.

    Parameters
    ----------
    msg : Path
        Each of its poses has its own stamp.
    map_frame : str
        The frame that they have to be in, frames.map.
    topic : str
        For people.

    Raises
    ------
    PersemError
        Where it cannot be used: one sentence.

    """
    names = {messages.frame_id(msg), *(messages.frame_id(pose) for pose in msg.poses)} \
        - {'', map_frame.lstrip('/')}
    if names:
        raise PersemError(f'{topic}: the path is in the frame {short(sorted(names)[0])}, the map '
                          f'in {map_frame!r}; publish it in that frame')
    stamps, poses, places = [], [], []
    for number, item in enumerate(msg.poses):
        where = f'{topic}, pose {number}'
        p, q = item.pose.position, item.pose.orientation
        stamps.append(messages.stamp_ns(item))
        poses.append(pose_of_numbers([p.x, p.y, p.z, q.x, q.y, q.z, q.w], where))
        places.append(where)
    return _checked(stamps, poses, places, topic)


def pose_of_numbers(numbers: list[float], where: str) -> NDArray[np.float64]:
    """Return the 4x4 matrix of x y z qx qy qz qw."""
    if not all(map(math.isfinite, numbers)):
        raise PersemError(f'{where}: a pose that is not finite '
                          f'({" ".join(f"{x:g}" for x in numbers)})')
    if max(map(abs, numbers[:3])) > FARTHEST:
        raise PersemError(f'{where}: a position {max(map(abs, numbers[:3])):g} m away, expected '
                          f'up to {FARTHEST:g} m')
    try:
        x, y, z, *q = numbers
        return transform([x, y, z], unit_quaternion((q[0], q[1], q[2], q[3])))
    except BadMessage as fault:
        raise PersemError(f'{where}: {fault}') from None


def _checked(stamps: list[int], poses: list[NDArray[np.float64]], places: list[str],
             name: str) -> Trajectory:
    """Return the Trajectory of poses whose stamps ascend; refuse others."""
    if not stamps:
        raise PersemError(f'{name}: it holds no poses')
    for k in range(1, len(stamps)):
        if stamps[k] <= stamps[k - 1]:
            raise PersemError(f'{places[k]}: the stamp {stamps[k] / 1e9:.9f} s is not later than '
                              f'the one before ({stamps[k - 1] / 1e9:.9f} s); expected stamps '
                              'that ascend')
    return Trajectory(np.array(stamps, np.int64), np.stack(poses), name)


def _number(word: str, where: str) -> float:
    """Return a number, NaN and infinity among them."""
    try:
        return float(word)
    except ValueError:
        raise PersemError(f'{where}: expected a number, got {short(word)}') from None


def _nanoseconds(word: str, where: str) -> int:
    """Return a stamp in seconds as ns, all its digits kept."""
    try:
        stamp = Decimal(word).scaleb(9)
        if stamp.is_finite() and abs(stamp) < LATEST:
            return int(stamp.to_integral_value())
    except (InvalidOperation, OverflowError):
        pass
    raise PersemError(f'{where}: expected a stamp in seconds, got {short(word)}')
