"""Adding observations to voxels: histories, evidence and counters. Kernels only."""

import numpy as np

from persem_ros.core.blocks import find_block, make_block
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.pools import (
    CHUNK, FIRST_SPILL, FIRST_VOXEL, FREE, FREE_SPILLS, FREE_VOXELS, INLINE, LINKS,
    OBSERVATIONS, RETIRED, SIDE, SPILLS, STORED, VOXELS)
from persem_ros.frames import UNKNOWN

AHEAD = 1024        # observations whose records are fetched at once; they fit the cache
TIE = 1e-9      # spec section 2: x ties y when |x - y| <= TIE


@kernel
def add_observations(pools, table, places, labels, confidences, t, max_history, rows):
    """
    Append one frame's observations; rows (n,) int64 receives each one's voxel number or -1.

    The hash table has room for as many new blocks as there are observations.

    """
    blocks, voxels, links, spills, free, retired, used, starts, changes = pools
    added, touched = 0, 0
    for begin in range(0, len(labels), AHEAD):
        end = min(begin + AHEAD, len(labels))
        touched += look_ahead(blocks, voxels, links, table, places, labels, begin, end, rows)
        for p in range(begin, end):
            c = labels[p]
            if c == UNKNOWN:
                rows[p] = -1
                continue
            if rows[p] < 0:
                rows[p] = make_voxel(blocks, voxels, used, table, np.int64(places[p, 0]),
                                     np.int64(places[p, 1]), np.int64(places[p, 2]))
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
                number = new_link(voxel, links, free, used, n)
            write(links[number - 1], n % CHUNK, c, confidences[p], t)
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
            voxel.n = n + 1
            voxel.last = c
    used[OBSERVATIONS] += added
    used[STORED] += added
    return touched


@inlined
def look_ahead(blocks, voxels, links, table, places, labels, begin, end, rows):
    """
    Find the voxels of observations begin .. end, -1 where new; mark them; fetch their records.

    Most of the time that adding takes is waiting for memory. A loop that only reads waits for a
    dozen records at once, one that also works for one or two: this pass halves the time.

    """
    b, touched = np.int64(-1), 0
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
                mark(blocks[b], i, j, k)
    for p in range(begin, end):
        if rows[p] >= 0:
            touched += links[np.int64(voxels[rows[p]].tail) - 1].next
    return touched


@inlined
def make_voxel(blocks, voxels, used, table, i, j, k):
    """Make the voxel with the index (i, j, k), and its block where there is none."""
    b = find_block(blocks, table, i >> 3, j >> 3, k >> 3)
    if b < 0:
        b = make_block(blocks, used, table, i >> 3, j >> 3, k >> 3)
    v = take_voxel(voxels, used)
    cells = blocks[b].cells
    cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)] = v + 1
    blocks[b].count += 1
    mark(blocks[b], i, j, k)
    return v


@inlined
def mark(block, i, j, k):
    """Mark the voxel with the index (i, j, k) as changed."""
    changed = block.changed
    changed[(i & 7) * SIDE + (j & 7)] |= np.uint8(1 << (k & 7))
    block.dirty = 1


@inlined
def take_voxel(voxels, used):
    """Return the number of an unused voxel."""
    if used[FIRST_VOXEL] > 0:       # one that was dropped
        v = used[FIRST_VOXEL] - 1
        used[FIRST_VOXEL] = voxels[v].head
        used[FREE_VOXELS] -= 1
        voxels[v].head = 0
    else:
        v = used[VOXELS]
        used[VOXELS] = v + 1
    return v


@inlined
def take_spill(spills, used):
    """Return the number of an unused spill record."""
    if used[FIRST_SPILL] > 0:       # one that was dropped
        number = used[FIRST_SPILL] - 1
        used[FIRST_SPILL] = spills[number].next
        used[FREE_SPILLS] -= 1
        spills[number].next = 0
    else:
        number = used[SPILLS]
        used[SPILLS] = number + 1
    return number


@inlined
def write(link, place, c, s, t):
    """Write an observation to a place of a link."""
    labels, confidences, times = link.c, link.s, link.t
    labels[place] = c
    confidences[place] = s
    times[place] = t


