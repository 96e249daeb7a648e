"""
The map of one moment, taken in slices between frames (spec section 9, *Flat*).

The mapping thread copies the voxels' records, a slice at a time, and once more those of the
blocks that changed since; when what is left fits one slice, it is copied too, and that is the
moment. Histories are not copied: they only grow at their ends, so that another thread can read
them as far as the copied records say.

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.dump import (
    evidence_of_voxels, habits_of, looks_through, MemoryDump, read_histories)
from persem_ros.core.memory.pools import ranges, sparse_zeros
from persem_ros.core.memory.voxel_memory import sort_order

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory

SLICE = 40_000      # voxels that are copied at once: some 5 ms
LAST = 60_000       # so many may be left at the end, which are copied at once
PATIENCE = 1.5      # how many times more after each time that more were left


@dataclass(frozen=True, eq=False)
class _Slice:
    """Copies of the records of some blocks."""

    blocks: NDArray[np.int64]           # their numbers
    counts: NDArray[np.int64]
    cell: NDArray[np.int64]
    records: NDArray[np.void]
    posterior: NDArray[np.float32]
    dirty: NDArray[np.uint8]
    passed: NDArray[np.uint32]
    passed_at: NDArray[np.int64]
    start: NDArray[np.int64]            # of the evidence
    classes: NDArray[np.uint16]
    sums: NDArray[np.float64]


class Capture:
    """
    A copy of the blocks of a map that changed since a tick, of one moment.

    step() until it returns True, on the thread that owns the map; then dump() on any. In between
    no block may leave the map and no link of a history be used again (VoxelMemory.read_beside);
    that ends with dump() or close().

    Parameters
    ----------
    memory : VoxelMemory
        The map.
    since : int, optional
        A tick of its clock: blocks that did not change after it are left out; None: none is.

    Attributes
    ----------
    moment : int
        The tick of the copy, once step() has returned True.

    """

    def __init__(self, memory: VoxelMemory, since: int | None = None) -> None:
        self._memory, self._since = memory, -1 if since is None else since
        self._copied = sparse_zeros(max(1, memory.n_blocks), np.int64)
        self._slices: list[_Slice] = []
        self._most = float(LAST)
        self.moment = 0
        memory.captures.add(self)

    def step(self, voxels: float | None = None) -> bool:
        """Copy the next slice, of *voxels* voxels at most; return whether it was the last."""
        memory = self._memory
        due, fresh = self._due()
        counts = memory.m.blocks['count'][due].astype(np.int64)
        ended = counts.sum() <= (self._most if voxels is None else voxels)
        if not ended:
            if len(fresh):
                due, counts = fresh, memory.m.blocks['count'][fresh].astype(np.int64)
            else:
                self._most *= PATIENCE
            most = SLICE if voxels is None else voxels
            n = max(1, int(np.searchsorted(np.cumsum(counts), most)))
            due, counts = due[:n], counts[:n]
        self._slices.append(_copied(memory, due, counts))
        self._copied[due] = memory.clock + 1
        if ended:
            self._small = (
                memory.session, memory.m.starts.copy(), memory.m.changes.copy(),
                memory.seen_ids.copy(), None if memory.rho is None else memory.rho.copy(),
                memory.frames.copy(), *habits_of(memory))
            self.moment = memory.clock
        return bool(ended)

    def dump(self) -> MemoryDump:
        """Return the MemoryDump of the captured blocks."""
        memory = self._memory
        slices, self._slices = self._slices, []
        block = np.concatenate([one.blocks for one in slices])
        counts = np.concatenate([one.counts for one in slices])
        start = np.concatenate([[0], np.cumsum(counts)])
        last = len(block) - 1 - np.unique(block[::-1], return_index=True)[1]    # newest copies
        index = memory.m.blocks['index'][block[last]]
        order = sort_order(index)
        index, last = index[order], last[order]
        rows = ranges(start[last], counts[last])
        joined = {name: np.concatenate([getattr(one, name) for one in slices])[rows]
                  for name in ('cell', 'records', 'posterior', 'dirty', 'passed', 'passed_at')}
        records = joined['records']
        evidence = _evidence(slices, rows)
        history_start, *history = read_histories(memory, records)
        self.close()
        session, starts, changes, seen_ids, rho, frames, habits, by = self._small
        return MemoryDump(
            index, np.concatenate([[0], np.cumsum(counts[last])]),
            joined['cell'].astype(np.uint16),
            records['n'], records['switches'], records['label'], records['majority'],
            records['last'], records['first_label'], records['source'], joined['dirty'],
            records['gone'], joined['posterior'], joined['passed'], joined['passed_at'],
            *evidence, history_start, *history, memory.voxel_size,
            memory.origin, memory.kept_history, session, starts, changes, seen_ids, rho, frames,
            habits, by)

    def close(self) -> None:
        """Read nothing more of the map."""
        self._memory.captures.discard(self)

    def _due(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of the blocks to be copied, and of those never copied so far."""
        memory = self._memory
        n = memory.n_blocks
        if n > len(self._copied):
            copied = sparse_zeros(2 * n, np.int64)
            copied[:len(self._copied)] = self._copied
            self._copied = copied
        copied, stamps = self._copied[:n], memory.m.stamps['stored'][:n]
        due = np.flatnonzero((stamps > self._since) & (stamps >= copied))
        due = due[memory.m.blocks['near'][due, 13] > 0]
        return due, due[copied[due] == 0]


def dump(memory: VoxelMemory) -> MemoryDump:
    """Return the MemoryDump of a VoxelMemory as it is now; the arrays are copies."""
    capture = Capture(memory)
    capture.step(np.inf)
    return capture.dump()


def _copied(memory: VoxelMemory, blocks: NDArray[np.int64], counts: NDArray[np.int64]) -> _Slice:
    """Return a slice of the given blocks."""
    block, cell, number = memory.listing(blocks)
    records, beliefs = memory.m.voxels[number], memory.store.beliefs[number]
    dirty = memory.m.blocks['changed'][block, cell >> 3] >> (cell & 7).astype(np.uint8) & 1
    posterior = np.where(beliefs['label'] == records['label'], beliefs['posterior'],
                         np.float32(0))
    return _Slice(blocks, counts, cell, records, posterior, dirty,
                  *looks_through(memory, number, records['n']),
                  *evidence_of_voxels(memory, number))


def _evidence(slices: list[_Slice], rows: NDArray[np.int64],
              ) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.float64]]:
    """Return start, classes and sums of the evidence of some rows of all slices."""
    counts = np.concatenate([np.diff(one.start) for one in slices])
    begin = np.concatenate([[0], np.cumsum(counts)])
    start = np.concatenate([[0], np.cumsum(counts[rows])])
    entries = ranges(begin[rows], counts[rows])
    return (start, np.concatenate([one.classes for one in slices])[entries],
            np.concatenate([one.sums for one in slices])[entries])
