"""Adding observations to voxels: histories and counters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core import jit
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.evidence import (
    add_here, add_spilt, majority, majority_here, spill)
from persem_ros.core.memory.pools import CHUNK, OBSERVATIONS, Pools, RETIRED, STORED
from persem_ros.core.memory.records import drop_oldest, hang_link, write_link, write_offset
from persem_ros.core.memory.room import fetch, find, make_room, part_of
from persem_ros.frames import UNKNOWN

GRAIN = 4096        # observations that are worth a thread
AHEAD = 512         # observations whose records are fetched at once; they fit the cache
# What is known of a part's observations: how many are left for the second round, how many links
# these take and how many of their voxels' oldest they retire; how many observations are stored
# more than before; how many wait for a record of spilt evidence, in the first round and in all.
PART = np.dtype([('left', 'i8'), ('links', 'i8'), ('drops', 'i8'), ('stored', 'i8'),
                 ('waiting', 'i8'), ('late', 'i8')])


def add_observations(
        pools: Pools, table: NDArray[Any], places: NDArray[np.int32], labels: NDArray[np.uint16],
        confidences: NDArray[np.float32], where: NDArray[np.uint8], f: int,
        max_history: int, voted: NDArray[np.uint8]) -> NDArray[np.int64]:
    """
    Append the observations of frame f, one of a voxel; return each one's voxel number or -1.

    The hash table has room for as many new blocks as there are observations. Most find all that
    they need where it is: these are written at once, in parts side by side, while their records
    are in the cache. What is common to all (new voxels, places in the pools, counters of classes)
    is done afterwards, and the rest is written. The same bytes by any number of threads. 42 000
    observations take two threads 1.2 ms.

    Parameters
    ----------
    pools : Pools
        The map's.
    table : ndarray
        The hash of the blocks.
    places : ndarray, shape (n, 3), int32
        Voxel indices, each once.
    labels : ndarray, shape (n,), uint16
        UNKNOWN: no observation.
    confidences : ndarray, shape (n,), float32
        Of each label, 0 .. 1.
    where : ndarray, shape (n, 3), uint8
        Mean places of the points in the voxels, 256ths of an edge.
    f : int
        Row of the frame table.
    max_history : int
        Newest observations kept of a voxel; 0: all.
    voted : ndarray, shape (65536,), uint8
        Receives 1 for every id among labels.

    Returns
    -------
    rows : ndarray, shape (n,), int64
        Voxel numbers.

    """
    n = len(labels)
    parts = np.zeros(max(1, min(jit.threads(), n // GRAIN)), PART)
    rows, block_of = np.empty(n, np.int64), np.empty(n, np.int64)
    last, left, late = np.empty(n, np.uint16), np.empty(n, np.int32), np.empty(n, np.int32)
    jit.split(write_known, len(parts), pools, table, places, labels, confidences, where, f,
              max_history, rows, block_of, last, left, late, parts, grain=1)
    fresh, few = np.empty(parts['links'].sum(), np.int64), parts['left'].sum() < GRAIN
    make_room(pools, table, places, labels, rows, block_of, fresh)
    jit.split(write_rest, len(parts), pools, labels, confidences, where, f, max_history, rows,
              fresh, last, left, late, parts, grain=len(parts) if few else 1)
    settle(pools, labels, confidences, rows, last, late, parts, voted)
    return rows


@kernel
def write_known(begin, end, pools, table, places, labels, confidences, where, f, max_history,
                rows, block_of, last, left, late, parts):
    """
    Write what needs nothing new of the observations of parts begin .. end, and list the rest.

    last receives each voxel's label before. Most of the time that adding takes is waiting for
    memory: so records are asked for in rounds of AHEAD observations.

    """
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    for number in range(begin, end):
        part = parts[number]
        first, stop = part_of(number, len(parts), len(labels))
        n_left, n_late = 0, 0
        for p in range(first, stop, AHEAD):
            q = min(p + AHEAD, stop)
            find(blocks, table, places, p, q, block_of)
            fetch(blocks, voxels, links, offsets, places, p, q, rows, block_of)
            n_left, n_late = write_there(
                voxels, links, offsets, labels, confidences, where, f, max_history, rows, last,
                left[first:stop], late[first:stop], p, q, n_left, n_late, part)
        part.left = n_left
        part.waiting = part.late = add_elsewhere(voxels, spills, labels, confidences, rows,
                                                 late[first:first + n_late])


@inlined
def write_there(voxels, links, offsets, labels, confidences, where, f, max_history, rows, last,
                left, late, begin, end, n_left, n_late, part):
    """Write what has a place in its voxel's last link; list the rest, and what has no evidence."""
    for p in range(begin, end):
        c, last[p] = labels[p], UNKNOWN
        if c == UNKNOWN:
            rows[p] = -1
            continue
        n, tail, drops = np.int64(0), np.int64(0), False
        if rows[p] >= 0:
            voxel = voxels[rows[p]]
            n, tail = np.int64(voxel.n), np.int64(voxel.tail)
            drops = max_history > 0 and tail > 0 and \
                n + 1 - np.int64(voxel.first) >= max_history + CHUNK
        if drops or n % CHUNK == 0 or tail == 0:
            part.links += n % CHUNK == 0 or tail == 0
            part.drops += drops
            left[n_left] = p
            n_left += 1
            continue
        voxel = voxels[rows[p]]
        last[p] = voxel.last
        write_link(links[tail - 1], n % CHUNK, c, confidences[p], f)
        write_offset(offsets[tail - 1], n % CHUNK, where[p, 0], where[p, 1], where[p, 2])
        part.stored += 1
        if not count(voxel, c, np.float64(confidences[p])):
            late[n_late] = p
            n_late += 1
    return n_left, n_late


