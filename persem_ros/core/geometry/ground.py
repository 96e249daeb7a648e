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
    return Ground(tiles, lowest, level_of(tiles, lowest, window, np.arange(len(tiles))))


def level_of(tiles: NDArray[np.int32], lowest: NDArray[np.int32], window: int,
             wanted: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the ground's k (n, 64) in the columns of sorted tiles[wanted]; as ground_of()."""
    around = tiles_around(tiles, window)
    near = around.reached(wanted)
    eroded = windowed_minimum(around, lowest, window, near)[near]
    values = np.full_like(lowest, NONE)
    values[near] = np.where(lowest[near] == NONE, NONE, -eroded)
    level = -windowed_minimum(around, values, window, wanted)[wanted]
    return np.where(lowest[wanted] == NONE, NONE, level)


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

    def beside(self, tiles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the places, among the W, of what lies along i of some of the T tiles."""
        return _places(self.along_i[tiles], len(self.along_j))

    def reached(self, tiles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return which of the T tiles lie within the window of some of them."""
        return _places(self.along_j[self.beside(tiles)], len(self.along_i))


def tiles_around(tiles: NDArray[np.int32], window: int) -> Around:
    """Return the Around of sorted tiles (T, 2)."""
    reach = -(-window // SIDE)
    keys, steps = keys_of(tiles), np.arange(-reach, reach + 1)
    wide = np.empty(len(steps) * len(keys), np.int64)
    wide = wide[:widen(keys, reach, wide)]
    along_j, along_i = (np.empty((n, len(steps)), np.int64) for n in (len(wide), len(keys)))
    find_along(wide, keys, steps, along_j)
    find_along(keys, wide, steps << 32, along_i)
    return Around(along_j, along_i)


def windowed_minimum(around: Around, values: NDArray[np.int32], window: int,
                     wanted: NDArray[np.int64]) -> NDArray[np.int32]:
    """
    Return the least value (T, 64) within *window* columns along i and j; NONE counts not.

    Only the rows *wanted* are written.

    """
    rows, between = around.beside(wanted), np.empty((len(around.along_j), TILE), np.int32)
    split(slide, len(rows), rows, around.along_j, values, window, 1, SIDE, between, grain=256)
    result = np.empty((len(around.along_i), TILE), np.int32)
    split(slide, len(wanted), wanted, around.along_i, between, window, SIDE, 1, result, grain=256)
    return result


def keys_of(tiles: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return one sortable number per tile; its neighbours' are 1 (along j) or 2^32 away."""
    return (tiles[:, 0].astype(np.int64) << 32) + (tiles[:, 1].astype(np.int64) + (1 << 31))


def _unpacked(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the tiles (T, 2) of keys."""
    return np.stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)], axis=1).astype(np.int32)


def _places(near: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Return the distinct places below n among some, -1 left out."""
    found = np.zeros(n + 1, bool)
    found[near.reshape(-1)] = True
    return np.flatnonzero(found[:-1])


@kernel
def widen(keys, reach, wide):
    """Write ascending keys and all within *reach* of them, each once; return how many."""
    n, last = 0, np.int64(-1 << 62)
    for key in keys:
        for beside in range(max(key - reach, last + 1), key + reach + 1):
            wide[n] = beside
            n += 1
        last = max(last, key + reach)
    return n


@kernel
def find_along(keys, among, steps, found):
    """Write the places in *among* of keys + steps, both ascending; -1 where there is none."""
    for s in range(len(steps)):
        place = 0
        for n in range(len(keys)):
            wanted = keys[n] + steps[s]
            while place < len(among) and among[place] < wanted:
                place += 1
            found[n, s] = place if place < len(among) and among[place] == wanted else -1


@kernel
def slide(begin, end, rows, near, values, window, stride, across, out):
    """
    Write the least value within *window* columns along one axis, for tiles rows[begin:end].

    near (n, 2 reach + 1) are the places in *values* of a tile's neighbours along the axis;
    stride is the distance of columns along it, across that of its lines.

    """
    parts = near.shape[1]
    middle = parts // 2 * SIDE
    line = np.empty(parts * SIDE, np.int32)
    for w in range(begin, end):
        tile = rows[w]
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
