"""A whole memory as plain arrays and back into pools: what a map file holds (spec section 8)."""

from __future__ import annotations

from dataclasses import dataclass, field as field_of
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.blocks import make_block, new_table
from persem_ros.core.memory.evidence import (
    add_here, add_spilt, count_classes, read_evidence, spill)
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.history import link_of
from persem_ros.core.memory.pools import (
    BLOCKS, CHUNK, CLOCK, INLINE, LINKS, OBSERVATIONS, SIDE, SPILLS, STORED, VOXEL,
    VOXELS)
from persem_ros.core.memory.records import (
    hang_link, take_link, take_voxel, write_link, write_offset)
from persem_ros.core.memory.voxel_memory import VoxelMemory


@dataclass(frozen=True, eq=False)
class Blocks:
    """
    Some blocks with their voxels.

    Blocks are sorted by index, voxels by cell within their block.

    Attributes
    ----------
    block_index : ndarray, shape (B, 3), int32
    block_start : ndarray, shape (B + 1,), int64
        Block b's voxels are rows block_start[b] : block_start[b + 1] of the columns below.
    cell : ndarray, shape (n,), uint16
    observations, switches : ndarray, shape (n,), uint32
    label, majority, last, first_label : ndarray, shape (n,), uint16
    source, dirty, gone : ndarray, shape (n,), uint8
    posterior : ndarray, shape (n,), float32
        Of the label, where the method geometry gave it; 0: none.
    passed : ndarray, shape (n,), uint32
        Looks through the voxel since its last observation (core.frame.clear).
    passed_at : ndarray, shape (n,), int64
        Second of the newest one's stamp; 0 where there is none.
    evidence_start : ndarray, shape (n + 1,), int64
    evidence_class : ndarray, uint16
    evidence_sum : ndarray, float64
        In order of appearance.
    history_start : ndarray, shape (n + 1,), int64
    history_label : ndarray, uint16
    history_confidence : ndarray, float32
    history_frame : ndarray, int32
        Rows of the frame table.
    history_offset : ndarray, shape (., 3), uint8
        Where the points lay in the voxel, 256ths of its edge.

    """

    block_index: np.ndarray
    block_start: np.ndarray
    cell: np.ndarray
    observations: np.ndarray
    switches: np.ndarray
    label: np.ndarray
    majority: np.ndarray
    last: np.ndarray
    first_label: np.ndarray
    source: np.ndarray
    dirty: np.ndarray
    gone: np.ndarray
    posterior: np.ndarray
    passed: np.ndarray
    passed_at: np.ndarray
    evidence_start: np.ndarray
    evidence_class: np.ndarray
    evidence_sum: np.ndarray
    history_start: np.ndarray
    history_label: np.ndarray
    history_confidence: np.ndarray
    history_frame: np.ndarray
    history_offset: np.ndarray

    def voxels(self) -> NDArray[np.int64]:
        """Return the indices of the voxels, (n, 3) int64."""
        cell = self.cell.astype(np.int64)
        corner = np.repeat(self.block_index.astype(np.int64) * SIDE, np.diff(self.block_start),
                           axis=0)
        return corner + np.stack([cell >> 6, cell >> 3 & 7, cell & 7], axis=1)


@dataclass(frozen=True, eq=False)
class MemoryDump(Blocks):
    """
    Everything that a VoxelMemory knows: its blocks, and what goes by the whole map.

    Attributes
    ----------
    voxel_size : float
    origin : tuple of 3 floats
    max_history, session : int
    starts, changes : ndarray, shape (65536,), int64
        Class volatility's counters.
    seen_ids : ndarray, shape (65536,), uint8
    rho : ndarray, shape (65536,), float64, or None
    frames : core.memory.frame_table.FrameTable
    habits : dict of str to ndarray
        The parameters of the method geometry (core.geometry.kept), and with them known, voted,
        uint16: the ids that there were when they were fitted, and all that there are; {}: none.
    fitted_by : tuple or None
        The values of refine.up and refine.geometry that they were fitted with.

    """

    voxel_size: float
    origin: tuple[float, float, float]
    max_history: int
    session: int
    starts: NDArray[np.int64]
    changes: NDArray[np.int64]
    seen_ids: NDArray[np.uint8]
    rho: NDArray[np.float64] | None
    frames: FrameTable
    habits: dict[str, NDArray[Any]] = field_of(default_factory=dict)
    fitted_by: Optional[tuple[Any, ...]] = None


