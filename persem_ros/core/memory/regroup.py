"""Observations that moved, gathered by voxel again. Kernels only; core.memory.move drives them."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.evidence import TIE
from persem_ros.frames import UNKNOWN

FINE = 65536        # of a voxel's edge: what the place of a point is counted in, 16 bits
COARSE = 256        # the same in offsets
LIMIT = 1 << 30     # voxels from the origin, beyond which nothing can be placed


@kernel
def leaving(voxels, owner, frames, offsets, turns, moves, size, leaves):
    """
    Mark in leaves (F,) the frames that move and of which an observation leaves its voxel.

    voxels (n, 3) int32 are those of the rows that owner (N,) names; turns (F, 12) is K by frame,
    about map.origin: nine numbers of the rotation, then the shift.

    """
    for p in range(len(owner)):
        f, o = frames[p], owner[p]
        if not moves[f] or leaves[f]:
            continue
        x = middle(voxels[o, 0], offsets[p, 0], size)
        y = middle(voxels[o, 1], offsets[p, 1], size)
        z = middle(voxels[o, 2], offsets[p, 2], size)
        for axis in range(3):
            at = (turns[f, 3 * axis] * x + turns[f, 3 * axis + 1] * y + turns[f, 3 * axis + 2] * z
                  + turns[f, 9 + axis]) / size
            if np.floor(at) != voxels[o, axis]:
                leaves[f] = 1


@inlined
def middle(voxel, offset, size):
    """Return where the points of an observation lay along an axis, metres from the origin."""
    return (voxel + (offset + 0.5) / COARSE) * size


@kernel
def displace(voxels, owner, frames, offsets, turns, leaves, size, out, places, low, high):
    """
    Write each observation's voxel to out (N, 3) int32 and its place there to places, uint16.

    Those of frames that are not in leaves stay. low and high (3,) int64 receive the smallest and
    the largest index of a block. Returns whether all have a place.

    """
    for axis in range(3):
        low[axis], high[axis] = LIMIT, -LIMIT
    for p in range(len(owner)):
        f, o = frames[p], owner[p]
        if leaves[f]:
            x = middle(voxels[o, 0], offsets[p, 0], size)
            y = middle(voxels[o, 1], offsets[p, 1], size)
            z = middle(voxels[o, 2], offsets[p, 2], size)
            for axis in range(3):
                at = (turns[f, 3 * axis] * x + turns[f, 3 * axis + 1] * y
                      + turns[f, 3 * axis + 2] * z + turns[f, 9 + axis]) / size
                voxel = np.floor(at)
                if not abs(voxel) < LIMIT:
                    return False
                out[p, axis] = np.int32(voxel)
                places[p, axis] = np.uint16(min((at - voxel) * FINE, FINE - 1.0))
        else:
            for axis in range(3):
                out[p, axis] = voxels[o, axis]
                places[p, axis] = offsets[p, axis] * np.int64(FINE // COARSE)
        for axis in range(3):
            block = np.int64(out[p, axis]) >> 3
            if block < low[axis]:
                low[axis] = block
            if block > high[axis]:
                high[axis] = block
    return True


@kernel
def number(voxels, low, span, keys):
    """Write to keys (n,) numbers that sort voxels by block, then by cell."""
    for p in range(len(voxels)):
        i, j, k = np.int64(voxels[p, 0]), np.int64(voxels[p, 1]), np.int64(voxels[p, 2])
        block = (((i >> 3) - low[0]) * span[1] + ((j >> 3) - low[1])) * span[2] + (k >> 3) - low[2]
        keys[p] = block * 512 + ((i & 7) * 8 + (j & 7)) * 8 + (k & 7)


@kernel
def voxels_of(keys, low, span, voxels):
    """Write the voxels (n, 3) int32 that have these keys of number(), which ascend."""
    last, i, j, k = np.int64(-1), np.int64(0), np.int64(0), np.int64(0)
    for p in range(len(keys)):
        block, cell = keys[p] >> 9, keys[p] & 511
        if block != last:       # divisions are slow
            row = block // span[2]
            i, j = (row // span[1] + low[0]) * 8, (row % span[1] + low[1]) * 8
            k, last = (block % span[2] + low[2]) * 8, block
        voxels[p, 0] = i + (cell >> 6)
        voxels[p, 1] = j + (cell >> 3 & 7)
        voxels[p, 2] = k + (cell & 7)


@kernel
def ordered(keys, buckets, shift, digit, order, after, own, other):
    """
    Return the keys (n,) in order and the rows (n,) uint32 that have them, equal ones as they were.

    First into buckets by key >> shift, which keeps together what lies together, for observations
    come block by block and do not move far; then each bucket, in the cache, by *digit* bits at a
    time of the others. Room for n numbers: order, after uint32; own, other int64.

    """
    n, ends, digits = len(keys), np.zeros(buckets + 1, np.int64), np.empty(1 << digit, np.int64)
    for p in range(n):
        ends[(keys[p] >> shift) + 1] += 1
    for d in range(buckets):
        ends[d + 1] += ends[d]
    for p in range(n):
        key = keys[p]
        q = ends[key >> shift]
        ends[key >> shift] = q + 1
        own[q] = key
        order[q] = p
    begin, odd = np.int64(0), -(-shift // digit) % 2 == 1
    for d in range(buckets):
        if ends[d] > begin:
            for at in range(0, shift, digit):
                if at // digit % 2 == 0:
                    by_digit(begin, ends[d], at, digit, own, order, other, after, digits)
                else:
                    by_digit(begin, ends[d], at, digit, other, after, own, order, digits)
            begin = ends[d]
    if odd:
        return other, after
    return own, order


@inlined
def by_digit(begin, end, at, digit, keys, rows, new_keys, new_rows, digits):
    """Sort the part begin .. end by *digit* bits of the keys from *at* on."""
    mask = (1 << digit) - 1
    for d in range(1 << digit):
        digits[d] = 0
    for p in range(begin, end):
        digits[keys[p] >> at & mask] += 1
    q = begin
    for d in range(1 << digit):
        count = digits[d]
        digits[d] = q
        q += count
    for p in range(begin, end):
        d = keys[p] >> at & mask
        q = digits[d]
        digits[d] = q + 1
        new_keys[q] = keys[p]
        new_rows[q] = rows[p]


@kernel
def group(keys, order, frames, owner, counts, gone, some_gone, leaves, first, out_frames, start,
          voxel_keys, old, out_gone):
    """
    Sort each voxel's observations by frame, find which of a frame meet; return how many voxels.

    Parameters
    ----------
    keys, order : ndarray, shape (N,)
        The voxels of observations in order, and their rows, which are sorted by frame, then row.
    frames, owner : ndarray, shape (N,)
        By row: the frame, and the row of the voxel that it was in.
    counts, gone : ndarray, shape (V,)
        Of these voxels: how many observations each had, whether it had gone.
    some_gone : bool
        Whether any had.
    leaves : ndarray, shape (F,)
        Frames that move.
    first, out_frames : ndarray, shape (N + 1,), (N,)
        Receive, by observation that is left, where in the order its own begin, and the frame.
    start, voxel_keys, old, out_gone : ndarray, shape (N,), start (N + 1,)
        Receive, by voxel, where its observations begin, its key, the row of the voxel that it is
        where nothing came and nothing left, else -1, and whether all of it had gone.

    """
    N, n, v, begin = len(keys), np.int64(0), np.int64(0), np.int64(0)
    one, other = np.empty(64, np.int64), np.empty(64, np.int64)
    while begin < N:
        end = begin + 1
        while end < N and keys[end] == keys[begin]:
            end += 1
        k = end - begin
        if k > len(one):
            one, other = np.empty(2 * k, np.int64), np.empty(2 * k, np.int64)
        if descending(k, begin, order, frames, one):
            while merge_neighbours(k, one, other) > 1:
                one, other = other, one
            for q in range(k):
                one[q] = other[q]
                order[begin + q] = other[q] & 0xffffffff
        start[v], voxel_keys[v], out_gone[v] = n, keys[begin], 1
        same, last = np.int64(owner[order[begin]]), np.int64(-1)
        for q in range(k):
            f = one[q] >> 32
            if f != last:
                first[n], out_frames[n] = begin + q, f
                n += 1
            last = f
            if leaves[f]:
                same = -1
            if not some_gone or not gone[owner[order[begin + q]]]:
                out_gone[v] = 0
        # One of which some have left is another, too.
        old[v] = same if same >= 0 and counts[same] == n - start[v] else -1
        v += 1
        begin = end
    start[v], first[n] = n, N
    return v


@inlined
def descending(k, begin, order, frames, numbers):
    """Write frame << 32 | row of order[begin : begin + k] to numbers; return if they descend."""
    descends, last = False, np.int64(-1)
    for q in range(k):
        row = np.int64(order[begin + q])
        own = np.int64(frames[row]) << 32 | row
        descends |= own < last
        numbers[q] = own
        last = own
    return descends


@inlined
def merge_neighbours(k, numbers, merged):
    """
    Merge each second ascending run of numbers[:k] with the one before; return how many are left.

    Those of a voxel are a few histories one after the other, each in the order of its frames.

    """
    runs, begin = 0, 0
    while begin < k:
        half = begin + 1
        while half < k and numbers[half] > numbers[half - 1]:
            half += 1
        end = min(half + 1, k)
        while end < k and numbers[end] > numbers[end - 1]:
            end += 1
        a, b = begin, half
        for q in range(begin, end):
            if b >= end or (a < half and numbers[a] < numbers[b]):
                merged[q] = numbers[a]
                a += 1
            else:
                merged[q] = numbers[b]
                b += 1
        runs += 1
        begin = end
    return runs


@kernel
def meet(first, order, owner, voxels, labels, confidences, places, out_labels, out_confidences,
         out_offsets):
    """
    Make one observation of each group: the label with the largest sum of confidences.

    first (n + 1,) as of group(); the others by row; out_... receive n observations.

    """
    sums = np.zeros(65536)
    for n in range(len(first) - 1):
        at, end = np.int64(first[n]), np.int64(first[n + 1])
        if end == at + 1:
            p = order[at]
            out_labels[n], out_confidences[n] = labels[p], confidences[p]
            for axis in range(3):
                out_offsets[n, axis] = places[p, axis] // (FINE // COARSE)
            continue
        for p in range(at + 1, end):    # in lexicographic order of the voxels that they were in
            q, mine = p, order[p]
            while q > at and before(voxels, owner[mine], owner[order[q - 1]]):
                order[q] = order[q - 1]
                q -= 1
            order[q] = mine
        for p in range(at, end):
            sums[labels[order[p]]] += np.float64(confidences[order[p]])
        most, best = 0.0, np.int64(UNKNOWN)
        for p in range(at, end):
            most = max(most, sums[labels[order[p]]])
        for p in range(at, end):
            c = np.int64(labels[order[p]])
            if most - sums[c] <= TIE:
                best = min(best, c)
        out_labels[n] = best
        out_confidences[n] = np.float32(sums[best] / (end - at))
        for p in range(at, end):
            sums[labels[order[p]]] = 0.0
        for axis in range(3):
            total = np.int64(0)
            for p in range(at, end):
                total += places[order[p], axis]
            out_offsets[n, axis] = total // ((end - at) * (FINE // COARSE))


@inlined
def before(voxels, a, b):
    """Return whether voxel a comes before voxel b in lexicographic order."""
    for axis in range(3):
        if voxels[a, axis] != voxels[b, axis]:
            return voxels[a, axis] < voxels[b, axis]
    return False


@kernel
def recount(start, labels, confidences, evidence_start, classes, sums, majority, switches, starts,
            changes):
    """
    Write evidence, in order of appearance, majority and switches of each voxel's history.

    starts and changes (65536,) int64 receive the class counters. Returns the evidence's length.

    """
    n, place = np.int64(0), np.full(65536, -1, np.int64)
    for v in range(len(start) - 1):
        begin = n
        evidence_start[v] = begin
        for p in range(start[v], start[v + 1]):
            c = np.int64(labels[p])
            if place[c] < begin:
                place[c] = n
                classes[n] = c
                sums[n] = 0.0
                n += 1
            sums[place[c]] += np.float64(confidences[p])
            if p > start[v]:
                last = labels[p - 1]
                starts[last] += 1
                if last != c:
                    changes[last] += 1
                    switches[v] += 1
        most, best = 0.0, np.int64(UNKNOWN)
        for e in range(begin, n):
            most = max(most, sums[e])
        for e in range(begin, n):
            if most - sums[e] <= TIE:
                best = min(best, np.int64(classes[e]))
        majority[v] = best
    evidence_start[len(start) - 1] = n
    return n
