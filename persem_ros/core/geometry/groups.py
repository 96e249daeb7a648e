"""Which groups of places a voxel belongs to: by shape, and by kind within two cells of the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import Ground, NONE, TILE
from persem_ros.core.geometry.shape import LEVELS
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import hash3
from persem_ros.core.memory.pools import SIDE

HEIGHTS = 1, 2, 3, 5, 8, 14, 24     # voxels above ground: edges of the fine groups
TILTS_AND_NONE = 4
SHAPES = (len(HEIGHTS) + 1) * TILTS_AND_NONE * LEVELS      # fine groups, 96
LOW, HIGH = 2, 6                    # edges of the coarse ones
KINDS = 9                           # coarse groups of a cell


@dataclass(frozen=True, eq=False)
class Cells:
    """
    Numbers of the cells of a map, cell by cell shifted by the same offset.

    Attributes
    ----------
    table : ndarray, shape (2^m, 3), int64
        Open addressing: i, j and number + 1 of a cell; 0: free.
    number : int
        How many there are.

    """

    table: NDArray[np.int64]
    number: int


@dataclass(frozen=True, eq=False)
class Groups:
    """
    The three groups of n voxels.

    Attributes
    ----------
    fine : ndarray, shape (n,), uint8
        b1, below 96.
    coarse, shifted : ndarray, shape (n,), int32
        b2 and b3: a cell's number * 9 + kind; the last group of all where no cell is known.
    height : ndarray, shape (n,), int32
        Voxels above ground.

    """

    fine: NDArray[np.uint8]
    coarse: NDArray[np.int32]
    shifted: NDArray[np.int32]
    height: NDArray[np.int32]


def counts(chosen: str, k: int) -> bool:
    """Return whether the k-th groups (0 fine, 1 coarse, 2 shifted) count, by refine.*.groups."""
    return chosen == 'both' or (chosen == 'shapes') == (k == 0)


def make_cells(ground: Ground, offset: int, cell: int) -> Cells:
    """Return the Cells of a map's observed columns."""
    bound = len(ground.tiles) * (SIDE // cell + 2) ** 2
    table = np.zeros((1 << int(2 * bound).bit_length(), 3), np.int64)
    return Cells(table, number_cells(ground.tiles, ground.lowest, offset, cell, table))


def cells_listed(cells: Cells) -> NDArray[np.int32]:
    """Return the cells (n, 2), int32, by number."""
    entries = cells.table[cells.table[:, 2] > 0]
    found = np.empty((cells.number, 2), np.int32)
    found[entries[:, 2] - 1] = entries[:, :2]
    return found


def cells_from(listed: NDArray[np.int32]) -> Cells:
    """Return the Cells that cells_listed() gave, distinct ones."""
    table = np.zeros((1 << int(2 * len(listed) + 2).bit_length(), 3), np.int64)
    enter_cells(listed, table)
    return Cells(table, len(listed))


def groups_of(index: NDArray[np.int32], tile: NDArray[np.int64], shape: NDArray[np.uint8],
              ground: Ground, cells: tuple[Cells, Cells], cell: int) -> Groups:
    """
    Return the groups of upright voxels.

    Parameters
    ----------
    index : ndarray, shape (n, 3), int32
        i, j and the k that points up.
    tile : ndarray, shape (n,), int64
        The tile of each in *ground*.
    shape : ndarray, shape (n,), uint8
        core.geometry.shape.shapes_of.
    ground : Ground
        Its height in every column.
    cells : pair of Cells
        Of the offsets 0 and cell // 2; they need not know every cell.
    cell : int
        Columns along a cell.

    """
    n = len(index)
    found = Groups(np.empty(n, np.uint8), np.empty(n, np.int32), np.empty(n, np.int32),
                   np.empty(n, np.int32))
    occurs, columns = np.zeros(len(ground.tiles), bool), []
    occurs[tile] = True
    numbers = np.flatnonzero(occurs)
    for offset, known in zip((0, cell // 2), cells):
        columns.append(np.empty((len(ground.tiles), TILE), np.int32))
        split(look_up, len(numbers), numbers, ground.tiles, ground.lowest, offset, cell,
              known.table, columns[-1], grain=256)
    split(classify, n, index, tile, shape, ground.level, *columns,
          np.array([known.number for known in cells]), np.array(HEIGHTS), found.fine,
          found.coarse, found.shifted, found.height)
    return found


@kernel
def number_cells(tiles, lowest, offset, cell, table):
    """Give each cell of the observed columns a number; return how many there are."""
    n, mask = 0, np.uint64(len(table) - 1)
    last_i, last_j = np.int64(1 << 40), np.int64(0)
    for tile in range(len(tiles)):
        for column in range(TILE):
            if lowest[tile, column] == NONE:
                continue
            i = (tiles[tile, 0] * SIDE + column // SIDE + offset) // cell
            j = (tiles[tile, 1] * SIDE + column % SIDE + offset) // cell
            if i == last_i and j == last_j:
                continue
            last_i, last_j = i, j
            place = hash3(i, j, 0) & mask
            while table[place, 2] != 0 and (table[place, 0] != i or table[place, 1] != j):
                place = (place + np.uint64(1)) & mask
            if table[place, 2] == 0:
                n += 1
                table[place, 0], table[place, 1], table[place, 2] = i, j, n
    return n


@kernel
def enter_cells(listed, table):
    """Enter cells (n, 2) by their numbers."""
    mask = np.uint64(len(table) - 1)
    for n in range(len(listed)):
        i, j = np.int64(listed[n, 0]), np.int64(listed[n, 1])
        place = hash3(i, j, 0) & mask
        while table[place, 2] != 0:
            place = (place + np.uint64(1)) & mask
        table[place, 0], table[place, 1], table[place, 2] = i, j, n + 1


@kernel
def look_up(begin, end, numbers, tiles, lowest, offset, cell, table, number):
    """Write the cells' numbers of observed columns of tiles numbers[begin:end]; -1: unknown."""
    mask = np.uint64(len(table) - 1)
    last_i, last_j, last = np.int64(1 << 40), np.int64(0), np.int64(-1)
    for w in range(begin, end):
        tile = numbers[w]
        for column in range(TILE):
            if lowest[tile, column] == NONE:
                continue
            i = (tiles[tile, 0] * SIDE + column // SIDE + offset) // cell
            j = (tiles[tile, 1] * SIDE + column % SIDE + offset) // cell
            if i != last_i or j != last_j:
                last_i, last_j = i, j
                place = hash3(i, j, 0) & mask
                while table[place, 2] != 0 and (table[place, 0] != i or table[place, 1] != j):
                    place = (place + np.uint64(1)) & mask
                last = table[place, 2] - 1
            number[tile, column] = last


@kernel
def classify(begin, end, index, tile, shape, level, cell, shifted_cell, number, edges, fine,
             coarse, shifted, height):
    """Write heights above ground and groups of upright voxels begin .. end."""
    for r in range(begin, end):
        column = (index[r, 0] & 7) * SIDE + (index[r, 1] & 7)
        h = index[r, 2] - level[tile[r], column]
        step = 0
        for edge in edges:
            step += edge <= h
        height[r] = h
        fine[r] = step * TILTS_AND_NONE * LEVELS + shape[r]
        kind = (1 * (h >= LOW) + 1 * (h >= HIGH)) * 3 + min(np.int64(shape[r]) // LEVELS, 2)
        here = cell[tile[r], column]
        coarse[r] = (here if here >= 0 else number[0]) * KINDS + (kind if here >= 0 else 0)
        here = shifted_cell[tile[r], column]
        shifted[r] = (here if here >= 0 else number[1]) * KINDS + (kind if here >= 0 else 0)
