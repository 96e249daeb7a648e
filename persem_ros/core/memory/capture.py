"""
The map of one moment, taken in slices between frames (spec section 9, *Flat*).

The mapping thread copies the voxels' records, a slice at a time, and once more those of the
blocks that changed since; when what is left fits one slice, it is copied too, and that is the
moment. Histories are not copied: they only grow at their ends, so that another thread can read
them as far as the copied records say.

"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.pools import ranges, sparse_zeros, taken
from persem_ros.core.memory.reading import (
    evidence_of_voxels, habits_of, looks_through, read_histories)
from persem_ros.core.memory.voxel_table import sort_order

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory

SLICE = 40_000      # voxels that are copied at once: some 5 ms
BARE = 80_000       # the same without their evidence: some 6 ms
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
    evidence : bool
        False: the dump has none, for whoever adds the observations up again.

    Attributes
    ----------
    moment : int
        The tick of the copy, once step() has returned True.

    """

    def __init__(self, memory: VoxelMemory, since: int | None = None,
                 evidence: bool = True) -> None:
        self._memory, self._since = memory, -1 if since is None else since
        self._evidence = evidence
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
            if voxels is None:
                voxels = SLICE if self._evidence else BARE
            n = max(1, int(np.searchsorted(np.cumsum(counts), voxels)))
            due, counts = due[:n], counts[:n]
        self._slices.append(_copied(memory, due, counts, self._evidence))
        self._copied[due] = memory.clock + 1
        if ended:
            self._small = _small_of(memory)
            self.moment = memory.clock
        return bool(ended)

    def dump(self) -> MemoryDump:
        """Return the MemoryDump of the captured blocks."""
        slices, self._slices = self._slices, []
        saved = _dump_of(self._memory, slices, self._small)
        self.close()
        return saved

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


