"""Observations that moved, gathered by voxel again. Kernels only; core.memory.move drives them."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.displace import COARSE, FINE
from persem_ros.core.memory.evidence import TIE
from persem_ros.frames import UNKNOWN


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
