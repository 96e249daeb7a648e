"""A dump, or some blocks of one, back in the pools: a memory that goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.blocks import make_block, new_table
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.evidence import add_here, add_spilt, spill
from persem_ros.core.memory.pools import (
    BLOCKS, CHUNK, CLOCK, INLINE, LINKS, OBSERVATIONS, SPILLS, STORED, VOXEL, VOXELS)
from persem_ros.core.memory.records import (
    hang_link, take_link, take_voxel, write_link, write_offset)
from persem_ros.core.memory.voxel_memory import VoxelMemory


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