class Parts:
    """
    A map that nothing changes meanwhile, a part at a time: a whole dump is as large as the map.

    Parameters
    ----------
    memory : VoxelMemory
    voxels : int
        Of a part, about.

    Attributes
    ----------
    head : MemoryDump
        All but the blocks.
    blocks, voxels, observations : int
        How many there are in all.

    """

    def __init__(self, memory: VoxelMemory, voxels: int = SLICE) -> None:
        self._memory, self._most = memory, voxels
        blocks = memory.m.blocks[:memory.n_blocks]
        there = np.flatnonzero(blocks['near'][:, 13] > 0)
        self._numbers = there[sort_order(blocks['index'][there])]
        self._counts = blocks['count'][self._numbers].astype(np.int64)
        self._small = _small_of(memory)
        self.blocks, self.voxels = len(there), int(self._counts.sum())
        self.observations = int(
            memory.m.voxels['n'][memory.listing(there)[2]].sum(dtype=np.int64))
        self.head = self._dump(0, 0)

    def __iter__(self) -> Iterator[MemoryDump]:
        """Yield the blocks in their order."""
        cuts = np.flatnonzero(np.diff(np.cumsum(self._counts) // self._most)) + 1
        for begin, end in zip([0, *cuts], [*cuts, self.blocks]):
            yield self._dump(begin, end)

    def _dump(self, begin: int, end: int) -> MemoryDump:
        blocks, counts = self._numbers[begin:end], self._counts[begin:end]
        return _dump_of(self._memory, [_copied(self._memory, blocks, counts)], self._small)


def _small_of(memory: VoxelMemory) -> tuple[Any, ...]:
    """Return copies of what a MemoryDump has besides blocks, voxel size, origin and bound."""
    return (memory.session, memory.m.starts.copy(), memory.m.changes.copy(),
            memory.seen_ids.copy(), None if memory.rho is None else memory.rho.copy(),
            memory.frames.copy(), *habits_of(memory))


def _dump_of(memory: VoxelMemory, slices: list[_Slice], small: tuple[Any, ...]) -> MemoryDump:
    """Return the MemoryDump of the blocks of slices; of one that is there twice the last copy."""
    block = np.concatenate([one.blocks for one in slices])
    counts = np.concatenate([one.counts for one in slices])
    start = np.concatenate([[0], np.cumsum(counts)])
    last = len(block) - 1 - np.unique(block[::-1], return_index=True)[1]    # newest copies
    index = memory.m.blocks['index'][block[last]]
    order = sort_order(index)
    index, last = index[order], last[order]
    rows = ranges(start[last], counts[last])
    place = np.full(start[-1], -1)
    place[rows] = np.arange(len(rows))
    own = {name: _column(slices, name, place, len(rows))
           for name in ('cell', 'records', 'posterior', 'dirty', 'passed', 'passed_at')}
    records = own['records']
    evidence_start, evidence_class, evidence_sum = _evidence(slices, rows)
    history_start, label, confidence, frame, offset = read_histories(memory, records)
    session, starts, changes, seen_ids, rho, frames, habits, by = small
    return MemoryDump(
        index, np.concatenate([[0], np.cumsum(counts[last])]), own['cell'].astype(np.uint16),
        records['n'], records['switches'], records['label'], records['majority'],
        records['last'], records['first_label'], records['source'], own['dirty'],
        records['gone'], own['posterior'], own['passed'], own['passed_at'],
        evidence_start, evidence_class, evidence_sum, history_start, label, confidence, frame,
        offset, memory.voxel_size, memory.origin, memory.kept_history, session, starts, changes,
        seen_ids, rho, frames, habits, by)


def _copied(memory: VoxelMemory, blocks: NDArray[np.int64], counts: NDArray[np.int64],
            evidence: bool = True) -> _Slice:
    """Return a slice of the given blocks."""
    block, cell, number = memory.listing(blocks)
    records, beliefs = taken(memory.m.voxels, number), taken(memory.store.beliefs, number)
    dirty = memory.m.blocks['changed'][block, cell >> 3] >> (cell & 7).astype(np.uint8) & 1
    posterior = np.where(beliefs['label'] == records['label'], beliefs['posterior'],
                         np.float32(0))
    passed, passed_at = looks_through(memory, number, records['n'])
    start, classes, sums = evidence_of_voxels(memory, number) if evidence else (
        np.zeros(len(number) + 1, np.int64), np.empty(0, np.uint16), np.empty(0))
    return _Slice(blocks, counts, cell, records, posterior, dirty, passed, passed_at, start,
                  classes, sums)


def _column(slices: list[_Slice], name: str, place: NDArray[np.int64], n: int) -> NDArray[Any]:
    """Return a column (n,) of all slices, each row where *place* says; -1: nowhere."""
    kind, begin = getattr(slices[0], name).dtype, 0
    column = np.empty(n, kind)
    # As records without fields: numpy is slow with others.
    whole = column if kind.names is None else column.view(f'V{kind.itemsize}')
    for one in slices:
        part = getattr(one, name).view(whole.dtype)
        there = place[begin:begin + len(part)]
        begin += len(part)
        kept = there >= 0
        whole[there if kept.all() else there[kept]] = part if kept.all() else part[kept]
    return column


def _evidence(slices: list[_Slice], rows: NDArray[np.int64],
              ) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.float64]]:
    """Return start, classes and sums of the evidence of some rows of all slices."""
    if not any(len(one.classes) for one in slices):
        return np.zeros(len(rows) + 1, np.int64), np.empty(0, np.uint16), np.empty(0)
    counts = np.concatenate([np.diff(one.start) for one in slices])
    begin = np.concatenate([[0], np.cumsum(counts)])
    start = np.concatenate([[0], np.cumsum(counts[rows])])
    entries = ranges(begin[rows], counts[rows])
    return (start, np.concatenate([one.classes for one in slices]).take(entries),
            np.concatenate([one.sums for one in slices]).take(entries))
