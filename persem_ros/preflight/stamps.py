"""Stamps: how many label images would find their depth and their pose, and what is in the way."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from persem_ros.preflight.findings import Finding
from persem_ros.preflight.sample import Sample, Stamps, View


def check(sample: Sample) -> Iterator[Finding]:
    """Yield why label images would find no partner."""
    yield from ()


def distances(labels: Stamps, depth: Stamps) -> NDArray[np.int64]:
    """
    Return how far each label image is behind the nearest depth image.

    Parameters
    ----------
    labels, depth : ndarray, shape (N,) and (M,), int64
        Stamps, ns; M is at least 1.

    Returns
    -------
    ndarray, shape (N,), int64
        Nanoseconds, positive where the label image is later.

    """
    depth = np.unique(depth)
    after = np.clip(np.searchsorted(depth, labels), 1, max(len(depth) - 1, 1))
    before, after = depth[after - 1], depth[np.minimum(after, len(depth) - 1)]
    nearer = np.abs(labels - before) <= np.abs(labels - after)
    return np.asarray(labels - np.where(nearer, before, after), np.int64)


def usable(view: View, sample: Sample) -> int:
    """Return how many of the label images looked at a replay would use."""
    labels = np.unique(view.stamps['labels'])
    if not len(labels) or not len(view.stamps['depth']):
        return 0
    tolerance = round(sample.config.sync.tolerance * 1e9)
    near = np.abs(distances(labels, view.stamps['depth'])) <= tolerance
    return sum(view.poses.lookup(stamp, view.image_frame).T is not None
               for stamp in labels[near].tolist())
