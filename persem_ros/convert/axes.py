"""Conventions of pose files, and a check that depth images agree under the chosen one."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
import logging

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.agreement import missed, pairs_to_check, unprojected, WORST
from persem_ros.core.transforms import inverse

LOG = logging.getLogger(__name__)
CLEAR = 0.7         # of the error, that another reading of the poses must leave at most
DIRECTIONS = ('camera-to-world', 'world-to-camera')
# Points of the optical frame (x right, y down, z forward) to the camera axes of the files.
CAMERA_AXES = {
    'opencv': np.eye(3),
    'opengl': np.diag([1.0, -1.0, -1.0]),                       # x right, y up, z back
    'ned': np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),       # x forward, y right, z down
}
WORLD_AXES = {
    'enu': np.eye(3),                                           # z up: as it is
    'ned': np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),      # z down: to east, north, up
    'opencv': np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),   # y down: to right, forward, up
}


def optical_pose(T: NDArray[np.float64], direction: str = 'camera-to-world', axes: str = 'opencv',
                 world: str = 'enu') -> NDArray[np.float64]:
    """
    Return T_map_camera of a pose as its file has it.

    Parameters
    ----------
    T : ndarray, shape (4, 4)
        The pose of the file.
    direction : str
        One of DIRECTIONS: what *T* maps.
    axes, world : str
        Keys of CAMERA_AXES and WORLD_AXES: the axes of the file's camera and world.

    Returns
    -------
    ndarray, shape (4, 4)
        Maps points of the optical frame to the map, z up.

    """
    T = inverse(T) if direction == 'world-to-camera' else np.array(T, float)
    T[:3, :3] = T[:3, :3] @ CAMERA_AXES[axes]
    T[:3] = WORLD_AXES[world] @ T[:3]
    return T


def compare_conventions(depths: dict[int, NDArray[np.float64]],
                        poses: dict[int, NDArray[np.float64]], K: NDArray[np.float64],
                        axes_only: Iterable[tuple[str, str]] | None = None
                        ) -> dict[tuple[str, str], float]:
    """
    Return {(direction, axes): mean relative error} of all conventions.

    Parameters
    ----------
    depths : dict of int to ndarray, shape (H, W)
        Metres, per frame.
    poses : dict of int to ndarray, shape (4, 4)
        As the files have them, per frame.
    K : ndarray, shape (3, 3)
        Pinhole matrix.
    axes_only : iterable of (direction, axes), optional
        The conventions to try; all by default.

    """
    count = max(depths) + 1 if depths else 0
    pairs = [(i, j) for i, j in pairs_to_check(count) if i in depths and j in depths]
    points = {i: unprojected(depths[i], K) for i in {i for i, _ in pairs}}
    result = {}
    for direction, axes in axes_only or product(DIRECTIONS, CAMERA_AXES):
        T = {i: optical_pose(poses[i], direction, axes) for i in depths}
        errors = [missed(points[i], depths[j], inverse(T[j]) @ T[i], K) for i, j in pairs]
        every = np.concatenate(errors) if errors else np.empty(0)
        every = np.minimum(every[~np.isnan(every)], WORST)
        if every.size:
            result[direction, axes] = float(every.mean())
    return result


def fits_better(depths: dict[int, NDArray[np.float64]], those: dict[int, NDArray[np.float64]],
                these: dict[int, NDArray[np.float64]], K: NDArray[np.float64],
                convention: tuple[str, str]) -> bool:
    """
    Return whether *those* poses fit clearly better than *these* do under any convention.

    Parameters
    ----------
    depths, K
        Of compare_conventions().
    those, these : dict of int to ndarray, shape (4, 4)
        Two readings of the same poses.
    convention : (direction, axes)
        What holds for *those*.

    """
    error = compare_conventions(depths, those, K, [convention]).get(convention, np.inf)
    errors = compare_conventions(depths, these, K)
    return bool(errors) and error < CLEAR * min(errors.values()) and error < 0.7 * WORST


def judge(errors: dict[tuple[str, str], float], direction: str, axes: str) -> str:
    """
    Say what the comparison means for the convention in use.

    Returns
    -------
    str
        'unknown' (nothing to compare), 'agrees', 'same' (the motion does not tell conventions
        apart), 'wrong' (another one fits better, a warning names it) or 'none' (none fits, a
        warning says so).

    """
    if (direction, axes) not in errors:
        LOG.info('the axes were not checked: no two frames with depth to compare')
        return 'unknown'
    mine = errors[direction, axes]
    best = min(errors, key=errors.__getitem__)
    if errors[best] < 0.8 * mine and mine - errors[best] > 1e-3:
        flags = [f'--{name} {value}' for name, value, now in
                 (('pose-is', best[0], direction), ('axes', best[1], axes)) if value != now]
        LOG.warning(
            'the camera axes look wrong: depth of one frame misses that of another by %.1f %%, '
            'but by %.1f %% with %s', 100 * mine, 100 * errors[best], ' '.join(flags))
        return 'wrong'
    if mine > 0.7 * WORST:
        LOG.warning(
            'depth images do not agree with each other under any camera axes (%.1f %% or more '
            'off): check --depth-unit, --intrinsics, the stamps and the poses', 100 * mine)
        return 'none'
    others = [error for key, error in errors.items() if key != (direction, axes)]
    if others and min(others) < 1.1 * mine + 1e-4:
        LOG.info('the camera axes cannot be told from the motion: other conventions fit as well')
        return 'same'
    LOG.info('the camera axes agree: depth of one frame meets that of another within %.1f %%',
             100 * mine)
    return 'agrees'