def load(saved: MemoryDump) -> VoxelMemory:
    """Return a VoxelMemory that goes on exactly where the dumped one stood."""
    memory = VoxelMemory(saved.voxel_size, saved.origin, saved.max_history)
    memory.table = new_table(len(saved.block_index) + 512)
    blocks = enter(memory, saved)
    memory.m.used[CLOCK] = 1
    for stamp in ('shown', 'stored'):
        memory.m.stamps[stamp][blocks] = 1
    memory.m.stamps['evidence'][blocks] = memory.m.blocks['changed'][blocks].any(axis=1)
    memory.m.used[OBSERVATIONS] = int(saved.observations.sum(dtype=np.int64))
    take_over(memory, saved)
    return memory


def take_over(memory: VoxelMemory, saved: MemoryDump) -> None:
    """Have a memory go on with a dump's counters and frames, whatever blocks are in memory."""
    memory.m.starts[:] = saved.starts
    memory.m.changes[:] = saved.changes
    memory.seen_ids[:] = saved.seen_ids
    memory.rho = None if saved.rho is None else saved.rho.copy()
    memory.habits, memory.fitted_by = saved.habits, saved.fitted_by
    memory.voted_ids[saved.history_label] = 1
    memory.voted_ids[saved.evidence_class] = 1      # of observations that were let go, too
    for name, ids in (('known', memory.known_ids), ('voted', memory.voted_ids)):
        ids[saved.habits.get(name, [])] = 1
    memory.resume(saved.frames, saved.session)


def enter(memory: VoxelMemory, saved: Blocks) -> NDArray[np.int64]:
    """Enter blocks that are not in memory, with all marks but no stamps; return their numbers."""
    n, block = len(saved.cell), np.empty(len(saved.block_index), np.int64)
    number = np.empty(n, np.int64)
    own = [np.require(getattr(saved, name), VOXEL[name], ('C', 'W')) for name in (
        'switches', 'label', 'majority', 'last', 'first_label', 'source', 'gone')]
    _check_room(memory, saved)
    memory.make_room(len(block), 0)
    _write(memory.m, memory.table, saved.block_index, saved.block_start, saved.cell,
           np.ascontiguousarray(saved.observations), *own, saved.evidence_start,
           saved.evidence_class, saved.evidence_sum, saved.history_start, saved.history_label,
           saved.history_confidence, saved.history_frame, saved.history_offset, saved.dirty,
           block, number)
    memory.relief = None
    memory.growth = None        # some may have the numbers of blocks that left
    memory.n_gone += int(np.count_nonzero(saved.gone))
    if saved.passed.any():
        memory.some_passed = True
        for name, values in (('count', saved.passed), ('second', saved.passed_at),
                             ('n', np.where(saved.passed > 0, saved.observations, 0))):
            memory.store.passed[name][number] = values
    if saved.posterior.any():
        memory.store.beliefs['posterior'][number] = saved.posterior
        memory.store.beliefs['label'][number] = saved.label
    memory.m.used[STORED] += len(saved.history_frame)
    return block


