"""What is counted of a frame's voxels: ids, points and where they lay. Kernels only."""

import numpy as np
from persem_ros.core.frame.cubes import find_places, more_cubes, no_cubes
from persem_ros.core.frame.place import NOWHERE, place_stretch, REACH, STRETCH
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.pools import CENTRE
from persem_ros.frames import MAX_ID, UNKNOWN

# What is known of a voxel while a frame's points are counted: its place, its first id with the
# number of points, where the list of further ids begins, and the sums of the counted points'
# offsets. Two records to a cache line.
TALLY = np.dtype([('key', 'i8'), ('id', 'i4'), ('count', 'i4'), ('more', 'i4'), ('x', 'u4'),
                  ('y', 'u4'), ('z', 'u4')])
EXTRA = np.dtype([('id', 'i4'), ('count', 'i4'), ('more', 'i4')])
# The same where points have weights, whose sums are larger.
WEIGHED = np.dtype([(name, 'i8' if name == 'count' else kind) for name, kind, *_ in TALLY.descr])
WEIGHED_EXTRA = np.dtype([('id', 'i4'), ('count', 'i8'), ('more', 'i4')])
ONE = 1 << 16       # the weight of a label that is certain


@kernel
def tally(begin, end, points, depth, rays, low, high, pose, base, voxel_size, labels, counting,
          weights, where, tallies, extras, numbers):
    """
    Count the points begin .. end by voxel: the heart of core.frame.observe.

    Points are taken in stretches that fit the L1 cache: placed, cut into runs of one voxel and
    one id, and counted run by run. What runs need of their points are differences of sums along
    the stretch, so that no loop but that over the runs has a branch.

    where receives each point's row in tallies, -1 for none. No variable is given another array
    in the loop over the runs: numba would count references, by instructions that wait for all
    that was written before (half of the time that counting took).

    Returns
    -------
    n, n_extras : int
        Tallies and extras in use.
    cubes : tuple
        names, first places, places of the cubes, and how many there are.
    seen : ndarray, shape (65536,), uint8
        Which ids were counted.

    """
    axes = np.empty((6, STRETCH))
    keys, inside, places = np.empty(STRETCH, np.int64), np.empty(STRETCH, np.int64), np.empty(
        STRETCH, np.int64)
    sums, heavy = np.zeros(STRETCH + 1, np.int64), np.zeros(STRETCH + 1, np.int64)
    ids, rows = np.empty(STRETCH, np.int32), np.empty(STRETCH, np.int32)
    starts, run_of = np.empty(STRETCH + 1, np.uint32), np.empty(STRETCH, np.uint32)
    seen = np.zeros(65536, np.uint8)
    names, firsts, cells, n_cubes = no_cubes()
    n, n_extras = 0, 0
    for p in range(begin, end, STRETCH):
        stop = min(p + STRETCH, end)
        few = stop - p
        place_stretch(points, depth, rays, p, stop, low, high, pose, base, voxel_size, axes,
                      keys[:few], inside)
        count(labels[p:stop], counting, ids)
        if len(weights) > 0:
            weigh(weights[p:stop], ids, heavy)
        m = cut(keys[:few], ids, inside, sums, starts, run_of)
        if 2 * (n_cubes + m) > len(names):
            names, firsts, cells = more_cubes(names, firsts, cells, n_cubes + m)
        n_cubes = find_places(m, keys, starts, names, firsts, cells, n_cubes, places)
        n, n_extras = count_runs(m, keys, ids, sums, heavy, starts, places, cells,
                                 len(weights) > 0, tallies, extras, numbers, n, n_extras, seen,
                                 rows)
        spread(rows, run_of, where[p:stop])
    return n, n_extras, (names, firsts, cells, n_cubes), seen


@inlined
def count(labels, counting, ids):
    """Write the id that each point is counted as, -1 for none."""
    for u in range(len(labels)):
        c = labels[u]
        ids[u] = counting[c] if 0 <= c <= MAX_ID else -1


@inlined
def weigh(weights, ids, heavy):
    """Write the sums of the weights before each point; what weighs nothing does not count."""
    total = np.int64(0)
    for u in range(len(weights)):
        if weights[u] == 0:
            ids[u] = -1
        total += weights[u]
        heavy[u + 1] = total


@inlined
def cut(keys, ids, inside, sums, starts, run_of):
    """
    Cut a stretch of points into runs of one key and one id; return how many.

    starts receives their first points and the end, run_of each point's run, sums the sums of
    inside before each point.

    """
    m, key, c, total = 0, NOWHERE - 1, np.int32(-2), np.int64(0)
    for u in range(len(keys)):
        starts[m] = u
        m += (keys[u] != key) | (ids[u] != c)
        key, c = keys[u], ids[u]
        run_of[u] = m - 1
        total += inside[u]
        sums[u + 1] = total
    starts[m] = len(keys)
    return m


@inlined
def count_runs(m, keys, ids, sums, heavy, starts, places, cells, weighed, tallies, extras, numbers,
               n, n_extras, seen, rows):
    """Count m runs; rows receives the voxel's row of each. Return how many rows and extras."""
    for r in range(m):
        place, a, b = places[r], np.int64(starts[r]), np.int64(starts[r + 1])
        if place < 0:
            rows[r] = -1
            continue
        c = ids[a]
        # Whether a voxel is new cannot be foretold: so the next row is made ready in any case.
        fresh = tallies[n]
        fresh.key = keys[a]
        fresh.id = c
        fresh.count = 0
        fresh.more = -1
        fresh.x = fresh.y = fresh.z = 0
        if weighed:
            numbers[n] = 0
        known = np.int64(cells[place])
        g = known - 1 if known > 0 else n
        cells[place] = g + 1
        n += known == 0
        rows[r] = g
        if c < 0:
            continue
        seen[c] = 1
        weight = b - a
        if weighed:
            numbers[g] += weight
            weight = heavy[b] - heavy[a]
        one, total = tallies[g], sums[b] - sums[a]
        one.x += total >> 40
        one.y += total >> 20 & 0xfffff
        one.z += total & 0xfffff
        if one.id < 0:
            one.id = c
        if c == one.id:
            one.count += weight
        else:
            n_extras = count_extra(one, extras, n_extras, c, weight)
    return n, n_extras


