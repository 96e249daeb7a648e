"""Adding observations to voxels: histories and counters. Kernels only."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.blocks import find_block, make_block
from persem_ros.core.memory.evidence import add_here, majority, majority_here, spill
from persem_ros.core.memory.pools import (
    CHUNK, CLOCK, FIRST_VOXEL, FREE, FREE_VOXELS, LINKS, OBSERVATIONS, RETIRED, SIDE, STORED,
    VOXELS)
from persem_ros.frames import UNKNOWN

AHEAD = 1024        # observations whose records are fetched at once; they fit the cache


@kernel
def add_observations(pools, table, places, labels, confidences, where, f, max_history, rows):
    """
    Append the observations of frame f; rows (n,) int64 receives each one's voxel number or -1.

    The hash table has room for as many new blocks as there are observations.

    """
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    added, touched = 0, 0
    used[CLOCK] += 1
    for begin in range(0, len(labels), AHEAD):
        end = min(begin + AHEAD, len(labels))
        missing = look_up(blocks, stamps, used[CLOCK], table, places, labels, begin, end, rows)
        if missing > 0:
            make_voxels(blocks, voxels, stamps, used, table, places, labels, begin, end, rows)
        touched += fetch_tails(voxels, links, offsets, begin, end, rows)
        for p in range(begin, end):
            c = labels[p]
            if c == UNKNOWN:
                rows[p] = -1
                continue
            voxel = voxels[rows[p]]
            added += 1
            if voxel.n > 0:
                before = voxel.last
                starts[before] += 1
                if before != c:
                    changes[before] += 1
                    voxel.switches += 1
            n = np.int64(voxel.n)
            number = np.int64(voxel.tail)
            if n % CHUNK == 0 or number == 0:
                number = take_link(free, used) + 1
                hang_link(voxel, links[number - 1], links[max(np.int64(voxel.tail), 1) - 1],
                          number, n)
            write(links[number - 1], n % CHUNK, c, confidences[p], f)
            write_offset(offsets[number - 1], n % CHUNK, where[p, 0], where[p, 1], where[p, 2])
            if max_history > 0 and n + 1 - np.int64(voxel.first) >= max_history + CHUNK:
                drop_oldest(voxel, links, retired, used)
            if not add_here(voxel, c, np.float64(confidences[p])):
                spill(voxel, spills, used, c, np.float64(confidences[p]))
            followed = n == 0 or voxel.label == voxel.majority
            if n == 0 or c != voxel.majority:   # more evidence for the majority keeps it
                voxel.majority = majority_here(voxel) if voxel.more == 0 \
                    else majority(voxel, spills)
            if followed:        # what no refinement moved follows the majority
                voxel.label = voxel.majority
                voxel.source = 0
            if n == 0:
                voxel.first_label = c
            voxel.gone = 0
            voxel.n = n + 1
            voxel.last = c
    used[OBSERVATIONS] += added
    used[STORED] += added
    return touched


@inlined
def look_up(blocks, stamps, now, table, places, labels, begin, end, rows):
    """Find the voxels of observations begin .. end and mark them; return how many are new, -1."""
    b, missing = np.int64(-1), 0
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(begin, end):
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:    # most follow one of the same block
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
        rows[p] = -1
        if b >= 0:
            cells = blocks[b].cells
            rows[p] = np.int64(cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)]) - 1
            if labels[p] != UNKNOWN:
                mark(blocks[b], stamps[b], now, i, j, k)
        missing += rows[p] < 0
    return missing


@inlined
def make_voxels(blocks, voxels, stamps, used, table, places, labels, begin, end, rows):
    """
    Make the voxels of observations begin .. end that are missing, and their blocks.

    In a loop of its own, and no array is handed on for each voxel: numba would count references
    to it, by instructions that wait for all that was written before (a fifth of the time that
    adding took over new ground).

    """
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(begin, end):
        if rows[p] >= 0 or labels[p] == UNKNOWN:
            continue
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
            if b < 0:
                b = make_block(blocks, used, table, oi, oj, ok)
        v = take_voxel(voxels, used)
        cells = blocks[b].cells
        cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)] = v + 1
        blocks[b].count += 1
        mark(blocks[b], stamps[b], used[CLOCK], i, j, k)
        rows[p] = v


@inlined
def fetch_tails(voxels, links, offsets, begin, end, rows):
    """
    Read the records that observations begin .. end will be written to.

    Most of the time that adding takes is waiting for memory. A loop that only reads waits for a
    dozen records at once, one that also works for one or two: this pass halves the time.

    """
    touched = 0
    for p in range(begin, end):
        if rows[p] >= 0:
            tail = np.int64(voxels[rows[p]].tail) - 1
            if tail >= 0:
                touched += links[tail].next
                touched += offsets[tail].xyz[0]
    return touched


@inlined
def mark(block, stamp, now, i, j, k):
    """Mark the voxel with the index (i, j, k) as changed now, a tick of the clock."""
    changed = block.changed
    changed[(i & 7) * SIDE + (j & 7)] |= np.uint8(1 << (k & 7))
    stamp.evidence = now
    stamp.shown = now
    stamp.stored = now


@inlined
def take_voxel(voxels, used):
    """Return the number of an unused voxel."""
    v = used[VOXELS]
    if used[FIRST_VOXEL] > 0:       # one that was dropped
        v = used[FIRST_VOXEL] - 1
        used[FIRST_VOXEL] = voxels[v].head
        used[FREE_VOXELS] -= 1
        voxels[v].head = 0
    else:
        used[VOXELS] = v + 1
    return v


@inlined
def take_link(free, used):
    """Return the number of an unused link."""
    if used[FREE] > 0:
        used[FREE] -= 1
        return np.int64(free[used[FREE]])
    link = used[LINKS]
    used[LINKS] = link + 1
    return link


@inlined
def write(link, place, c, s, f):
    """Write an observation to a place of a link."""
    labels, confidences, frames = link.c, link.s, link.f
    labels[place] = c
    confidences[place] = s
    frames[place] = f


@inlined
def write_offset(record, place, x, y, z):
    """Write where an observation's points lay in its voxel, in 256ths of an edge."""
    xyz = record.xyz
    xyz[3 * place] = x
    xyz[3 * place + 1] = y
    xyz[3 * place + 2] = z


@inlined
def hang_link(voxel, link, before, number, n):
    """Hang a link for observation number n, by its number + 1, on a voxel's history."""
    link.next = 0
    if voxel.tail == 0:
        voxel.head = number
        voxel.first = n
    else:
        before.next = number
    voxel.tail = number


@inlined
def drop_oldest(voxel, links, retired, used):
    """
    Take the first link off a voxel's history.

    It is retired, not freed: a refinement that began earlier may still read it, and follows its
    'next'. release_links() frees what is retired when no refinement is under way.

    """
    link = np.int64(voxel.head) - 1
    voxel.head = links[link].next
    kept = (np.int64(voxel.first) // CHUNK + 1) * CHUNK
    used[STORED] -= kept - np.int64(voxel.first)
    voxel.first = kept
    retired[used[RETIRED]] = link
    used[RETIRED] += 1


@kernel
def release_links(free, retired, used):
    """Make retired links available again."""
    for r in range(used[RETIRED]):
        free[used[FREE]] = retired[r]
        used[FREE] += 1
    used[RETIRED] = 0