@inlined
def new_link(voxel, links, free, used, n):
    """Hang a link for observation number n on a voxel's history; return its number + 1."""
    fresh = take_link(free, used) + 1
    links[fresh - 1].next = 0
    if voxel.tail == 0:
        voxel.head = fresh
        voxel.first = n
    else:
        links[np.int64(voxel.tail) - 1].next = fresh
    voxel.tail = fresh
    return fresh


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


@inlined
def add_here(record, c, s):
    """
    h_v(c) += s in a voxel or spill record; False where other classes have all its places.

    Sums are float64 and in the order of the observations.

    """
    sums, classes = record.sums, record.classes
    for k in range(INLINE):
        if classes[k] == c and sums[k] != 0.0:
            sums[k] += s
            return True
        if sums[k] == 0.0:
            classes[k] = c
            sums[k] = s
            return True
    return False


@inlined
def spill(voxel, spills, used, c, s):
    """h_v(c) += s outside the voxel's own record, which has no place for c."""
    number, before = np.int64(voxel.more), np.int64(0)
    while number > 0:
        if add_here(spills[number - 1], c, s):
            return
        before, number = number, np.int64(spills[number - 1].next)
    number = take_spill(spills, used) + 1
    add_here(spills[number - 1], c, s)
    if before > 0:
        spills[before - 1].next = number
    else:
        voxel.more = number


@inlined
def add_evidence(voxel, spills, used, c, s):
    """h_v(c) += s."""
    if not add_here(voxel, c, s):
        spill(voxel, spills, used, c, s)


@inlined
def _read_here(place, classes, sums, n):
    """Write the evidence of a voxel or spill record to classes[n:], sums[n:]; return the end."""
    own_sums, own_classes = place.sums, place.classes
    for k in range(INLINE):
        if own_sums[k] != 0.0:
            classes[n] = own_classes[k]
            sums[n] = own_sums[k]
            n += 1
    return n


@inlined
def read_evidence(voxel, spills, classes, sums, n):
    """Write a voxel's evidence to classes[n:], sums[n:] in order of appearance; return the end."""
    n = _read_here(voxel, classes, sums, n)
    number = np.int64(voxel.more)
    while number > 0:
        n = _read_here(spills[number - 1], classes, sums, n)
        number = np.int64(spills[number - 1].next)
    return n


@inlined
def count_classes(voxel, spills):
    """Return the number of classes with evidence in a voxel."""
    n, sums = 0, voxel.sums
    for k in range(INLINE):
        n += sums[k] != 0.0
    number = np.int64(voxel.more)
    while number > 0:
        spilt = spills[number - 1].sums
        for k in range(INLINE):
            n += spilt[k] != 0.0
        number = np.int64(spills[number - 1].next)
    return n


@inlined
def _most(record, most):
    """Return the largest of *most* and a record's sums."""
    sums = record.sums
    for k in range(INLINE):
        most = max(most, sums[k])
    return most


@inlined
def _smallest(record, most, best):
    """Return the smallest of *best* and the record's ids whose evidence ties with *most*."""
    sums, classes = record.sums, record.classes
    for k in range(INLINE):
        if sums[k] > 0.0 and most - sums[k] <= TIE:
            best = min(best, np.int64(classes[k]))
    return best


@inlined
def majority_here(voxel):
    """Return c_M of a voxel without spilt evidence."""
    return _smallest(voxel, _most(voxel, 0.0), np.int64(UNKNOWN))


@inlined
def majority(voxel, spills):
    """c_M = argmax h_v; the smaller id wins a tie (spec section 2)."""
    most, number = _most(voxel, 0.0), np.int64(voxel.more)
    while number > 0:
        most, number = _most(spills[number - 1], most), np.int64(spills[number - 1].next)
    best, number = _smallest(voxel, most, np.int64(UNKNOWN)), np.int64(voxel.more)
    while number > 0:
        best = _smallest(spills[number - 1], most, best)
        number = np.int64(spills[number - 1].next)
    return best
