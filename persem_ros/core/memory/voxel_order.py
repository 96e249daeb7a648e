"""Kernels that number voxels by their places, and bring observations into that order."""

import numpy as np
from persem_ros.core.jit import inlined, kernel


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