@inlined
def count(voxel, c, s):
    """
    Count one more observation of a voxel, whose history has it; False: no place for its evidence.

    What no refinement moved follows the majority.

    """
    n = np.int64(voxel.n)
    voxel.switches += n > 0 and voxel.last != c
    voxel.n = n + 1
    voxel.last = c
    voxel.gone = 0
    if n == 0:
        voxel.first_label = c
    if voxel.more > 0 or not add_here(voxel, c, s):
        return False
    followed = n == 0 or voxel.label == voxel.majority
    if n == 0 or c != voxel.majority:   # more evidence for the majority keeps it
        voxel.majority = majority_here(voxel)
    if followed:
        voxel.label = voxel.majority
        voxel.source = 0
    return True


@kernel
def write_rest(begin, end, pools, labels, confidences, where, f, max_history, rows, fresh, last,
               left, late, parts):
    """Write the observations of parts begin .. end that take a link or let go of one."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    for number in range(begin, end):
        part = parts[number]
        q, r = np.int64(0), used[RETIRED]
        for before in range(number):
            q += parts[before].links
            r += parts[before].drops
        first, stop = part_of(number, len(parts), len(labels))
        begun = first + part.waiting
        n_late = 0
        for p in left[first:first + part.left]:
            c = labels[p]
            voxel = voxels[rows[p]]
            n, tail = np.int64(voxel.n), np.int64(voxel.tail)
            if n > 0:
                last[p] = voxel.last
            if n % CHUNK == 0 or tail == 0:
                link = fresh[q]
                q += 1
                hang_link(voxel, links[link], links[max(tail, 1) - 1], link + 1, n)
                tail = link + 1
            write_link(links[tail - 1], n % CHUNK, c, confidences[p], f)
            write_offset(offsets[tail - 1], n % CHUNK, where[p, 0], where[p, 1], where[p, 2])
            part.stored += 1
            if max_history > 0 and n + 1 - np.int64(voxel.first) >= max_history + CHUNK:
                retired[r] = np.int64(voxel.head) - 1
                r += 1
                part.stored -= drop_oldest(voxel, links[np.int64(voxel.head) - 1])
            if not count(voxel, c, np.float64(confidences[p])):
                late[begun + n_late] = p
                n_late += 1
        part.late += add_elsewhere(voxels, spills, labels, confidences, rows,
                                   late[begun:begun + n_late])


@inlined
def add_elsewhere(voxels, spills, labels, confidences, rows, late):
    """
    Add to the evidence of voxels with more classes than their own record has room for.

    In a loop of its own, as make_voxels(). Returns how many observations, now the first in
    *late*, take a record that is not there yet.

    """
    n = 0
    for p in late:
        voxel, c, s = voxels[rows[p]], labels[p], np.float64(confidences[p])
        if add_here(voxel, c, s) or add_spilt(voxel, spills, c, s):
            decide(voxel, spills, c)
        else:
            late[n] = p
            n += 1
    return n


@inlined
def decide(voxel, spills, c):
    """Do with a voxel that has been seen before what count() does at its end."""
    followed = voxel.label == voxel.majority
    if c != voxel.majority:
        voxel.majority = majority(voxel, spills)
    if followed:
        voxel.label = voxel.majority
        voxel.source = 0


@kernel
def settle(pools, labels, confidences, rows, last, late, parts, voted):
    """Do what parts cannot do side by side: records of spilt evidence and all counters."""
    blocks, voxels, links, spills, offsets, stamps, free, retired, used, starts, changes = pools
    for rest in range(2):       # in this order by any number of parts
        for number in range(len(parts)):
            part = parts[number]
            first, stop = part_of(number, len(parts), len(labels))
            waiting = late[first + part.waiting:first + part.late] if rest else \
                late[first:first + part.waiting]
            for p in waiting:
                voxel = voxels[rows[p]]
                spill(voxel, spills, used, labels[p], np.float64(confidences[p]))
                decide(voxel, spills, labels[p])
    for number in range(len(parts)):
        used[RETIRED] += parts[number].drops
        used[STORED] += parts[number].stored
    for p in range(len(labels)):
        before = last[p]
        if before != UNKNOWN:
            starts[before] += 1
            changes[before] += before != labels[p]
        used[OBSERVATIONS] += labels[p] != UNKNOWN
        voted[labels[p]] = 1