def _check_room(memory: VoxelMemory, saved: Blocks) -> None:
    """Refuse blocks for which the machine's memory would not do, each pool by what it takes."""
    spilt = np.maximum(np.diff(saved.evidence_start) - INLINE, 0)
    n, used, capacity = len(saved.cell), memory.m.used, memory.store.capacity
    for name, place, more in (
            ('blocks', BLOCKS, len(saved.block_index)), ('voxels', VOXELS, n),
            ('links', LINKS, len(saved.history_frame) // CHUNK + n),
            ('spills', SPILLS, int((-(-spilt // INLINE)).sum()))):
        if used[place] + more > capacity[name]:
            memory.store.check_room(max(capacity.values()) + 1)


def evidence_of_voxels(
        memory: VoxelMemory, number: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.float64]]:
    """Return start (n + 1,), classes and sums of the evidence of voxels, by their numbers."""
    pools, start = memory.m, np.zeros(len(number) + 1, np.int64)
    _class_counts(pools.voxels, pools.spills, number, start[1:])
    np.cumsum(start, out=start)
    classes, sums = np.empty(start[-1], np.uint16), np.empty(start[-1])
    _read_evidence(pools.voxels, pools.spills, number, start, classes, sums)
    return start, classes, sums


def looks_through(memory: VoxelMemory, number: NDArray[np.int64], n: NDArray[np.uint32],
                  ) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
    """Return passed and passed_at of voxels with *n* observations, by their numbers."""
    if not memory.some_passed:
        return np.zeros(len(number), np.uint32), np.zeros(len(number), np.int64)
    found = memory.store.passed[number]
    found[found['n'] != n] = 0
    return found['count'], found['second']


def read_histories(memory: VoxelMemory, records: NDArray[np.void]) -> tuple[
        NDArray[np.int64], NDArray[np.uint16], NDArray[np.float32], NDArray[np.int32],
        NDArray[np.uint8]]:
    """
    Return the histories of voxels as their (copied) records have them.

    Any thread may do so while the map grows: links are only ever filled further.

    Returns
    -------
    start : ndarray, shape (n + 1,), int64
    labels, confidences, frames, offsets : ndarray
        As MemoryDump has them.

    """
    stored = records['n'].astype(np.int64) - records['first']
    if memory.kept_history:
        stored = np.minimum(stored, memory.kept_history)
    start = np.zeros(len(records) + 1, np.int64)
    np.cumsum(stored, out=start[1:])
    labels, confidences = np.empty(start[-1], np.uint16), np.empty(start[-1], np.float32)
    frames, where = np.empty(start[-1], np.int32), np.empty((start[-1], 3), np.uint8)
    _read_histories(memory.m.links, memory.m.offsets, records, start, labels, confidences, frames,
                    where)
    return start, labels, confidences, frames, where


def habits_of(
        memory: VoxelMemory) -> tuple[dict[str, NDArray[Any]], Optional[tuple[Any, ...]]]:
    """Return the dump's habits and fitted_by."""
    if memory.geometry is None:
        return memory.habits, memory.fitted_by if memory.habits else None
    ids = {name: np.flatnonzero(some).astype(np.uint16) for name, some in (
        ('known', memory.known_ids), ('voted', memory.voted_ids))}
    return {**memory.geometry.arrays(), **ids}, memory.fitted_by


@kernel
def _class_counts(voxels, spills, number, counts):
    """Write how many classes each voxel has seen."""
    for r in range(len(number)):
        counts[r] = count_classes(voxels[number[r]], spills)


@kernel
def _read_evidence(voxels, spills, number, start, classes, sums):
    """Copy the evidence of the voxels to the columns."""
    for r in range(len(number)):
        read_evidence(voxels[number[r]], spills, classes, sums, start[r])


@kernel
def _read_histories(links, offsets, records, start, labels, confidences, frames, where):
    """Copy the histories of the records to the columns."""
    for r in range(len(records)):
        voxel = records[r]
        n, out = np.int64(voxel.n), start[r]
        begin = n - (start[r + 1] - start[r])
        link = link_of(links, voxel.head, voxel.first, begin)
        for i in range(begin, n):
            if i > begin and i % CHUNK == 0:
                link = np.int64(links[link - 1].next)
            record = links[link - 1]
            labels[out] = record.c[i % CHUNK]
            confidences[out] = record.s[i % CHUNK]
            frames[out] = record.f[i % CHUNK]
            xyz = offsets[link - 1].xyz
            for axis in range(3):
                where[out, axis] = xyz[i % CHUNK * 3 + axis]
            out += 1


@kernel
def _write(pools, table, index, block_start, cell, observations, switches, label, majority, last,
           first_label, source, gone, evidence_start, classes, sums, history_start, labels,
           confidences, frames, where, dirty, made, number):
    """Fill pools from the columns; made and number receive the blocks' and voxels' numbers."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    for b in range(len(index)):
        made[b] = make_block(blocks, used, table, np.int64(index[b, 0]), np.int64(index[b, 1]),
                             np.int64(index[b, 2]))
        block = blocks[made[b]]
        cells, changed = block.cells, block.changed
        for r in range(block_start[b], block_start[b + 1]):
            v = take_voxel(voxels, used)
            number[r] = v
            place = np.int64(cell[r])
            cells[place] = v + 1
            if dirty[r]:
                changed[place >> 3] |= np.uint8(1 << (place & 7))
            voxel = voxels[v]
            voxel.switches, voxel.label, voxel.majority = switches[r], label[r], majority[r]
            voxel.last, voxel.first_label = last[r], first_label[r]
            voxel.source, voxel.gone = source[r], gone[r]
            for e in range(evidence_start[r], evidence_start[r + 1]):
                if not add_here(voxel, classes[e], sums[e]) and \
                        not add_spilt(voxel, spills, classes[e], sums[e]):
                    spill(voxel, spills, used, classes[e], sums[e])
            n = np.int64(observations[r]) - (history_start[r + 1] - history_start[r])
            link, place = np.int64(0), n % CHUNK
            for h in range(history_start[r], history_start[r + 1]):
                if place == CHUNK or link == 0:
                    place = place % CHUNK
                    before, link = max(link, 1), take_link(free, used) + 1
                    hang_link(voxel, links[link - 1], links[before - 1], link, n)
                write_link(links[link - 1], place, labels[h], confidences[h], frames[h])
                write_offset(offsets[link - 1], place, where[h, 0], where[h, 1], where[h, 2])
                place += 1
                n += 1
            voxel.n = n
        block.count = block_start[b + 1] - block_start[b]
