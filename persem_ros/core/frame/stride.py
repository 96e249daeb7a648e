"""Which pixels of a frame are integrated: memory.stride, and what 0 (auto) makes of a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.images import on_depth
from persem_ros.core.jit import kernel, split
from persem_ros.frames import Frame
from persem_ros.settings.config import Memory

SPAN = 3        # pixels across a voxel at the median depth, which auto leaves
LOW_BITS = 46   # of a float64 that are not looked at first: bins are 1.6 % wide
BINS = 1 << 63 - LOW_BITS


def stride_of(frame: Frame, settings: Memory) -> int:
    """
    Return the stride of a frame: max(1, floor(f voxel_size / (SPAN median depth))) for 0.

    The points of a cloud are no pixels of any size: there auto takes all (spec section 13).

    """
    if settings.stride or frame.points is not None:
        return max(settings.stride, 1)
    middle = median_depth(frame.depth, settings.min_depth, settings.max_depth)
    focal = float(frame.camera.K[0, 0])
    return max(1, int(focal * settings.voxel_size / (SPAN * middle))) if middle else 1


def thinned(frame: Frame, settings: Memory) -> Frame:
    """Return what is integrated of a frame: every n-th pixel of every n-th row of its depth."""
    n = stride_of(frame, settings)
    if n == 1:
        return frame
    every, shape = np.s_[::n, ::n], frame.depth.shape
    weights = frame.weights if frame.weights is None else \
        on_depth(frame, frame.weights, 0).reshape(shape)[every]
    return replace(
        frame, labels=on_depth(frame, frame.labels).reshape(shape)[every],
        depth=frame.depth[every], camera=replace(frame.camera, rays=frame.camera.rays[every]),
        matching=None, weights=weights,
        points=frame.points if frame.points is None else frame.points[every])


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
