"""Finding the voxels of a frame's observations, and making room for what is new. Kernels only."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.blocks import find_block, make_block
from persem_ros.core.memory.pools import BLOCK, CLOCK, SIDE
from persem_ros.core.memory.records import mark, take_link, take_voxel
from persem_ros.core.prefetch import prefetch
from persem_ros.frames import UNKNOWN

CELLS_AT = dict(BLOCK.fields or {})['cells'][1]     # where a block has its cells, bytes


@inlined
def part_of(part, parts, n):
    """Return the first of the observations of a part, and their end."""
    return part * n // parts, (part + 1) * n // parts


@inlined
def cell_of(i, j, k):
    """Return which of its block's cells a voxel is."""
    return ((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)


@inlined
def find(blocks, table, places, begin, end, block_of):
    """Find the blocks of observations begin .. end, -1: not there, and ask for their cells."""
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(begin, end):
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:    # most follow one of the same block
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
        block_of[p] = b
        prefetch(blocks, max(b, 0), CELLS_AT + 4 * cell_of(i, j, k))


@inlined
def fetch(blocks, voxels, links, offsets, places, begin, end, rows, block_of):
    """Find the voxels of observations begin .. end, -1: not there, and ask for their records."""
    for p in range(begin, end):
        b, rows[p] = block_of[p], -1
        if b >= 0:
            i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
            cells = blocks[b].cells
            rows[p] = np.int64(cells[cell_of(i, j, k)]) - 1
            prefetch(voxels, rows[p], 0)
    for p in range(begin, end):
        if rows[p] >= 0:
            link = np.int64(voxels[rows[p]].tail) - 1
            prefetch(links, link, 0)
            prefetch(offsets, link, 0)


@kernel
def make_room(pools, table, places, labels, rows, block_of, fresh):
    """Make blocks and voxels that are missing, mark all, write the links to take to *fresh*."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    used[CLOCK] += 1
    make_voxels(blocks, voxels, used, table, places, labels, rows, block_of)
    mark_all(blocks, stamps, used[CLOCK], places, labels, block_of)
    for q in range(len(fresh)):
        fresh[q] = take_link(free, used)


@inlined
def make_voxels(blocks, voxels, used, table, places, labels, rows, block_of):
    """
    Make the voxels of observations that are missing, and their blocks.

    No array is handed on for each voxel: numba would count references to it, by instructions
    that wait for all that was written before (a fifth of the time that adding took over new
    ground).

    """
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(len(rows)):
        if rows[p] >= 0 or labels[p] == UNKNOWN:
            continue
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = block_of[p]
            if b < 0:       # an observation before this one may have made it
                b = find_block(blocks, table, oi, oj, ok)
            if b < 0:
                b = make_block(blocks, used, table, oi, oj, ok)
        v = take_voxel(voxels, used)
        cells = blocks[b].cells
        cells[cell_of(i, j, k)] = v + 1
        blocks[b].count += 1
        rows[p], block_of[p] = v, b


@inlined
def mark_all(blocks, stamps, now, places, labels, block_of):
    """Mark the voxels of all observations as changed now."""
    for p in range(len(labels)):
        if labels[p] != UNKNOWN:
            b = block_of[p]
            mark(blocks[b], stamps[b], now, np.int64(places[p, 0]), np.int64(places[p, 1]),
                 np.int64(places[p, 2]))
