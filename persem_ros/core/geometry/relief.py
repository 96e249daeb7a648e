"""
The relief of a map, kept between refinements: which cells are occupied, and the ground's height.

What a frame adds changes it here and there; which labels that may reach is what update() finds.

"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import Ground, keys_of, level_of, NONE, TILE
from persem_ros.core.geometry.occupied import lower_columns, mark_columns, read_bits
from persem_ros.core.geometry.upright import Up, upright
from persem_ros.core.jit import split
from persem_ros.core.memory.pools import ROWS, SIDE, sparse_zeros

NO_PLACES = np.empty(0, np.int64)


class Change(NamedTuple):
    """
    What update() found, by block number.

    Attributes
    ----------
    whole : bool
        The relief was empty: everything may have changed.
    blocks : ndarray, int64
        Blocks with cells that became occupied, or empty.
    altered : ndarray, shape (blocks of the map, 64), uint8
        A bit per cell that did so; all those of blocks beside which one was let go.
    risen_blocks : ndarray, int64
        Blocks over columns whose ground changed ...
    risen : ndarray, shape (blocks of the map, 64), uint8
        ... and their occupied cells in these columns.

    """

    whole: bool
    blocks: NDArray[np.int64]
    altered: NDArray[np.uint8]
    risen_blocks: NDArray[np.int64]
    risen: NDArray[np.uint8]


class Relief:
    """
    Occupied cells and ground of one map.

    It is made empty, between two frames; the first update() takes everything in, on any thread:
    what a frame changes meanwhile is taken in by the next.

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
    empty : bool
        Whether the first update() has yet to end.
    young : bool
        Whether shapes that were kept may be of before it.

    """

    def __init__(self, memory: Any, up: Up, window: int) -> None:
        blocks = memory.store.capacity['blocks']
        self.up, self.window = up, window
        self.bits = sparse_zeros((blocks, ROWS), np.uint8)
        self.tile = sparse_zeros(blocks, np.int32)
        # Room for a tile a block: nothing as long as the map is copied where the map grows.
        self._room = Ground(sparse_zeros((blocks, 2), np.int32),
                            *(sparse_zeros((blocks, TILE), np.int32) for _ in range(2)))
        self._keys, self._order = np.empty(0, np.int64), np.empty(0, np.int64)      # ascending
        self.empty = self.young = True
        self._seen = memory.clock       # what changed after it was not taken in
        self._there = np.flatnonzero(memory.m.blocks['near'][:memory.n_blocks, 13])
        self._beside = self._below = NO_PLACES      # of what was let go: blocks, tiles

    @property
    def ground(self) -> Ground:
        """Return the Ground of the moment; update() changes its arrays in place."""
        n, room = len(self._keys), self._room
        return Ground(room.tiles[:n], room.lowest[:n], room.level[:n])

    def nbytes(self, n_blocks: int) -> int:
        """Return the bytes in use."""
        return n_blocks * (ROWS + 4) + len(self._keys) * (24 + 8 * TILE)

    def update(self, memory: Any) -> Change:
        """Take in what changed; the mapping thread calls it, once it is not *empty* any more."""
        n, blocks, whole = memory.n_blocks, memory.m.blocks, self.empty
        numbers = self._there
        if not whole:
            numbers = np.flatnonzero(memory.m.stamps['evidence'][:n] > self._seen)
            self._seen = memory.clock
        now = np.zeros((len(numbers), ROWS), np.uint8)
        split(read_bits, len(numbers), blocks, memory.m.voxels, numbers, memory.n_gone > 0, now,
              grain=256)
        other = now ^ self.bits[numbers]
        some = other.any(axis=1)
        numbers, now, other = numbers[some], now[some], other[some]
        self.bits[numbers] = now
        altered, risen = (sparse_zeros((n, ROWS), np.uint8) for _ in range(2))
        altered[numbers] = other
        beside = self._beside[blocks['near'][self._beside, 13] > 0]
        altered[beside] = 255
        tiles, changed = self._enter(memory, numbers, now & other, (now & other != other).any(
            axis=1))
        over, place = NO_PLACES, sparse_zeros(len(self._keys), np.int32)
        if len(tiles) and not whole:
            place[tiles] = np.arange(1, len(tiles) + 1, dtype=np.int32)     # in *changed*, + 1
            over = self._over(blocks, n, place)
        # Also of nothing, lest it be compiled when the ground changes for the first time.
        mark_columns(over, place[self.tile[over]] - 1, self.bits, changed, self.up.i, self.up.j,
                     risen)
        self._there = self._beside = self._below = NO_PLACES
        self.empty = False
        return Change(whole, np.union1d(numbers, beside), altered, over, risen)

    def let_go(self, memory: Any, numbers: NDArray[np.int64]) -> None:
        """Take out blocks that are about to leave the map, on the mapping thread."""
        if self.empty:
            self.__init__(memory, self.up, self.window)     # type: ignore[misc]
            self._there = np.setdiff1d(self._there, numbers)
            return
        near = memory.m.blocks['near'][numbers].reshape(-1).astype(np.int64)
        self._beside = np.setdiff1d(np.union1d(self._beside, near[near > 0] - 1), numbers)
        some = numbers[self.bits[numbers].any(axis=1)]
        self._below = np.union1d(self._below, self.tile[some])
        self.bits[numbers] = 0

    def _over(self, blocks: Any, n: int, marked: NDArray[Any]) -> NDArray[np.int64]:
        """Return the blocks over the tiles that are marked, not zero."""
        over = np.flatnonzero(marked[self.tile[:n]])
        return over[blocks['near'][over, 13] > 0]

    def _enter(self, memory: Any, numbers: NDArray[np.int64], came: NDArray[np.uint8],
               emptied: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """
        Enter cells that became occupied; return tiles, and (t, 64) where their ground changed.

        The lowest voxels are looked for anew below blocks of which cells were *emptied*.

        """
        blocks = memory.m.blocks
        corner = upright(blocks['index'][numbers], self.up)
        own = keys_of(corner[:, :2])
        new, first = np.unique(own[~_among(self._keys, own)], return_index=True)
        if len(new):
            self._grow(new, corner[~_among(self._keys, own)][first][:, :2])
        self.tile[numbers] = self._order[np.searchsorted(self._keys, own)]
        changed = sparse_zeros(len(self._keys), np.uint8)
        below = np.union1d(self._below, self.tile[numbers[emptied]])
        if len(below):
            changed[below] = 1
            self._room.lowest[below] = NONE
            over = self._over(blocks, memory.n_blocks, changed)
            lower_columns(over, self.tile, self.bits[over], upright(
                blocks['index'][over], self.up), self.up, self.ground.lowest, changed)
        lower_columns(numbers, self.tile, came, corner, self.up, self.ground.lowest, changed)
        return self._relevel(np.flatnonzero(changed))

    def _grow(self, keys: NDArray[np.int64], tiles: NDArray[np.int32]) -> None:
        """Take in new tiles, ascending by their keys."""
        n = len(self._keys)
        room = slice(n, n + len(keys))
        self._room.tiles[room] = tiles
        self._room.lowest[room] = self._room.level[room] = NONE
        place = np.searchsorted(self._keys, keys)
        self._keys = np.insert(self._keys, place, keys)
        self._order = np.insert(self._order, place, np.arange(n, n + len(keys)))

    def _relevel(self, changed: NDArray[np.int64],
                 ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Find the ground anew where the lowest of the tiles *changed* did; return where it is."""
        tiles, lowest, level = self._room.tiles, self._room.lowest, self._room.level
        reach = -(-self.window // SIDE)
        if not len(changed):
            return changed, np.empty((0, TILE), bool)
        part, wide, inner = self._around(changed, 4 * reach, 2 * reach)
        part, inner = part[wide], inner[wide]       # level_of wants them sorted, as they are
        found = level_of(tiles[part], lowest[part], self.window, np.flatnonzero(inner))
        part = part[inner]
        other = found != level[part]
        some = other.any(axis=1)
        level[part[some]] = found[some]
        return part[some], other[some]

    def _around(self, some: NDArray[np.int64], *reaches: int) -> tuple[NDArray[Any], ...]:
        """Return tiles around some, ascending, and which lie within each reach, widest first."""
        middle = self._room.tiles[some].astype(np.int64)
        low, high = middle.min(axis=0) - reaches[0], middle.max(axis=0) + reaches[0]
        first, last = np.searchsorted(self._keys, ((low[0] << 32), (high[0] + 1) << 32))
        place = self._room.tiles[self._order[first:last]] - low
        here = np.flatnonzero((place[:, 1] >= 0) & (place[:, 1] <= high[1] - low[1]))
        part, place = self._order[first:last][here], place[here]
        shape = high - low + 1
        if float(shape[0]) * float(shape[1]) > 1e7:     # far apart: all of them
            return (part, *(np.ones(len(part), bool) for _ in reaches))
        return (part, *(_within(middle - low, reach, shape)[place[:, 0], place[:, 1]]
                        for reach in reaches))


def _among(keys: NDArray[np.int64], some: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of some are among ascending keys."""
    if not len(keys):
        return np.zeros(len(some), bool)
    return keys[np.minimum(np.searchsorted(keys, some), len(keys) - 1)] == some


def _within(places: NDArray[np.int64], reach: int,
            shape: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a grid of *shape*: which of its places lie within *reach* of some, by both axes."""
    grid = np.zeros((int(shape[0]) + 1, int(shape[1]) + 1), np.int32)
    for i, j, sign in ((-reach, -reach, 1), (reach + 1, reach + 1, 1),
                       (-reach, reach + 1, -1), (reach + 1, -reach, -1)):
        np.add.at(grid, (np.clip(places[:, 0] + i, 0, shape[0]),
                         np.clip(places[:, 1] + j, 0, shape[1])), sign)
    covered: NDArray[np.bool_] = grid.cumsum(axis=0).cumsum(axis=1) > 0
    return covered