@inlined
def count_extra(one, extras, n_extras, c, weight):
    """Count id c, not the first of a voxel; return how many extras there are."""
    e = np.int64(one.more)
    while e >= 0 and extras[e].id != c:
        e = np.int64(extras[e].more)
    if e >= 0:
        extras[e].count += weight
        return n_extras
    extras[n_extras].id = c
    extras[n_extras].count = weight
    extras[n_extras].more = one.more
    one.more = n_extras
    return n_extras + 1


@inlined
def spread(rows, run_of, where):
    """Write the row of each point's run."""
    for u in range(len(where)):
        where[u] = rows[run_of[u]]


@kernel
def merge(tallies, extras, numbers, n, n_extras, cubes, others, their_extras, their_numbers):
    """
    Add the tallies of later points to the first n.

    All that is counted are integers, so it does not matter which points were counted together;
    voxels stay in order of first appearance.

    Returns
    -------
    n, n_extras, cubes
        As they are now.
    rows : ndarray, shape (len(others),), int32
        The row of each of theirs.

    """
    names, firsts, cells, n_cubes = cubes
    rows = np.empty(len(others), np.int32)
    keys, starts = np.empty(STRETCH, np.int64), np.arange(STRETCH).astype(np.uint32)
    places = np.empty(STRETCH, np.int64)
    for begin in range(0, len(others), STRETCH):
        m = min(STRETCH, len(others) - begin)
        if 2 * (n_cubes + m) > len(names):
            names, firsts, cells = more_cubes(names, firsts, cells, n_cubes + m)
        for r in range(m):
            keys[r] = others[begin + r].key
        n_cubes = find_places(m, keys, starts, names, firsts, cells, n_cubes, places)
        for r in range(m):
            theirs, g = others[begin + r], np.int64(cells[places[r]]) - 1
            e = np.int64(theirs.more)
            if g < 0:
                g = n
                n += 1
                cells[places[r]] = n
                tallies[g] = theirs
                tallies[g].more = -1
                if len(numbers) > 0:
                    numbers[g] = their_numbers[begin + r]
            else:
                n_extras = add_first(tallies[g], theirs, extras, n_extras)
                if len(numbers) > 0:
                    numbers[g] += their_numbers[begin + r]
            rows[begin + r] = g
            while e >= 0:
                c, weight = their_extras[e].id, their_extras[e].count
                if c == tallies[g].id:
                    tallies[g].count += weight
                else:
                    n_extras = count_extra(tallies[g], extras, n_extras, c, weight)
                e = np.int64(their_extras[e].more)
    return n, n_extras, (names, firsts, cells, n_cubes), rows


@inlined
def add_first(one, theirs, extras, n_extras):
    """Add a tally to one of the same voxel, less its further ids; return the extras' number."""
    one.x += theirs.x
    one.y += theirs.y
    one.z += theirs.z
    if one.id < 0:
        one.id = theirs.id
    if theirs.id == one.id:
        one.count += theirs.count
    else:
        if theirs.id >= 0:
            n_extras = count_extra(one, extras, n_extras, theirs.id, theirs.count)
    return n_extras


@kernel
def renumber(begin, end, rows, where):
    """Write the rows of merge() in place of those before."""
    for p in range(begin, end):
        if where[p] >= 0:
            where[p] = rows[where[p]]


@kernel
def vote(begin, end, tallies, extras, numbers, base, min_pixels, measured, voxels, best,
         confidence, means):
    """
    Write each voxel's index, its most frequent id (a tie: the smaller), its share, mean offset.

    Where counts are sums of weights, *numbers* are those of the counted points; else it is empty.

    """
    for g in range(begin, end):
        one = tallies[g]
        voxels[g, 0] = (one.key >> 42) - REACH + base[0]
        voxels[g, 1] = (one.key >> 21 & 0x1fffff) - REACH + base[1]
        voxels[g, 2] = (one.key & 0x1fffff) - REACH + base[2]
        total = most = np.int64(one.count)
        label, e = np.int64(one.id), np.int64(one.more)
        while e >= 0:
            weight, c = np.int64(extras[e].count), np.int64(extras[e].id)
            total += weight
            if weight > most or (weight == most and c < label):
                most, label = weight, c
            e = np.int64(extras[e].more)
        if len(numbers) > 0:
            total = np.int64(numbers[g])
        best[g], confidence[g] = UNKNOWN, 0.0
        means[g, 0] = means[g, 1] = means[g, 2] = CENTRE
        if total >= min_pixels and total > 0:
            best[g] = label
            share = most / total
            confidence[g] = np.float32(share / ONE if len(numbers) > 0 else share)
            if measured:    # rounded, not cut off: the mean of offsets that were cut off
                means[g, 0] = min(np.int64((one.x + 0.5 * total) / total), 255)
                means[g, 1] = min(np.int64((one.y + 0.5 * total) / total), 255)
                means[g, 2] = min(np.int64((one.z + 0.5 * total) / total), 255)
