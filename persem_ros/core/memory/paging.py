"""
A memory that holds a part of a map; a store holds the whole of it (spec section 9).

The core knows no files: it is handed a store that reads blocks and writes what changed.

"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.checkpoint import Checkpoint
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.evict import farthest, leave
from persem_ros.core.memory.frame_pages import PAGE, pages_of
from persem_ros.core.memory.loading import enter
from persem_ros.core.memory.pools import CLOCK, longer, SIDE, sparse_zeros

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory

# m along the order of indices: from so far ahead, whatever comes first in it is farthest.
AHEAD = np.array([1e9, 1e5, 0.0])
# Of a block: what is around was never asked for; is here; was here, and a part of it left.
ALONE, RINGED, LEFT = range(3)
KNOWN = 4               # so many times the blocks in memory are known not to be in the store


class Backing(Protocol):
    """What holds the whole map."""

    def index(self) -> NDArray[np.int32]:
        """Return the indices of all blocks, (n, 3) int32, ascending."""

    def read(self, index: NDArray[np.int32]) -> Blocks:
        """Return those of the blocks with the given indices (n, 3) that are there."""

    def write(self, changed: MemoryDump) -> None:
        """Take blocks, counters and frames over, all at once; an exception: nothing of it."""


class Pager:
    """
    Brings blocks into memory when they are needed, and lets go of those that the store has.

    All methods but Checkpoint.write() belong to the thread that owns the map.

    Parameters
    ----------
    memory : VoxelMemory
        Empty, or all that the store does not have.
    backing : Backing
        The store.

    Attributes
    ----------
    moment : int
        The tick of the last state of the map that the store holds.
    columns : core.geometry.columns.Columns or None
        The lowest voxels of all columns that were looked at, for the method geometry.
    turn : int
        How often blocks came or left.

    """

    def __init__(self, memory: VoxelMemory, backing: Backing) -> None:
        self.memory, self.backing = memory, backing
        memory.pager = self
        self.moment = self.turn = 0
        self.columns: Any = None
        self._absent: set[tuple[int, ...]] = set()  # blocks that the store is known not to have
        # By block number: pages of the frames that observed it, up to the last checkpoint.
        self._seen_by = sparse_zeros((0, 0), np.bool_)
        self._ringed = sparse_zeros(0, np.uint8)    # by block number: ALONE, RINGED or LEFT
        self._sharing = False       # whether frames bring what the next refinement will need
        self._moved = sparse_zeros(0, np.int64)     # by block number: the turn it came or left at

    def need(self, index: NDArray[np.int32]) -> None:
        """Bring the blocks with these indices (n, 3) into memory, where the store has them."""
        memory = self.memory
        index = np.unique(index, axis=0)
        numbers = block_numbers(memory, index)
        keys = [key for key in map(tuple, index[numbers < 0].tolist()) if key not in self._absent]
        if not keys:
            return
        found = self.backing.read(np.array(keys, np.int32))
        if len(self._absent) > KNOWN * (memory.n_blocks + SIDE ** 3):
            self._absent = set()
        self._absent |= set(keys) - set(map(tuple, found.block_index.tolist()))
        if not len(found.block_index):
            return
        memory.m.used[CLOCK] += 1
        blocks = enter(memory, found)
        memory.frames.bring(found.history_frame)
        self._note_seen(blocks, pages_of(found))
        stamps = memory.m.stamps
        stamps['shown'][blocks] = memory.clock
        stamps['evidence'][blocks] = stamps['stored'][blocks] = 0
        self._room()[blocks] = ALONE
        self._note(blocks)

    def need_voxels(self, voxels: NDArray[np.int32]) -> None:
        """Bring the blocks of voxels (n, 3) into memory: they are about to be observed."""
        blocks = voxels >> 3
        if len(blocks):
            new = np.ones(len(blocks), bool)        # most follow one of the same block
            new[1:] = (blocks[1:] != blocks[:-1]).any(axis=1)
            self.need(blocks[new])
        if self._sharing:
            changed = self.memory.changed_blocks()
            self.need_around(changed[self._room()[changed] == ALONE])

    def need_changed(self) -> NDArray[np.int64]:
        """
        Bring all blocks around those that changed into memory; return the numbers of these.

        From now on frames do their share of that, lest all of it be left to the moment at which
        a refinement begins: once a block, for in a memory that holds little more than what is in
        view its ring leaves with every frame.

        """
        self._sharing, changed = True, self.memory.changed_blocks()
        self.need_around(changed)
        return changed

    def need_around(self, blocks: NDArray[np.int64]) -> None:
        """Bring all blocks around those with the given numbers into memory."""
        blocks = blocks[self._room()[blocks] != RINGED]
        if not len(blocks):
            return
        steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing='ij'), axis=-1).reshape(-1, 3)
        around = self.memory.m.blocks['index'][blocks][:, None] + steps
        missing = self.memory.m.blocks['near'][blocks] == 0
        self.need(around[missing].astype(np.int32))
        self._room()[blocks] = RINGED

    def ringed(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those of the blocks around which everything is in memory."""
        return blocks[self._room()[blocks] == RINGED]

    def index(self) -> NDArray[np.int32]:
        """Return the indices of all blocks, those in memory and those in the store, ascending."""
        blocks, n = self.memory.m.blocks, self.memory.n_blocks
        here = blocks['index'][:n][blocks['near'][:n, 13] > 0]
        return np.unique(np.concatenate([here, self.backing.index()]), axis=0)

    def visit(self, index: NDArray[np.int32], at_once: int, max_voxels: int,
              saves: bool = True) -> Iterator[NDArray[np.int64]]:
        """
        Yield the numbers of blocks with all around them in memory, some at a time.

        Parameters
        ----------
        index : ndarray, shape (n, 3), int32
            The blocks; damaged ones are left out.
        at_once : int
            How many at a time.
        max_voxels : int
            The bound of memory, between two steps; 0: none.
        saves : bool
            Bring the store up to date where that makes room; False: somebody else does so.

        """
        memory = self.memory
        for at in range(0, len(index), at_once):
            part = index[at:at + at_once]
            self.need(part)
            numbers = block_numbers(memory, part)
            numbers = numbers[numbers >= 0]
            self.need_around(numbers)
            yield numbers
            if 0 < max_voxels < memory.n_voxels:
                if saves and self.dirty_voxels:
                    self.save()
                here = part[-1] * SIDE * memory.voxel_size + memory.origin
                self.let_go(here + AHEAD, max_voxels)   # what was visited, the first first

    def let_go(self, position: ArrayLike, max_voxels: int = 0, radius: float = 0.0,
               at_once: int = 0) -> int:
        """
        Let go of clean blocks, the farthest first.

        Parameters
        ----------
        position : sequence of 3 floats
            Metres in the map frame.
        max_voxels, radius, at_once : int, float, int
            As in core.memory.evict.keep_near; the bound is kept as far as clean blocks suffice.

        Returns
        -------
        int
            Number of voxels that left memory.

        """
        memory = self.memory
        if memory.read_beside:
            return 0
        blocks = memory.m.blocks
        clean = np.flatnonzero(memory.m.stamps['stored'][:memory.n_blocks] <= self.moment)
        clean = clean[blocks['near'][clean, 13] > 0]
        numbers = farthest(memory, clean, position, radius, max_voxels, at_once)
        near = blocks['near'][numbers].reshape(-1)
        near, marks = near[near > 0].astype(np.int64) - 1, self._room()
        marks[near[marks[near] == RINGED]] = LEFT
        marks[numbers] = ALONE
        self._absent -= set(map(tuple, blocks['index'][numbers].tolist()))
        self._note(numbers)
        self._seen_by[numbers[numbers < len(self._seen_by)]] = False
        return leave(memory, numbers, kept=True)

    def moved_since(self, blocks: NDArray[np.int64], turns: NDArray[np.int64],
                    ) -> NDArray[np.bool_]:
        """Return of each block number whether another block may have it than had it at a turn."""
        self._room()
        return self._moved[blocks] > turns

    @property
    def dirty_voxels(self) -> int:
        """Return how many voxels lie in blocks that changed since the store's state."""
        memory = self.memory
        changed = np.flatnonzero(memory.m.stamps['stored'][:memory.n_blocks] > self.moment)
        return int(memory.m.blocks['count'][changed].sum(dtype=np.int64))

    def checkpoint(self) -> Checkpoint:
        """Return the beginning of a checkpoint."""
        return Checkpoint(self)

    def save(self) -> None:
        """Bring the store up to date at once."""
        checkpoint = self.checkpoint()
        try:
            checkpoint.capture.step(np.inf)
            checkpoint.write()
        finally:
            checkpoint.end()

    def note_stored(self, index: NDArray[np.int32], pages: NDArray[np.bool_], rows: int) -> None:
        """
        Let go of the frames that no block in memory refers to: the store has them.

        Parameters
        ----------
        index : ndarray, shape (n, 3), int32
            The blocks that changed since the last time.
        pages : ndarray, shape (n, pages), bool
            Which pages of the frame table hold frames that observed each.
        rows : int
            How many frames the store has.

        """
        memory, numbers = self.memory, block_numbers(self.memory, index)
        self._note_seen(numbers[numbers >= 0], pages[numbers >= 0])
        if memory.read_beside:
            return              # next time
        # The last row stays: it is asked for without a look at what is here.
        unused = np.ones(min(rows, max(len(memory.frames) - 1, 0)) // PAGE, bool)
        used = self._seen_by.any(axis=0)[:len(unused)]
        unused[:len(used)] &= ~used
        memory.frames.release(np.flatnonzero(unused).tolist())

    def _note_seen(self, blocks: NDArray[np.int64], pages: NDArray[np.bool_]) -> None:
        """Note which pages hold frames that observed some blocks, by their numbers."""
        n, wide = self.memory.n_blocks, pages.shape[1]
        if n > len(self._seen_by) or wide > self._seen_by.shape[1]:
            before = self._seen_by
            rows, columns = before.shape
            self._seen_by = sparse_zeros((max(2 * n, rows), max(2 * wide, columns)), np.bool_)
            self._seen_by[:rows, :columns] = before
        self._seen_by[blocks] = False
        self._seen_by[blocks, :wide] = pages

    def _room(self) -> NDArray[np.uint8]:
        """Return the marks of the rings, long enough for all blocks."""
        n = self.memory.n_blocks
        if n > len(self._ringed):
            self._ringed, self._moved = longer(self._ringed, 2 * n), longer(self._moved, 2 * n)
        return self._ringed

    def _note(self, blocks: NDArray[np.int64]) -> None:
        """Note that blocks with these numbers came, or leave."""
        if len(blocks):
            self.turn += 1
            self._room()
            self._moved[blocks] = self.turn
