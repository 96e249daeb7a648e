"""Points to voxels: which voxel of the map each point of a frame falls into (spec section 1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.errors import PersemError

NOWHERE = np.int64(-1)      # key of a point without a place
REACH = 1 << 20             # farthest voxel from the sensor's own, along each axis
LIMIT = 2.0 ** 31 - 2.0 ** 21           # voxel indices are int32, with room for the reach
STRETCH = 512               # points that are placed at once; what is known of them fits the L1


class Measured(NamedTuple):
    """
    What a sensor measured: points, or depths along rays.

    Attributes
    ----------
    points : ndarray, shape (3 N,) or (0,), float64
        x, y, z of each point, metres in the sensor frame; NaN or infinity: no measurement.
    depth : ndarray, shape (N,) or (0,), float64
        Where there are no points: metres along the optical axis.
    rays : ndarray, shape (2 N,) or (0,), float64
        x and y of each pixel at 1 m.
    low, high : float
        Depths that are measurements, both included.

    """

    points: NDArray[np.float64]
    depth: NDArray[np.float64]
    rays: NDArray[np.float64]
    low: float
    high: float

    @property
    def size(self) -> int:
        """Return N."""
        return len(self.points) // 3 + len(self.depth)


def measured_points(points: NDArray[np.float64]) -> Measured:
    """Return points, N * 3 numbers in any shape, as what a sensor measured."""
    none = np.empty(0)
    return Measured(np.require(points, np.float64, ('C', 'W')).reshape(-1), none, none, 0.0, 0.0)


def place(measured: Measured, T_map_sensor: NDArray[np.float64], voxel_size: float,
          origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
          ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """
    Return the voxel of each point as (keys, base); parameters as in core.frame.observe.observe().

    Returns
    -------
    keys : ndarray, shape (N,), int64
        Voxel index minus base plus 2 ** 20 per axis, 21 bits each; NOWHERE for none.
    base : ndarray, shape (3,), int64
        The sensor's own voxel.

    """
    pose, base = placing(T_map_sensor, voxel_size, origin)
    keys = np.empty(measured.size, np.int64)
    split(locate, len(keys), *measured, pose, base, float(voxel_size), keys, grain=32768)
    return keys, base.astype(np.int64)


def placing(T_map_sensor: NDArray[np.float64], voxel_size: float,
            origin: tuple[float, float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return what key_of() needs: the pose as 9 + 3 numbers, and the sensor's own voxel, float64.

    Raises
    ------
    PersemError
        When the sensor is so far away that voxel indices would not fit 32 bits.

    """
    T = np.asarray(T_map_sensor, np.float64)
    pose = np.concatenate([T[:3, :3].ravel(), T[:3, 3] - np.asarray(origin, np.float64)])
    base = np.floor(pose[9:] / voxel_size)
    if not np.abs(base).max() < LIMIT:
        raise PersemError(
            f'position {T[:3, 3].tolist()} m is too far away for voxels of {voxel_size} m: '
            'expected finite coordinates near map.origin')
    return pose, base


@kernel
def locate(start, stop, points, depth, rays, low, high, pose, base, voxel_size, keys):
    """Write the key of each point's voxel."""
    inside, axes = np.empty(STRETCH, np.int64), np.empty((6, STRETCH))
    for begin in range(start, stop, STRETCH):
        end = min(begin + STRETCH, stop)
        place_stretch(points, depth, rays, begin, end, low, high, pose, base, voxel_size, axes,
                      keys[begin:end], inside)


@inlined
def place_stretch(points, depth, rays, begin, end, low, high, pose, base, voxel_size, axes, keys,
                  inside):
    """Write the voxels' keys of the points begin .. end, and their places there (key_of())."""
    if len(points) > 0:
        place_points(points[3 * begin:3 * end], pose, base, voxel_size, keys, inside)
    else:
        place_pixels(depth[begin:end], rays[2 * begin:2 * end], low, high, pose, base, voxel_size,
                     axes, keys, inside)


