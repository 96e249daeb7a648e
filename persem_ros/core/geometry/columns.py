"""The lowest voxel of every column of a map, put together from those of its parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import Ground, ground_of, keys_of, lower, NONE, TILE, tiles_of
from persem_ros.core.geometry.groups import Cells, make_cells
from persem_ros.core.memory.pools import SIDE


class Columns(NamedTuple):
    """
    The lowest voxels of a map's columns; the arrays may lie in files.

    Attributes
    ----------
    tiles : ndarray, shape (T, 2), int32
        (i, j) // 8 of the columns of each tile, sorted.
    lowest : ndarray, shape (T, 64), int32
        As core.geometry.ground.Ground has it.

    """

    tiles: NDArray[np.int32]
    lowest: NDArray[np.int32]

    def around(self, some: Columns, window: int) -> Columns:
        """
        Return some columns and those around them that decide on the ground under these.

        They are as low as *some* say, where these know more.

        """
        if not len(some.tiles):
            return some
        reach = 2 * -(-window // SIDE)      # the opening looks twice as far as its window
        low, high = some.tiles.min(axis=0) - reach, some.tiles.max(axis=0) + reach
        first, last = np.searchsorted(self.tiles[:, 0], (low[0], high[0] + 1))
        j = self.tiles[first:last, 1]
        rows = first + np.flatnonzero((low[1] <= j) & (j <= high[1]))
        return merged([Columns(*(np.asarray(column[rows]) for column in self)), some])

    def places(self, tiles: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the places, (t,), of tiles (t, 2); of one that is not there, any."""
        found = np.searchsorted(keys_of(self.tiles), keys_of(tiles))
        return np.minimum(found, max(len(self.tiles) - 1, 0))

    def ground(self, window: int) -> Ground:
        """Return the Ground over the columns: of the map, or of what lies around a part of it."""
        return ground_of(self.tiles, self.lowest, window)

    def and_those(self, other: Columns) -> Columns:
        """Return the Columns of both; these are changed in place where no tile is new."""
        if not len(self.tiles):
            return other
        place = self.places(other.tiles)
        if (self.tiles[place] != other.tiles).any():
            return merged([self, other])
        self.lowest[place] = np.minimum(self.lowest[place], other.lowest)
        return self

    def cells(self, cell: int) -> tuple[Cells, Cells]:
        """Return the cells of the map, and those shifted by half of one."""
        return cells_at(Ground(*self, self.lowest), cell)


def cells_at(ground: Ground, cell: int) -> tuple[Cells, Cells]:
    """Return the cells over a ground, and those shifted by half of one."""
    return make_cells(ground, 0, cell), make_cells(ground, cell // 2, cell)


def columns_of(index: NDArray[np.int32]) -> Columns:
    """Return the Columns of some upright voxels (n, 3)."""
    keys = keys_of(index[:, :2] >> 3)
    first = np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1))     # they come block by block
    tiles, tile = tiles_of(index[first] >> 3)
    tile = np.repeat(tile, np.diff(np.append(first, len(keys))))
    lowest = np.full((len(tiles), TILE), NONE, np.int32)
    lower(index, tile, lowest)
    return Columns(tiles, lowest)


def merged(parts: Sequence[Columns]) -> Columns:
    """Return the Columns of all parts together, of one at least."""
    tiles, lowest = (np.concatenate(columns) for columns in zip(*parts))
    keys = keys_of(tiles)
    order = np.argsort(keys, kind='stable')
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    return Columns(tiles[order][first], np.minimum.reduceat(lowest[order], first, axis=0))
