"""Tiles of columns as one rectangle of cells, as large as grid.resolution says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.outputs.grid.rule import UNKNOWN_CLASS, UNKNOWN_COST

HIGHEST, LOWEST, UNKNOWN = 'highest', 'lowest', 'unknown'
MOST_CELLS = 400_000_000    # of one rectangle: 20 000 x 20 000


@dataclass(frozen=True, eq=False)
class Cells:
    """
    A rectangle of the grid.

    Attributes
    ----------
    corner : tuple of 2 int
        Cell (x, y) of cost[0, 0], counted from the map's origin.
    size : float
        Edge of a cell, metres.
    cost : ndarray, shape (h, w), int8
        Row y, column x; 0 .. 100, -1 unknown.
    label : ndarray, shape (h, w), uint16
        65535: none.

    """

    corner: tuple[int, int]
    size: float
    cost: NDArray[np.int8]
    label: NDArray[np.uint16]


def cell_size(resolution: float, voxel_size: float) -> float:
    """Return the edge of a cell in metres; resolution 0: that of a voxel."""
    return max(resolution, voxel_size)


def cells_of(tiles: NDArray[np.int32], cost: NDArray[np.int8], label: NDArray[np.uint16],
             voxel_size: float, resolution: float = 0.0, tie: str = HIGHEST) -> Cells:
    """
    Return the smallest rectangle that has all known columns of tiles.

    Parameters
    ----------
    tiles : ndarray, shape (T, 2), int32
        (i, j) // 8.
    cost : ndarray, shape (T, 64), int8
        Of their columns, -1 unknown.
    label : ndarray, shape (T, 64), uint16
        65535: none.
    voxel_size, resolution : float
        Metres.
    tie : str
        What becomes of a cell whose columns cost differently: 'highest', 'lowest', 'unknown'.
        Its class is that of the column whose cost it takes (the smaller id of several).

    """
    size = cell_size(resolution, voxel_size)
    column = np.arange(SIDE * SIDE)
    known = (cost != UNKNOWN_COST) | (label != UNKNOWN_CLASS)
    tile, place = np.nonzero(known)
    x, y = (tiles[tile, axis].astype(np.int64) * SIDE + offset[place]
            for axis, offset in ((0, column >> 3), (1, column & 7)))
    if size != voxel_size:      # a column belongs to the cell that its middle is in
        x, y = (np.floor((v + 0.5) * voxel_size / size + 1e-9).astype(np.int64) for v in (x, y))
    if not len(x):
        return Cells((0, 0), size, np.empty((0, 0), np.int8), np.empty((0, 0), np.uint16))
    left, low = int(x.min()), int(y.min())
    shape = int(y.max()) - low + 1, int(x.max()) - left + 1
    out = np.full(shape, UNKNOWN_COST, np.int8), np.full(shape, UNKNOWN_CLASS, np.uint16)
    at = y - low, x - left
    values, names = cost[known], label[known]
    # The last one of a cell wins: unknown costs first, then as tie says, larger ids before.
    rank = np.where(values == UNKNOWN_COST, 1000,
                    values.astype(np.int64) * (1 if tie == LOWEST else -1))
    order = np.lexsort((names, rank))[::-1]
    where = at[0][order], at[1][order]
    out[0][where], out[1][where] = values[order], names[order]
    if tie == UNKNOWN:
        least, most = np.full(shape, 127, np.int8), np.full(shape, -1, np.int8)
        priced = values != UNKNOWN_COST
        at_priced = at[0][priced], at[1][priced]
        np.minimum.at(least, at_priced, values[priced])
        np.maximum.at(most, at_priced, values[priced])
        out[0][most > least] = UNKNOWN_COST
    return Cells((left, low), size, *out)
