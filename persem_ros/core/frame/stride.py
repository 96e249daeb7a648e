"""Which pixels of a frame are integrated: memory.stride, and what 0 (auto) makes of a frame."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from persem_ros.core.frame.images import on_depth
from persem_ros.core.frame.median import median_depth, median_within
from persem_ros.frames import Camera, Frame
from persem_ros.settings.config import Memory

SPAN = 3        # pixels across a voxel at the median depth, which auto leaves
FEW = 32        # every so many-th pixel of every so many-th row is asked first
HAIR = 1e-9     # by which an interval of depths is narrowed, for rounding
MOST = 1 << 16  # larger strides leave one pixel, too
_THINNED: WeakKeyDictionary[Camera, tuple[int, Camera]] = WeakKeyDictionary()


def stride_of(frame: Frame, settings: Memory) -> int:
    """
    Return the stride of a frame: max(1, floor(f voxel_size / (SPAN median depth))) for 0.

    The points of a cloud are no pixels of any size: there auto takes all (spec section 13).

    """
    if settings.stride or frame.points is not None:
        return max(settings.stride, 1)
    low, high = settings.min_depth, settings.max_depth
    across = float(frame.camera.K[0, 0]) * settings.voxel_size
    few = frame.depth[::FEW, ::FEW]
    few = few[(few >= low) & (few <= high) & (few > 0.0)]
    if len(few) and across > 0.0:   # the stride is the same for all medians of an interval
        n = _stride(across, float(np.median(few)))
        least = across / (SPAN * (n + 1)) * (1 + HAIR)
        most = across / (SPAN * n) * (1 - HAIR) if n > 1 else high
        if _stride(across, least) == _stride(across, most) == n and median_within(
                frame.depth, low, high, least, most):
            return n
    middle = median_depth(frame.depth, low, high)
    return _stride(across, middle) if middle else 1


def thinned(frame: Frame, settings: Memory, n: int = 0) -> Frame:
    """
    Return what is integrated of a frame: every n-th pixel of every n-th row of its depth.

    n is stride_of() of it, where that is known already.

    """
    n = n or stride_of(frame, settings)
    if n == 1:
        return frame
    every, shape = np.s_[::n, ::n], frame.depth.shape
    weights = frame.weights if frame.weights is None else \
        on_depth(frame, frame.weights, 0).reshape(shape)[every]
    return replace(
        frame, labels=on_depth(frame, frame.labels).reshape(shape)[every],
        depth=frame.depth[every], camera=_thinned_camera(frame.camera, n), matching=None,
        weights=weights, points=frame.points if frame.points is None else frame.points[every])


def _stride(across: float, depth: float) -> int:
    """Return the stride for a median depth; *across*: pixels of a voxel times its depth."""
    return max(1, int(min(across / (SPAN * depth), MOST)))


def _thinned_camera(camera: Camera, n: int) -> Camera:
    """Return the camera of every n-th pixel, kept for the next frames: rays are large."""
    kept = _THINNED.get(camera)
    if kept is None or kept[0] != n:
        rays = np.ascontiguousarray(camera.rays[::n, ::n])
        kept = _THINNED[camera] = n, replace(camera, rays=rays)
    return kept[1]
