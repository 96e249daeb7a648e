"""The median depth of a frame, exactly, and whether it lies in an interval, sooner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split

LOW_BITS = 46   # of a float64 that are not looked at first: bins are 1.6 % wide
BINS = 1 << 63 - LOW_BITS
AT_ONCE = 4096  # depths that are counted before it is asked whether they suffice
TINY = 5e-324   # what is smaller is no measurement: the smallest float64 above zero


def median_depth(depth: NDArray[np.float64], low: float, high: float) -> float:
    """
    Return the median of the depths that are measurements within low .. high; 0.0: none is.

    The same as NumPy's, which takes ten times as long: only the bin in the middle is sorted.

    """
    depth = np.require(depth, np.float64, ['C', 'W'])
    until = np.cumsum(bin_counts(depth, float(low), float(high)))
    n = int(until[-1])
    if n == 0:
        return 0.0
    ranks = (n - 1) // 2, n // 2
    bins = np.searchsorted(until, ranks, side='right')
    edges = (np.array([bins[0], bins[1] + 1]) << LOW_BITS).view(np.float64)
    near = depth[(depth >= edges[0]) & (depth < edges[1]) & (depth >= low) & (depth <= high)
                 & (depth > 0.0)]
    before = int(until[bins[0] - 1]) if bins[0] else 0
    places = [rank - before for rank in ranks]
    near = np.partition(near, places)
    return float((near[places[0]] + near[places[1]]) / 2)


def bin_counts(depth: NDArray[np.float64], low: float, high: float) -> NDArray[np.int64]:
    """Return how many depths within low .. high each bin of their highest bits has."""
    counts = np.zeros((2, BINS), np.int32)
    split(count_bins, 2, depth, depth.view(np.int64), low, high, counts, grain=1)
    return counts.sum(axis=0, dtype=np.int64)


@kernel
def count_bins(begin, end, depth, bits, low, high, counts):
    """Count the depths of the halves begin .. end of the rows by their highest bits."""
    for half in range(begin, end):
        for v in range(half * depth.shape[0] // 2, (half + 1) * depth.shape[0] // 2):
            for u in range(depth.shape[1]):
                if low <= depth[v, u] <= high and depth[v, u] > 0.0:
                    counts[half, bits[v, u] >> LOW_BITS] += 1


def median_within(depth: NDArray[np.float64], low: float, high: float, least: float,
                  most: float) -> bool:
    """
    Return whether the median of the depths within low .. high surely lies in least .. most.

    Once more than half of the depths are known to, the others are not looked at. False: it does
    not, or that was not found out. Of 5 million depths 1.3 ms instead of 15 for the median.

    """
    flat = np.require(depth, np.float64, ['C', 'W']).reshape(-1)
    low = max(float(low), TINY)
    least, most = max(float(least), low), min(float(most), float(high))
    counts = np.zeros((2, 5), np.int64)
    split(count_below, 2, flat, low, least, most, float(high), counts, grain=1)
    before, below, until, there, read = counts.sum(axis=0).tolist()
    unread = flat.size - read
    return 2 * max(below - before, there - until) + unread < there - before


@kernel
def count_below(begin, end, depth, low, least, most, high, counts):
    """Count the depths of the halves begin .. end below each of four limits, and all read."""
    for half in range(begin, end):
        first, stop = half * len(depth) // 2, (half + 1) * len(depth) // 2
        size, count = stop - first, counts[half]
        while first < stop and 2 * (count[2] - count[1]) <= size:
            last = min(first + AT_ONCE, stop)
            count_piece(depth[first:last], low, least, most, high, count)
            first = last
        count[4] = size - (stop - first)


@inlined
def count_piece(depth, low, least, most, high, counts):
    """
    Add how many depths lie below each limit.

    From the first on and in integers, which the compiler counts by vector instructions: 0.2 ns a
    depth, a quarter of what the same took in numbers of float64.

    """
    before, below, until, there = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    for u in range(len(depth)):
        d = depth[u]
        before += np.int64(d < low)
        below += np.int64(d < least)
        until += np.int64(d <= most)
        there += np.int64(d <= high)
    counts[0] += before
    counts[1] += below
    counts[2] += until
    counts[3] += there