@inlined
def place_points(points, pose, base, voxel_size, keys, inside):
    """Do so for points one by one."""
    for p in range(len(keys)):
        keys[p], inside[p] = key_of(points[3 * p], points[3 * p + 1], points[3 * p + 2], pose,
                                    base, voxel_size)


@inlined
def key_of(x, y, z, pose, base, voxel_size):
    """
    Return the voxel of a point, floor((R p + t) / voxel_size) per axis (spec section 1).

    Three indices relative to the sensor's own voxel in one integer, 21 bits each; NOWHERE for a
    point without a place (NaN, or a million voxels away). Beside it the point's place in the
    voxel: 256ths of the edge along x, y and z, 20 bits each, so that 4096 of them can be added up.

    """
    reach = np.float64(REACH)
    a = (pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) / voxel_size
    b = (pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) / voxel_size
    c = (pose[6] * x + pose[7] * y + pose[8] * z + pose[11]) / voxel_size
    low_a, low_b, low_c = np.floor(a), np.floor(b), np.floor(c)
    i, j, k = low_a - base[0], low_b - base[1], low_c - base[2]
    if abs(i) < reach and abs(j) < reach and abs(k) < reach:    # false for NaN
        key = (np.int64(i + reach) << 42) | (np.int64(j + reach) << 21) | np.int64(k + reach)
        # min: a hair below zero is, less its floor, 1.0
        inside = (np.int64(min((a - low_a) * 256.0, 255.0)) << 40) \
            | (np.int64(min((b - low_b) * 256.0, 255.0)) << 20) \
            | np.int64(min((c - low_c) * 256.0, 255.0))
        return key, inside
    return NOWHERE, np.int64(0)


@inlined
def place_pixels(depth, rays, low, high, pose, base, voxel_size, axes, keys, inside):
    """
    Do what key_of() does for pixels, many at once and axis by axis.

    Loops without branches over arrays that start at 0, which the compiler turns into vector
    instructions: 5 ns a pixel, by arrays of this length, instead of 9 by whole rows; else 11.

    """
    along(depth, rays, pose[0], pose[1], pose[2], pose[9], base[0], voxel_size, axes[0], axes[3])
    along(depth, rays, pose[3], pose[4], pose[5], pose[10], base[1], voxel_size, axes[1], axes[4])
    along(depth, rays, pose[6], pose[7], pose[8], pose[11], base[2], voxel_size, axes[2], axes[5])
    join(depth, low, high, axes[0], axes[1], axes[2], keys)
    pack(axes[3], axes[4], axes[5], keys, inside)


@inlined
def along(depth, rays, a, b, c, d, base, voxel_size, index, part):
    """Write voxels along one axis, from the sensor's own, and 256ths of the edge there."""
    for u in range(len(depth)):
        z = depth[u]
        place = (a * (rays[2 * u] * z) + b * (rays[2 * u + 1] * z) + c * z + d) / voxel_size
        low = np.floor(place)
        index[u] = low - base
        inside = (place - low) * 256.0
        part[u] = inside if inside < 255.0 else 255.0   # a hair below zero is, less its floor, 1


@inlined
def join(depth, low, high, x, y, z, keys):
    """Write the keys of a row of indices; NOWHERE where depth is no measurement or too far."""
    reach = np.float64(REACH)
    for u in range(len(depth)):
        d = depth[u]
        there = (low <= d) & (d <= high) & (d > 0.0) \
            & (abs(x[u]) < reach) & (abs(y[u]) < reach) & (abs(z[u]) < reach)
        key = (np.int64(np.int32(x[u] + reach)) << 42) \
            | (np.int64(np.int32(y[u] + reach)) << 21) | np.int64(np.int32(z[u] + reach))
        keys[u] = key if there else NOWHERE


@inlined
def pack(x, y, z, keys, inside):
    """Write places in voxels, 20 bits an axis; 0 for pixels without a place."""
    for u in range(len(keys)):
        packed = (np.int64(np.int32(x[u])) << 40) | (np.int64(np.int32(y[u])) << 20) \
            | np.int64(np.int32(z[u]))
        inside[u] = packed if keys[u] != NOWHERE else 0
