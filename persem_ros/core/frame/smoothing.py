"""Smoothing in image space: the baseline ema2d of spec section 4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.frames import UNKNOWN


class EmaImages:
    """
    p_t = alpha p_(t-1) + (1 - alpha) onehot(L_t) per pixel, p_0 one-hot; label = argmax.

    An ignored pixel leaves p as it is; the state starts anew when the size changes. A tie goes
    to the smaller id.

    """

    def __init__(self, alpha: float) -> None:
        self.alpha = float(alpha)
        self._ids = np.empty((0, 0, 0), np.int32)
        self._weights = np.empty((0, 0, 0))

    def update(self, labels: NDArray[np.int32]) -> NDArray[np.uint16]:
        """
        Take in one label image and return the smoothed one.

        Parameters
        ----------
        labels : ndarray, shape (h, w), int32
            -1: ignored.

        Returns
        -------
        ndarray, shape (h, w), uint16
            UNKNOWN where nothing was ever seen.

        """
        labels = np.require(labels, np.int32, ('C', 'W'))
        if self._ids.shape[1:] != labels.shape:
            self._ids = np.full((2,) + labels.shape, -1, np.int32)
            self._weights = np.zeros((2,) + labels.shape)
        if not all(split(_fits, labels.shape[0], labels, self._ids, grain=64)):
            more = (1,) + labels.shape
            self._ids = np.concatenate([self._ids, np.full(more, -1, np.int32)])
            self._weights = np.concatenate([self._weights, np.zeros(more)])
        out = np.empty(labels.shape, np.uint16)
        split(_smooth, labels.shape[0], labels, self.alpha, self._ids, self._weights, out,
              grain=64)
        return out


@kernel
def _fits(begin, end, labels, ids):
    """Return whether every pixel of rows begin .. end has a place for its label's weight."""
    for v in range(begin, end):
        for u in range(labels.shape[1]):
            if labels[v, u] >= 0:
                k = 0
                while k < len(ids) and ids[k, v, u] != labels[v, u] and ids[k, v, u] >= 0:
                    k += 1
                if k == len(ids):
                    return False
    return True


@kernel
def _smooth(begin, end, labels, alpha, ids, weights, out):
    """Update rows begin .. end; ids are filled from place 0 on, -1 marks a free place."""
    places = len(ids)
    for v in range(begin, end):
        for u in range(labels.shape[1]):
            c = labels[v, u]
            if c >= 0 and ids[0, v, u] < 0:
                ids[0, v, u] = c
                weights[0, v, u] = 1.0
            elif c >= 0:
                for k in range(places):
                    weights[k, v, u] *= alpha
                k = 0
                while ids[k, v, u] != c and ids[k, v, u] >= 0:
                    k += 1
                ids[k, v, u] = c
                weights[k, v, u] += 1.0 - alpha
            most, best = -1.0, UNKNOWN
            for k in range(places):
                if ids[k, v, u] >= 0:
                    most = max(most, weights[k, v, u])
            for k in range(places):
                if ids[k, v, u] >= 0 and most - weights[k, v, u] <= 1e-9:
                    best = min(best, ids[k, v, u])
            out[v, u] = best
