"""The image front end: a label and a depth image become labelled points (spec section 1)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.place import Measured
from persem_ros.core.frame.render import nearest
from persem_ros.core.jit import kernel, split
from persem_ros.errors import PersemError
from persem_ros.frames import Frame, IGNORED, MAX_ID, same_aspect
from persem_ros.settings.config import Memory

Pixel = TypeVar('Pixel', bound=np.generic)


def points(frame: Frame, settings: Memory) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """
    Return the labelled points of a frame, one per depth pixel.

    Parameters
    ----------
    frame : persem_ros.frames.Frame
        Labels, depth and camera.
    settings : persem_ros.settings.config.Memory
        Depth range, ignored and dynamic labels.

    Returns
    -------
    points : ndarray, shape (h * w, 3), float64
        Metres in the optical frame, row by row; NaN where depth is missing or out of range.
    labels : ndarray, shape (h * w,), int32
        The pixel's id; -1 where it does not count.

    """
    return backprojected(frame, settings), counted_labels(frame, settings)


def counted_labels(frame: Frame, settings: Memory) -> NDArray[np.int32]:
    """Return the labels alone, as in points(); a label without weight does not count."""
    labels = counted(on_depth(frame, frame.labels), settings).reshape(-1)
    if frame.weights is not None:
        labels[weights(frame) == 0] = IGNORED
    return labels


def weights(frame: Frame) -> NDArray[np.uint32] | None:
    """Return the weight of each depth pixel's label, shape (h * w,), None: all are certain."""
    if frame.weights is None:
        return None
    return on_depth(frame, frame.weights, 0).reshape(-1)


def on_depth(frame: Frame, image: NDArray[Pixel], fill: int = IGNORED) -> NDArray[Pixel]:
    """
    Return an image on the grid of the labels (H, W) on that of the depth (h, w).

    Pixels that the labels do not show get *fill*.

    """
    if frame.matching is None:
        return resampled(image, frame.depth.shape)
    places = frame.matching.labels_of
    taken = np.asarray(image).reshape(-1)[np.maximum(places, 0)]
    taken[places < 0] = fill
    return taken


def on_labels(frame: Frame, image: NDArray[Pixel], fill: int) -> NDArray[Pixel]:
    """Return an image on the grid of the depth (h, w) on that of the labels, as on_depth()."""
    if frame.matching is None:
        return nearest(image, frame.labels.shape)
    places = frame.matching.depth_of
    taken = np.asarray(image).reshape(-1)[np.maximum(places, 0)]
    taken[places < 0] = fill
    return taken


def measured(frame: Frame, settings: Memory) -> Measured:
    """
    Return what a frame measured, for core.frame.observe.gather() and place().

    Pixels are placed from their depths: backprojecting them to points first takes a twelfth of
    the time of integrating a frame.

    """
    none = np.empty(0)
    if frame.points is not None:
        return Measured(_cloud(frame, settings).reshape(-1), none, none, 0.0, 0.0)
    depth = np.require(frame.depth, np.float64, ('C', 'W'))
    rays = np.require(frame.camera.rays, np.float64, ('C', 'W'))
    return Measured(none, depth.reshape(-1), rays.reshape(-1), float(settings.min_depth),
                    float(settings.max_depth))


def backprojected(frame: Frame, settings: Memory) -> NDArray[np.float64]:
    """Return the points alone, as in points()."""
    if frame.points is not None:
        return _cloud(frame, settings)
    depth = np.require(frame.depth, np.float64, ('C', 'W'))
    rays = np.require(frame.camera.rays, np.float64, ('C', 'W'))
    result = np.empty(depth.shape + (3,))
    split(backproject, depth.shape[0], depth, rays, float(settings.min_depth),
          float(settings.max_depth), result, grain=64)
    return result.reshape(-1, 3)


def _cloud(frame: Frame, settings: Memory) -> NDArray[np.float64]:
    """Return the points of a labelled cloud, (h * w, 3); NaN where they are out of range."""
    assert frame.points is not None, 'a cloud has points'
    inside = (frame.depth >= settings.min_depth) & (frame.depth <= settings.max_depth) \
        & (frame.depth > 0.0)
    return np.where(inside[..., None], frame.points, np.nan).reshape(-1, 3)


def resampled(labels: NDArray[Pixel], shape: tuple[int, int]) -> NDArray[Pixel]:
    """
    Return *labels* on a grid of another size and the same aspect ratio, nearest pixel.

    Raises
    ------
    PersemError
        Where the aspect ratios differ by more than a pixel's rounding.

    """
    labels = np.asarray(labels)
    check_aspect(labels.shape, shape)
    return nearest(labels, shape)


def check_aspect(labels: tuple[int, int], depth: tuple[int, int]) -> None:
    """Refuse label and depth images whose shapes (rows, columns) are not proportional."""
    (H, W), (h, w) = labels, depth
    if not same_aspect((W, H), (w, h)):
        raise PersemError(
            f'label image {W} x {H} and depth image {w} x {h} differ in shape: expected one '
            'aspect ratio (crop or register one of them)')


def counted(labels: NDArray[np.int32], settings: Memory) -> NDArray[np.int32]:
    """Return a copy of *labels*, int32, with -1 for each pixel that does not count."""
    table = counting(settings)
    labels = np.require(labels, np.int32, ('C', 'W'))
    result = np.empty(labels.shape, np.int32)
    split(_count, labels.shape[0], labels, table, result, grain=64)
    return result


_tables: dict[tuple[int, ...], NDArray[np.int32]] = {}


def counting(settings: Memory) -> NDArray[np.int32]:
    """Return a look-up table id -> id or -1 for 0 .. 65534: what each id is counted as."""
    key = tuple(settings.ignore_labels) + tuple(settings.dynamic_labels)
    if key not in _tables:
        table = np.arange(MAX_ID + 1, dtype=np.int32)
        table[[c for c in key if 0 <= c <= MAX_ID]] = IGNORED
        _tables[key] = table
    return _tables[key]


@kernel
def _count(begin, end, labels, table, out):
    """Write the id of each pixel of rows begin .. end that counts, -1 for the others."""
    for v in range(begin, end):
        for u in range(labels.shape[1]):
            c = labels[v, u]
            out[v, u] = table[c] if 0 <= c <= MAX_ID else IGNORED


@kernel
def backproject(start, stop, depth, rays, min_depth, max_depth, out):
    """Write (x, y, z) = (ray * d, d) of rows start .. stop; NaN where d is no measurement."""
    for v in range(start, stop):
        for u in range(depth.shape[1]):
            d = depth[v, u]
            if min_depth <= d <= max_depth and d > 0.0:
                out[v, u, 0] = rays[v, u, 0] * d
                out[v, u, 1] = rays[v, u, 1] * d
                out[v, u, 2] = d
            else:
                out[v, u, 0] = np.nan
                out[v, u, 1] = np.nan
                out[v, u, 2] = np.nan
