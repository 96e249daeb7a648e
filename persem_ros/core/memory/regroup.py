"""Observations that moved, gathered by voxel again. Kernels only; core.memory.move drives them."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.evidence import TIE
from persem_ros.frames import UNKNOWN

FINE = 65536        # of a voxel's edge: what the place of a point is counted in, 16 bits
COARSE = 256        # the same in offsets
DIGIT = 11          # bits that one pass of a sort looks at
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
def displace(voxels, owner, frames, offsets, turns, leaves, size, out, places):
    """
    Write each observation's voxel to out (N, 3) int32 and its place there to places, uint16.

    Those of frames that are not in leaves stay. Returns whether all have a place.

    """
    for p in range(len(owner)):
        f, o = frames[p], owner[p]
        if not leaves[f]:
            for axis in range(3):
                out[p, axis] = voxels[o, axis]
                places[p, axis] = offsets[p, axis] * np.int64(FINE // COARSE)
            continue
        x = middle(voxels[o, 0], offsets[p, 0], size)
        y = middle(voxels[o, 1], offsets[p, 1], size)
        z = middle(voxels[o, 2], offsets[p, 2], size)
        for axis in range(3):
            at = (turns[f, 3 * axis] * x + turns[f, 3 * axis + 1] * y + turns[f, 3 * axis + 2] * z
                  + turns[f, 9 + axis]) / size
            low = np.floor(at)
            if not abs(low) < LIMIT:
                return False
            out[p, axis] = np.int32(low)
            places[p, axis] = np.uint16(min((at - low) * FINE, FINE - 1.0))
    return True


@kernel
def bounds(voxels, low, high):
    """Write the smallest and largest block index of voxels (n, 3), n > 0."""
    for axis in range(3):
        low[axis] = high[axis] = voxels[0, axis] >> 3
    for p in range(len(voxels)):
        for axis in range(3):
            b = np.int64(voxels[p, axis]) >> 3
            low[axis] = min(low[axis], b)
            high[axis] = max(high[axis], b)


@kernel
def number(voxels, low, span, keys):
    """Write to keys (n,) numbers that sort voxels by block, then by cell."""
    for p in range(len(voxels)):
        i, j, k = np.int64(voxels[p, 0]), np.int64(voxels[p, 1]), np.int64(voxels[p, 2])
        block = (((i >> 3) - low[0]) * span[1] + ((j >> 3) - low[1])) * span[2] + (k >> 3) - low[2]
        keys[p] = block * 512 + ((i & 7) * 8 + (j & 7)) * 8 + (k & 7)


@kernel
def voxels_of(keys, low, span, voxels):
    """Write the voxels (n, 3) int32 that have these keys of number()."""
    for p in range(len(keys)):
        block, cell = keys[p] >> 9, keys[p] & 511
        row = block // span[2]
        voxels[p, 0] = (row // span[1] + low[0]) * 8 + (cell >> 6)
        voxels[p, 1] = (row % span[1] + low[1]) * 8 + (cell >> 3 & 7)
        voxels[p, 2] = (block % span[2] + low[2]) * 8 + (cell & 7)


@kernel
def ordered(keys, frames, n_frames, largest, order, after, own, other):
    """
    Return the order (n,) uint32 by key, then by frame, then by row: one of order and after.

    Room for n numbers: order, after uint32; own, other int64.

    """
    n, count = len(keys), np.zeros(n_frames + 1, np.int64)
    for p in range(n):
        count[frames[p] + 1] += 1
    for f in range(n_frames):
        count[f + 1] += count[f]
    for p in range(n):
        order[count[frames[p]]] = p
        count[frames[p]] += 1
    for p in range(n):
        own[p] = keys[order[p]]
    shift = np.int64(0)
    while largest >> shift > 0:
        starts = np.zeros((1 << DIGIT) + 1, np.int64)
        for p in range(n):
            starts[(own[p] >> shift & ((1 << DIGIT) - 1)) + 1] += 1
        for d in range(1 << DIGIT):
            starts[d + 1] += starts[d]
        for p in range(n):
            d = own[p] >> shift & ((1 << DIGIT) - 1)
            q = starts[d]
            starts[d] += 1
            other[q] = own[p]
            after[q] = order[p]
        own, other = other, own
        order, after = after, order
        shift += DIGIT
    return order


@kernel
def gather(order, keys, frames, owner, voxels, counts, gone, leaves, labels, confidences, places,
           out_labels, out_confidences, out_frames, out_offsets, start, voxel_keys, old, out_gone):
    """
    Make one observation of those of a frame that meet in a voxel; return how many voxels are left.

    Parameters
    ----------
    order, keys, frames, owner, labels, confidences, places : ndarray, shape (N,)
        The observations, and the rows of the voxels that they were in.
    voxels, counts, gone : ndarray, shape (V,)
        These voxels: indices (V, 3), how many observations each had, whether it had gone.
    leaves : ndarray, shape (F,)
        Frames that move.
    out_labels, out_confidences, out_frames, out_offsets : ndarray, shape (N,)
        Receive what is left of the observations.
    start, voxel_keys, old, out_gone : ndarray, shape (N,), start (N + 1,)
        Receive, by voxel, where its observations begin, its key, the row of the voxel that it is
        where nothing came and nothing left, else -1, and whether all of it had gone.

    """
    # Not the literal 0, for whose type numba would compile meet() a second time.
    n, v, at = np.int64(0), -1, np.int64(0)
    sums = np.zeros(65536)
    N = len(order)
    while at < N:
        key, f = keys[order[at]], frames[order[at]]
        end = at + 1
        while end < N and keys[order[end]] == key and frames[order[end]] == f:
            end += 1
        if v < 0 or voxel_keys[v] != key:
            v += 1
            start[v] = n
            voxel_keys[v] = key
            old[v] = owner[order[at]]
            out_gone[v] = 1
        if leaves[f]:
            old[v] = -1
        for p in range(at, end):
            if not gone[owner[order[p]]]:
                out_gone[v] = 0
        if end == at + 1:
            p = order[at]
            out_labels[n], out_confidences[n] = labels[p], confidences[p]
            for axis in range(3):
                out_offsets[n, axis] = places[p, axis] // (FINE // COARSE)
        else:
            meet(order, at, end, owner, voxels, labels, confidences, places, sums, n, out_labels,
                 out_confidences, out_offsets)
        out_frames[n] = f
        n += 1
        at = end
    start[v + 1] = n
    for r in range(v + 1):          # one of which some have left is another, too
        if old[r] >= 0 and counts[old[r]] != start[r + 1] - start[r]:
            old[r] = -1
    return v + 1


@kernel
def meet(order, at, end, owner, voxels, labels, confidences, places, sums, n, out_labels,
         out_confidences, out_offsets):
    """Make one observation of some of a frame: the label with the largest sum of confidences."""
    for p in range(at + 1, end):        # in lexicographic order of the voxels that they were in
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
