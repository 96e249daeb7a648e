"""Conventions of pose files, and a check that depth images agree under the chosen one."""

from itertools import product
import logging

import numpy as np
from persem_ros.core.transforms import inverse

LOG = logging.getLogger(__name__)
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
WORST = 0.1         # relative depth error at which a pixel counts as a miss
PIXELS = 5000       # looked at per pair


def optical_pose(T, direction='camera-to-world', axes='opencv', world='enu'):
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


def pairs_to_check(count, anchors=8, steps=(1, 3, 8)):
    """Return index pairs, spread over *count* frames, near enough to overlap."""
    starts = np.unique(np.linspace(0, max(count - 2, 0), anchors).astype(int))
    return [(int(i), int(i) + step) for i in starts for step in steps if i + step < count]


def reprojection_error(depth_i, depth_j, T_j_i, K):
    """
    Return how badly the depth of frame i, seen from frame j, agrees with that of frame j.

    Parameters as of misses().

    Returns
    -------
    ndarray, shape (N,), float64
        Relative depth error per pixel with a measurement, cut at WORST, which is also what
        leaves the image; pixels that meet no measurement are left out.

    """
    error = misses(depth_i, depth_j, T_j_i, K)
    return np.minimum(error[~np.isnan(error)], WORST)


def misses(depth_i, depth_j, T_j_i, K):
    """
    Return the relative depth errors of frame i, seen from frame j.

    Parameters
    ----------
    depth_i, depth_j : ndarray, shape (H, W), float64
        Metres, 0 is no measurement.
    T_j_i : ndarray, shape (4, 4)
        Maps optical points of i to j.
    K : ndarray, shape (3, 3)
        Pinhole matrix of both.

    Returns
    -------
    ndarray, shape (N,), float64
        Of the pixels of i with a measurement, some PIXELS of them, which ones depends on
        *depth_i* alone; infinite for what leaves the image, NaN for what meets no measurement.

    """
    height, width = depth_i.shape
    stride = max(1, int(np.sqrt(depth_i.size / PIXELS)))
    v, u = np.mgrid[:height:stride, :width:stride].reshape(2, -1)
    d = depth_i[v, u]
    u, v, d = u[d > 0], v[d > 0], d[d > 0]
    x, y, z = T_j_i[:3, :3] @ (np.linalg.inv(K) @ (np.stack([u, v, np.ones(len(u))]) * d)) \
        + T_j_i[:3, 3:]
    ahead = z > 1e-6
    with np.errstate(divide='ignore', invalid='ignore'):
        u = np.where(ahead, K[0, 0] * x / z + K[0, 2], -1.0)
        v = np.where(ahead, K[1, 1] * y / z + K[1, 2], -1.0)
    seen = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    error = np.full(len(d), np.inf)
    hit = depth_j[np.rint(v[seen]).astype(int), np.rint(u[seen]).astype(int)]
    miss = np.abs(z[seen] - hit) / np.maximum(hit, 1e-6)
    error[seen] = np.where(hit > 0, miss, np.nan)
    return error


def compare_conventions(depths, poses, K, axes_only=None):
    """
    Return {(direction, axes): mean relative error} of all conventions.

    Parameters
    ----------
    depths : dict of int to ndarray, shape (H, W), float64
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
    result = {}
    for direction, axes in axes_only or product(DIRECTIONS, CAMERA_AXES):
        T = {i: optical_pose(poses[i], direction, axes) for i in depths}
        errors = [reprojection_error(depths[i], depths[j], inverse(T[j]) @ T[i], K)
                  for i, j in pairs]
        errors = np.concatenate(errors) if errors else np.empty(0)
        if errors.size:
            result[direction, axes] = float(errors.mean())
    return result


def judge(errors, direction, axes):
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
    best = min(errors, key=errors.get)
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
