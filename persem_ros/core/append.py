"""Adding observations to voxels: histories, evidence and counters. Kernels only."""

import numpy as np

from persem_ros.core.blocks import find_block, make_block
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.pools import (
    CHUNK, FREE, INLINE, LINKS, OBSERVATIONS, RETIRED, SIDE, SPILLS, STORED, VOXELS)
from persem_ros.frames import UNKNOWN

TIE = 1e-9      # spec section 2: x ties y when |x - y| <= TIE


@kernel
def add_observations(pools, table, places, labels, confidences, t, max_history, rows):
    """
    Append one frame's observations; rows (n,) int64 receives each one's voxel number or -1.

    The hash table has room for as many new blocks as there are observations.

    """
    blocks, voxels, links, spills, free, retired, used, starts, changes = pools
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(len(labels)):
        rows[p] = -1
        if labels[p] == UNKNOWN:
            continue
        i, j, k = np.int64(places[p, 0]), np.int64(places[p, 1]), np.int64(places[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
            if b < 0:
                b = make_block(blocks, used, table, oi, oj, ok)
            blocks[b].dirty = 1
        cell = ((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)
        v = np.int64(blocks[b].cells[cell]) - 1
        if v < 0:
            v = used[VOXELS]
            used[VOXELS] = v + 1
            blocks[b].cells[cell] = v + 1
            blocks[b].count += 1
        rows[p] = v
        append(voxels, links, spills, free, retired, used, starts, changes,
               v, labels[p], confidences[p], t, max_history)


@inlined
def append(voxels, links, spills, free, retired, used, starts, changes, v, c, s, t, max_history):
    """Append observation (c, s, t) to voxel v; its label follows the majority if it did so."""
    n = np.int64(voxels[v].n)
    push(voxels, links, free, used, v, n, c, s, t)
    if max_history > 0 and n + 1 - np.int64(voxels[v].first) >= max_history + CHUNK:
        drop_oldest(voxels, links, retired, used, v)
    if n > 0:
        before = voxels[v].last
        starts[before] += 1
        if before != c:
            changes[before] += 1
            voxels[v].switches += 1
    voxels[v].last = c
    voxels[v].n = n + 1
    followed = n == 0 or voxels[v].label == voxels[v].majority
    add_evidence(voxels, spills, used, v, c, np.float64(s))
    if n == 0 or c != voxels[v].majority:   # more evidence for the majority keeps it
        voxels[v].majority = majority(voxels, spills, v)
    if followed:
        voxels[v].label = voxels[v].majority
        voxels[v].source = 0
    voxels[v].dirty = 1
    used[OBSERVATIONS] += 1
    used[STORED] += 1


@inlined
def push(voxels, links, free, used, v, n, c, s, t):
    """Write observation number n of voxel v at place n % CHUNK of its last link."""
    place = n % CHUNK
    link = np.int64(voxels[v].tail)
    if place == 0 or link == 0:
        link = take_link(free, used) + 1
        links[link - 1].next = 0
        if voxels[v].tail == 0:
            voxels[v].head = link
            voxels[v].first = n
        else:
            links[np.int64(voxels[v].tail) - 1].next = link
        voxels[v].tail = link
    links[link - 1].c[place] = c
    links[link - 1].s[place] = s
    links[link - 1].t[place] = t


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
def drop_oldest(voxels, links, retired, used, v):
    """
    Take the first link off voxel v's history.

    It is retired, not freed: a refinement that began earlier may still read it, and follows its
    'next'. release_links() frees what is retired when no refinement is under way.

    """
    link = np.int64(voxels[v].head) - 1
    voxels[v].head = links[link].next
    kept = (np.int64(voxels[v].first) // CHUNK + 1) * CHUNK
    used[STORED] -= kept - np.int64(voxels[v].first)
    voxels[v].first = kept
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
def add_evidence(voxels, spills, used, v, c, s):
    """h_v(c) += s, in float64 and in the order of the observations."""
    for k in range(INLINE):
        if voxels[v].sums[k] == 0.0:
            voxels[v].classes[k] = c
            voxels[v].sums[k] = s
            return
        if voxels[v].classes[k] == c:
            voxels[v].sums[k] += s
            return
    link, before = np.int64(voxels[v].more), np.int64(0)
    while link > 0:
        for k in range(INLINE):
            if spills[link - 1].sums[k] == 0.0:
                spills[link - 1].classes[k] = c
                spills[link - 1].sums[k] = s
                return
            if spills[link - 1].classes[k] == c:
                spills[link - 1].sums[k] += s
                return
        before, link = link, np.int64(spills[link - 1].next)
    link = used[SPILLS] + 1
    used[SPILLS] = link
    spills[link - 1].classes[0] = c
    spills[link - 1].sums[0] = s
    if before > 0:
        spills[before - 1].next = link
    else:
        voxels[v].more = link


@inlined
def read_evidence(voxels, spills, v, classes, sums, n):
    """Write voxel v's evidence to classes[n:], sums[n:] in order of appearance; return the end."""
    for k in range(INLINE):
        if voxels[v].sums[k] != 0.0:
            classes[n] = voxels[v].classes[k]
            sums[n] = voxels[v].sums[k]
            n += 1
    link = np.int64(voxels[v].more)
    while link > 0:
        for k in range(INLINE):
            if spills[link - 1].sums[k] != 0.0:
                classes[n] = spills[link - 1].classes[k]
                sums[n] = spills[link - 1].sums[k]
                n += 1
        link = np.int64(spills[link - 1].next)
    return n


@inlined
def majority(voxels, spills, v):
    """c_M = argmax h_v; the smaller id wins a tie (spec section 2)."""
    most = 0.0
    for k in range(INLINE):
        most = max(most, voxels[v].sums[k])
    link = np.int64(voxels[v].more)
    while link > 0:
        for k in range(INLINE):
            most = max(most, spills[link - 1].sums[k])
        link = np.int64(spills[link - 1].next)
    best = np.int64(UNKNOWN)
    for k in range(INLINE):
        if voxels[v].sums[k] > 0.0 and most - voxels[v].sums[k] <= TIE:
            best = min(best, np.int64(voxels[v].classes[k]))
    link = np.int64(voxels[v].more)
    while link > 0:
        for k in range(INLINE):
            if spills[link - 1].sums[k] > 0.0 and most - spills[link - 1].sums[k] <= TIE:
                best = min(best, np.int64(spills[link - 1].classes[k]))
        link = np.int64(spills[link - 1].next)
    return best
