"""
The relief of a map, kept between refinements: which cells are occupied, and the ground's height.

What a frame adds changes it here and there; which labels that may reach is what update() finds.

"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import Ground, ground_of, keys_of, NONE, TILE
from persem_ros.core.geometry.upright import Up, upright
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.pools import ROWS, SIDE, sparse_zeros

NEW_TILES = np.empty((0, 2), np.int32)


class Change(NamedTuple):
    """
    What update() found, by block number.

    Attributes
    ----------
    whole : bool
        The relief was made anew: everything may have changed.
    blocks : ndarray, int64
        Blocks with cells that became occupied.
    occupied : ndarray, shape (blocks of the map, 64), uint8
        A bit per cell that became so.
    risen_blocks : ndarray, int64
        Blocks over columns whose ground changed ...
    risen : ndarray, shape (blocks of the map, 64), uint8
        ... and their occupied cells in these columns.

    """

    whole: bool
    blocks: NDArray[np.int64]
    occupied: NDArray[np.uint8]
    risen_blocks: NDArray[np.int64]
    risen: NDArray[np.uint8]


class Relief:
    """
    Occupied cells and ground of one map.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
    up : core.geometry.upright.Up
    window : int
        Of the opening, in columns.

    Attributes
    ----------
    bits : ndarray, shape (blocks, 64), uint8
        A bit per cell, in rows of 8 along z, by block number.
    tile : ndarray, shape (blocks,), int32
        Place of a block's tile among those of *ground*.
    ground : Ground
        Tiles are in the order in which they came.

    """

    def __init__(self, memory: Any, up: Up, window: int) -> None:
        blocks = memory.store.capacity['blocks']
        self.up, self.window = up, window
        self.bits = sparse_zeros((blocks, ROWS), np.uint8)
        self.tile = sparse_zeros(blocks, np.int32)
        self.ground = Ground(NEW_TILES, *(np.empty((0, TILE), np.int32) for _ in range(2)))
        self._empty = True

    def nbytes(self, n_blocks: int) -> int:
        """Return the bytes in use."""
        return n_blocks * (ROWS + 4) + len(self.ground.tiles) * (8 + 8 * TILE)

    def update(self, memory: Any, dirty: NDArray[np.int64]) -> Change:
        """
        Take in what changed in the blocks *dirty*; the mapping thread calls it.

        Where cells became empty the relief is made anew, from all blocks.

        """
        n, blocks = memory.n_blocks, memory.m.blocks
        whole = self._empty
        numbers = np.flatnonzero(blocks['near'][:n, 13]) if whole else dirty
        now = np.zeros((len(numbers), ROWS), np.uint8)
        split(read_bits, len(numbers), blocks, memory.m.voxels, numbers, memory.n_gone > 0, now,
              grain=256)
        before = self.bits[numbers]
        if not whole and (before & ~now).any():
            self.__init__(memory, self.up, self.window)     # type: ignore[misc]
            return self.update(memory, dirty)
        came = now & ~before
        some = came.any(axis=1)
        numbers, came = numbers[some], came[some]
        self.bits[numbers] |= came
        occupied, risen = (sparse_zeros((n, ROWS), np.uint8) for _ in range(2))
        occupied[numbers] = came
        self._empty = False
        changed = self._enter(blocks['index'][numbers], numbers, came)
        tiles = np.flatnonzero(changed.any(axis=1))
        mark = np.zeros(len(changed), bool)
        mark[tiles] = True
        over = np.flatnonzero(mark[self.tile[:n]] & (blocks['near'][:n, 13] > 0)) \
            if len(tiles) and not whole else np.empty(0, np.int64)
        mark_columns(over, self.tile, self.bits, changed, self.up.i, self.up.j, risen)
        return Change(whole, numbers, occupied, over, risen)

    def _enter(self, index: NDArray[np.int32], numbers: NDArray[np.int64],
               came: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Enter cells that became occupied; return (tiles, 64): whose ground changed."""
        corner = upright(index, self.up)
        tiles, lowest, level = self.ground.tiles, self.ground.lowest, self.ground.level
        keys, own = keys_of(tiles), keys_of(corner[:, :2])
        new, first = np.unique(own[~np.isin(own, keys)], return_index=True)
        if len(new):
            more = corner[~np.isin(own, keys)][first][:, :2]
            nothing = np.full((len(new), TILE), NONE, np.int32)
            tiles = np.concatenate([tiles, more])
            lowest, level = np.concatenate([lowest, nothing]), np.concatenate([level, nothing])
            keys = keys_of(tiles)
        order = np.argsort(keys)
        self.tile[numbers] = order[np.searchsorted(keys, own, sorter=order)]
        changed = np.zeros(len(tiles), np.uint8)
        lower_columns(numbers, self.tile, came, corner, self.up, lowest, changed)
        before = level
        if changed.any():
            level = self._leveled(tiles, keys, order, lowest, level, np.flatnonzero(changed))
        self.ground = Ground(tiles, lowest, level)
        return level != before

    def _leveled(self, tiles: NDArray[np.int32], keys: NDArray[np.int64],
                 order: NDArray[np.int64], lowest: NDArray[np.int32], level: NDArray[np.int32],
                 changed: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the level of all columns, where the lowest of the tiles *changed* did."""
        reach = -(-self.window // SIDE)
        wide, inner = (_near(tiles, changed, k * reach) for k in (4, 2))
        part = np.flatnonzero(wide)
        part = part[np.argsort(keys[part])]         # ground_of wants them sorted
        found = ground_of(tiles[part], lowest[part], self.window).level
        result, reached = level.copy(), inner[part]
        result[part[reached]] = found[reached]
        return result


def _near(tiles: NDArray[np.int32], some: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Return (tiles,): which lie within *reach* of some, along both axes."""
    low = tiles.min(axis=0) - reach
    shape = tiles.max(axis=0) - low + 1 + reach
    if float(shape[0]) * float(shape[1]) > 1e7:     # tiles far apart: all of them
        return np.ones(len(tiles), bool)
    grid = np.zeros((int(shape[0]) + 1, int(shape[1]) + 1), np.int32)
    place = tiles - low
    for i, j in ((-reach, -reach), (reach + 1, reach + 1)):
        np.add.at(grid, (np.minimum(place[some, 0] + i, shape[0]),
                         np.minimum(place[some, 1] + j, shape[1])), 1)
    for i, j in ((-reach, reach + 1), (reach + 1, -reach)):
        np.add.at(grid, (np.minimum(place[some, 0] + i, shape[0]),
                         np.minimum(place[some, 1] + j, shape[1])), -1)
    covered = grid.cumsum(axis=0).cumsum(axis=1) > 0
    return np.asarray(covered[place[:, 0], place[:, 1]])


@kernel
def read_bits(begin, end, blocks, voxels, numbers, look, bits):
    """Write which cells of the blocks numbers[begin:end] hold a voxel that is not gone."""
    for b in range(begin, end):
        cells = blocks[numbers[b]].cells
        for row in range(ROWS):
            found = 0
            for z in range(SIDE):
                v = np.int64(cells[row * SIDE + z])
                if v > 0 and not (look and voxels[v - 1].gone > 0):
                    found |= 1 << z
            bits[b, row] = found


@kernel
def lower_columns(numbers, tile, came, corner, up, lowest, changed):
    """Lower the columns of the cells that came, bits (b, 64); mark the tiles where one changed."""
    place = np.zeros(3, np.int64)
    for b in range(len(numbers)):
        t = tile[numbers[b]]
        for row in range(ROWS):
            if came[b, row] == 0:
                continue
            for z in range(SIDE):
                if came[b, row] >> z & 1 == 0:
                    continue
                place[0], place[1], place[2] = row >> 3, row & 7, z
                i, j, k = place[up[0]], place[up[1]], place[up[2]]
                if up[3]:
                    k = 7 - k
                column = i * SIDE + j
                height = corner[b, 2] * SIDE + k
                if height < lowest[t, column]:
                    lowest[t, column] = height
                    changed[t] = 1


@kernel
def mark_columns(numbers, tile, bits, changed, i_axis, j_axis, marks):
    """Mark the occupied cells of blocks in the columns that changed (tiles, 64)."""
    place = np.zeros(3, np.int64)
    for b in numbers:
        columns = changed[tile[b]]
        for row in range(ROWS):
            if bits[b, row] == 0:
                continue
            found = 0
            for z in range(SIDE):
                place[0], place[1], place[2] = row >> 3, row & 7, z
                if columns[place[i_axis] * SIDE + place[j_axis]]:
                    found |= 1 << z
            marks[b, row] = bits[b, row] & found


@kernel
def spread(begin, end, blocks, numbers, rows, reach, out):
    """
    Mark, in the blocks numbers[begin:end], the cells within *reach* (8 at most) of marked ones.

    A block's marks are 64 rows of 8 bits, along z; within means along every axis.

    """
    wide = SIDE + 2 * reach
    padded, across = np.zeros((wide, wide), np.int64), np.zeros((wide, SIDE), np.int64)
    for p in range(begin, end):
        if gathered(blocks[numbers[p]], rows, reach, padded) == 0:
            continue
        for x in range(wide):
            for y in range(SIDE):
                found = np.int64(0)
                for d in range(2 * reach + 1):
                    found |= padded[x, y + d]
                across[x, y] = found
        for x in range(SIDE):
            for y in range(SIDE):
                found = np.int64(0)
                for d in range(2 * reach + 1):
                    found |= across[x + d, y]
                out[numbers[p], x * SIDE + y] |= np.uint8(found & 255)


@inlined
def gathered(block, rows, reach, padded):
    """Write rows around a block, spread along z, to bits 0 .. 7; return whether there is any."""
    near, some = block.near, np.int64(0)
    for x in range(SIDE + 2 * reach):
        for y in range(SIDE + 2 * reach):
            column = (((x + SIDE - reach) >> 3) * 3 + ((y + SIDE - reach) >> 3)) * 3
            row = ((x - reach) & 7) * SIDE + ((y - reach) & 7)
            bits = np.int64(0)
            for part in range(3):
                other = np.int64(near[column + part])
                if other > 0:
                    bits |= np.int64(rows[other - 1, row]) << (8 * part)
            if bits:
                for _ in range(reach):
                    bits |= bits << 1 | bits >> 1
                bits >>= 8
            padded[x, y] = bits & 255
            some |= padded[x, y]
    return some
