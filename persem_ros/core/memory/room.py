"""Finding the voxels of a frame's observations, and making room for what is new. Kernels only."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.blocks import find_block, make_block
from persem_ros.core.memory.pools import CHUNK, CLOCK, SIDE
from persem_ros.core.memory.records import mark, take_link, take_voxel
from persem_ros.frames import UNKNOWN

AHEAD = 1024        # observations whose records are fetched at once; they fit the cache
# What the observations of a part take: links, how many of the voxels' oldest links they retire,
# the change of the observations stored, and how many wait for a spill record.
PART = np.dtype([('links', 'i8'), ('drops', 'i8'), ('stored', 'i8'), ('late', 'i8')])


@kernel
def look_up(begin, end, pools, table, places, labels, max_history, rows, block_of, parts):
    """Find blocks and voxels of parts begin .. end, -1: not there; count what each will take."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    touched = 0
    for part in range(begin, end):
        first, stop = part_of(part, len(parts), len(labels))
        for p in range(first, stop, AHEAD):
            q = min(p + AHEAD, stop)
            find(blocks, table, places, p, q, rows, block_of)
            touched += count_needs(voxels, links, offsets, labels, p, q, max_history, rows,
                                   parts[part])
    return touched


@inlined
def part_of(part, parts, n):
    """Return the first of the observations of a part, and their end."""
    return part * n // parts, (part + 1) * n // parts


@inlined
def find(blocks, table, places, begin, end, rows, block_of):
    """Find blocks and voxels of observations begin .. end."""
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(begin, end):
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:    # most follow one of the same block
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
        rows[p], block_of[p] = -1, b
        if b >= 0:
            cells = blocks[b].cells
            rows[p] = np.int64(cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)]) - 1


@inlined
def count_needs(voxels, links, offsets, labels, begin, end, max_history, rows, part):
    """
    Count what observations begin .. end take, and read the records they will be written to.

    Most of the time that adding takes is waiting for memory. A loop that only reads waits for a
    dozen records at once, one that also works for one or two: this pass halves the time.

    """
    touched, taken, dropped = 0, 0, 0
    for p in range(begin, end):
        n, tail, first = 0, np.int64(0), np.int64(0)
        if rows[p] >= 0:
            voxel = voxels[rows[p]]
            n, tail, first = np.int64(voxel.n), np.int64(voxel.tail), np.int64(voxel.first)
            if tail > 0:
                touched += links[tail - 1].next
                touched += offsets[tail - 1].xyz[0]
        if labels[p] != UNKNOWN:
            taken += n % CHUNK == 0 or tail == 0
            dropped += max_history > 0 and tail > 0 and n + 1 - first >= max_history + CHUNK
    part.links += taken
    part.drops += dropped
    return touched


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
        cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)] = v + 1
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
