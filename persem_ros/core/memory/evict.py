"""Letting go of what is far away, so that a long flight fits a bounded memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.blocks import remove_block
from persem_ros.core.memory.pools import (
    CELLS, CLOCK, FIRST_BLOCK, FIRST_SPILL, FIRST_VOXEL, FREE, FREE_BLOCKS, FREE_SPILLS,
    FREE_VOXELS, INLINE, ROWS, SIDE, STORED)

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory


def keep_near(memory: VoxelMemory, position: tuple[float, float, float], radius: float = 0.0,
              max_voxels: int = 0, at_once: int = 0) -> int:
    """
    Drop the blocks farther than *radius* from *position*, then the farthest beyond *max_voxels*.

    Class volatility and the number of observations keep counting what was dropped.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map.
    position : sequence of 3 floats
        Metres in the map frame.
    radius : float
        Metres; 0: no limit.
    max_voxels : int
        0: no limit. When there are more, a tenth more than necessary goes, so that not every
        frame has to drop some.
    at_once : int
        Voxels that one call drops, the farthest; 0: no limit. The last block may exceed it.

    Returns
    -------
    int
        Number of voxels dropped; 0 while a refinement or a save is under way, which
        may still read them.

    """
    if memory.read_beside or not memory.n_voxels:
        return 0
    live = np.flatnonzero(memory.m.blocks['near'][:memory.n_blocks, 13])
    return leave(memory, farthest(memory, live, position, radius, max_voxels, at_once))


def farthest(memory: VoxelMemory, blocks: NDArray[np.int64], position: ArrayLike, radius: float,
             max_voxels: int, at_once: int) -> NDArray[np.int64]:
    """Return which of the given blocks, by number, go by the rule of keep_near(); they exist."""
    crowded = 0 < max_voxels < memory.n_voxels
    if not (radius > 0 or crowded):
        return blocks[:0]
    records = memory.m.blocks
    away = (records['index'][blocks] + 0.5) * (SIDE * memory.voxel_size) \
        - (np.asarray(position) - memory.origin)
    distance = np.linalg.norm(away, axis=1)
    order = np.argsort(-distance, kind='stable')
    counts = records['count'][blocks[order]].astype(np.int64)
    before = np.cumsum(counts) - counts     # voxels that lie farther
    go = np.zeros(len(blocks), bool)
    if radius > 0:
        go |= distance[order] > radius
    if crowded:
        go |= before < memory.n_voxels - int(0.9 * max_voxels)
    if at_once > 0:
        go &= before < at_once
    return blocks[order[go]]


def leave(memory: VoxelMemory, blocks: NDArray[np.int64], kept: bool = False) -> int:
    """Drop blocks as drop() does, if there are any; return how many voxels that were."""
    before = memory.n_voxels
    if len(blocks):
        drop(memory, blocks, kept)
    return before - memory.n_voxels


def drop(memory: VoxelMemory, numbers: NDArray[np.int64], kept: bool = False) -> None:
    """
    Drop whole blocks by number, when nobody reads beside.

    What lies beside them has other neighbours now and counts as changed, unless they are *kept*
    elsewhere: then they are not forgotten.

    """
    numbers = np.asarray(numbers, np.int64)
    index = memory.m.blocks['index'][numbers]
    for viewer in memory.viewers:
        viewer.gone.append((kept, index))
    memory.growth = None
    cells = memory.m.blocks['cells'][numbers]
    memory.store.beliefs['posterior'][cells[cells > 0] - 1] = 0.0
    memory.store.voted['n'][cells[cells > 0] - 1] = 0
    if memory.some_passed:
        memory.store.passed[cells[cells > 0] - 1] = 0
    if memory.relief is not None:
        memory.relief.let_go(memory, numbers)
    _drop(memory.m, memory.table, numbers, kept)
    if kept and memory.geometry is not None:    # it looks farther than the blocks beside
        memory.refined_with = None


@kernel
def _drop(pools, table, numbers, kept):
    """Give the records of the blocks back to their pools, zeroed."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    used[CLOCK] += 1
    for b in numbers:
        remove_block(blocks, table, b)
        block = blocks[b]
        cells, near, changed = block.cells, block.near, block.changed
        for cell in range(CELLS):
            v = np.int64(cells[cell]) - 1
            if v < 0:
                continue
            cells[cell] = 0
            voxel = voxels[v]
            used[STORED] -= np.int64(voxel.n) - np.int64(voxel.first)
            link = np.int64(voxel.head)
            while link > 0:
                free[used[FREE]] = link - 1
                used[FREE] += 1
                link = np.int64(links[link - 1].next)
            number = np.int64(voxel.more)
            while number > 0:
                after = np.int64(spills[number - 1].next)
                _clear(spills[number - 1])
                spills[number - 1].next = used[FIRST_SPILL]
                used[FIRST_SPILL] = number
                used[FREE_SPILLS] += 1
                number = after
            _clear(voxel)
            voxel.n = voxel.switches = voxel.tail = voxel.first = voxel.more = 0
            voxel.majority = voxel.label = voxel.last = voxel.source = 0
            voxel.first_label = voxel.gone = 0
            voxel.head = used[FIRST_VOXEL]
            used[FIRST_VOXEL] = v + 1
            used[FREE_VOXELS] += 1
        for d in range(27):
            if near[d] > 0:
                other = np.int64(near[d]) - 1
                beside, marks = blocks[other].near, blocks[other].changed
                beside[26 - d] = 0
                near[d] = 0
                if kept:
                    continue
                stamps[other].evidence = used[CLOCK]
                stamps[other].stored = used[CLOCK]
                for row in range(ROWS):
                    marks[row] = 255
        for row in range(ROWS):
            changed[row] = 0
        stamps[b].evidence = 0
        stamps[b].stored = 0
        stamps[b].shown = 0 if kept else used[CLOCK]
        block.count = used[FIRST_BLOCK]
        used[FIRST_BLOCK] = b + 1
        used[FREE_BLOCKS] += 1


@inlined
def _clear(record):
    """Forget the evidence of a voxel or spill record."""
    sums, classes = record.sums, record.classes
    for k in range(INLINE):
        sums[k] = 0.0
        classes[k] = 0
