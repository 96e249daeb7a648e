"""
The ground under a map: a morphological opening of the lowest voxels of its columns.

Columns lie in tiles of 8 x 8, the footprints of blocks. Only columns that were observed count, so
no edge of the map plays a part.

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.pools import SIDE

NONE = np.iinfo(np.int32).max       # height of a column without a voxel
TILE = SIDE * SIDE


@dataclass(frozen=True, eq=False)
class Ground:
    """
    Heights of the columns of T tiles.

    Attributes
    ----------
    tiles : ndarray, shape (T, 2), int32
        (i, j) // 8 of the columns of each tile, sorted.
    lowest, level : ndarray, shape (T, 64), int32
        The lowest voxel's k and the ground's k of each column, j fastest; NONE where there is no
        voxel.

    """

    tiles: NDArray[np.int32]
    lowest: NDArray[np.int32]
    level: NDArray[np.int32]


def tiles_of(blocks: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the sorted tiles (T, 2) of upright blocks (b, 3), and each block's tile (b,)."""
    keys, tile = np.unique(keys_of(blocks[:, :2]), return_inverse=True)
    return _unpacked(keys), tile.reshape(-1).astype(np.int64)


def ground_of(tiles: NDArray[np.int32], lowest: NDArray[np.int32], window: int) -> Ground:
    """Return the Ground over *tiles* whose columns' lowest voxels are *lowest* (T, 64)."""
    around = tiles_around(tiles, window)
    eroded = windowed_minimum(around, lowest, window)
    hidden = lowest == NONE
    level = -windowed_minimum(around, np.where(hidden, NONE, -eroded), window)
    return Ground(tiles, lowest, np.where(hidden, NONE, level))


class Around(NamedTuple):
    """
    Which tiles lie along each axis of which, within a window.

    Attributes
    ----------
    along_j : ndarray, shape (W, 2 reach + 1), int64
        Places among the T tiles of W, of which some hold nothing themselves; -1: none.
    along_i : ndarray, shape (T, 2 reach + 1), int64
        Places among the W.

    """

    along_j: NDArray[np.int64]
    along_i: NDArray[np.int64]


def tiles_around(tiles: NDArray[np.int32], window: int) -> Around:
    """Return the Around of sorted tiles (T, 2)."""
    reach = -(-window // SIDE)
    beside, steps = keys_of(tiles), list(range(-reach, reach + 1))
    wide = np.unique(np.concatenate([beside + d for d in steps]))
    return Around(_near(wide, beside, steps), _near(beside, wide, [d << 32 for d in steps]))


def windowed_minimum(around: Around, values: NDArray[np.int32],
                     window: int) -> NDArray[np.int32]:
    """Return the least value (T, 64) within *window* columns along i and j; NONE counts not."""
    between = np.empty((len(around.along_j), TILE), np.int32)
    split(slide, len(between), around.along_j, values, window, 1, SIDE, between, grain=256)
    result = np.empty((len(around.along_i), TILE), np.int32)
    split(slide, len(result), around.along_i, between, window, SIDE, 1, result, grain=256)
    return result


def keys_of(tiles: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return one sortable number per tile; its neighbours' are 1 (along j) or 2^32 away."""
    return (tiles[:, 0].astype(np.int64) << 32) + (tiles[:, 1].astype(np.int64) + (1 << 31))


def _unpacked(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the tiles (T, 2) of keys."""
    return np.stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)], axis=1).astype(np.int32)


def _near(keys: NDArray[np.int64], among: NDArray[np.int64],
          steps: list[int]) -> NDArray[np.int64]:
    """Return the places (n, len(steps)) in *among* of keys + step, -1 where there is none."""
    found = np.empty((len(keys), len(steps)), np.int64)
    for column, step in enumerate(steps):
        wanted = keys + step
        place = np.minimum(np.searchsorted(among, wanted), len(among) - 1)
        found[:, column] = np.where(among[place] == wanted, place, -1)
    return found


@kernel
def slide(begin, end, near, values, window, stride, across, out):
    """
    Write the least value within *window* columns along one axis, for tiles begin .. end.

    near (n, 2 reach + 1) are the places in *values* of a tile's neighbours along the axis;
    stride is the distance of columns along it, across that of its lines.

    """
    parts = near.shape[1]
    middle = parts // 2 * SIDE
    line = np.empty(parts * SIDE, np.int32)
    for tile in range(begin, end):
        for a in range(SIDE):
            for part in range(parts):
                other = near[tile, part]
                for p in range(SIDE):
                    line[part * SIDE + p] = NONE if other < 0 \
                        else values[other, a * across + p * stride]
            if 2 * window < SIDE:
                for p in range(SIDE):
                    least = line[middle + p]
                    for q in range(middle + p - window, middle + p + window + 1):
                        least = min(least, line[q])
                    out[tile, a * across + p * stride] = least
                continue
            # All eight windows share what lies between the last one's begin and the first's end.
            common = line[middle]
            for q in range(middle + SIDE - 1 - window, middle + window + 1):
                common = min(common, line[q])
            least = common
            for p in range(SIDE - 1, -1, -1):
                least = min(least, line[middle + p - window])
                out[tile, a * across + p * stride] = least
            least = common
            for p in range(SIDE):
                least = min(least, line[middle + p + window])
                out[tile, a * across + p * stride] = min(
                    out[tile, a * across + p * stride], least)


@kernel
def lower(index, tile, lowest):
    """Enter upright voxels (n, 3), each in a tile (n,), as the lowest of their columns."""
    for r in range(len(index)):
        column = (index[r, 0] & 7) * SIDE + (index[r, 1] & 7)
        lowest[tile[r], column] = min(lowest[tile[r], column], index[r, 2])
