"""Colours of class ids: those of a legend, and made-up ones for ids that no legend knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
import logging
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import UNKNOWN

LOG = logging.getLogger(__name__)
GREY = 96, 96, 96       # of ids that the settings ignore


class Palette:
    """
    Colours of all ids.

    Parameters
    ----------
    known : mapping of int to (int, int, int)
        Red, green, blue of the ids that have a colour.
    unlabelled : sequence of int
        Ids that are grey, unless they are known.
    title : str
        Of the legend, for the warning of ids that it does not know.

    """

    def __init__(self, known: Mapping[int, tuple[int, int, int]],
                 unlabelled: Sequence[int] = (), title: str = '') -> None:
        self._title = title
        self._warns = [True] if known else []   # of ids that are not known, once
        table = np.zeros((UNKNOWN + 1, 4), np.uint8)
        table[:, :3] = made_up()
        table[list(unlabelled)] = *GREY, 1
        table[UNKNOWN] = 0, 0, 0, 1
        for number, color in known.items():
            table[number] = *color, 1
        # Red, green, blue and "known" of every id as one uint32, shape (65536,).
        self._packed = table.view(np.uint32).ravel()

    def colors(self, ids: NDArray[Any]) -> NDArray[np.uint8]:
        """
        Return the colours of an array of ids.

        An id that the legend does not know has a colour of its own, the same in every run, and
        is warned about once. Negative ids and ids above 65535 are black.

        Parameters
        ----------
        ids : ndarray of integers, any shape
            Class ids.

        Returns
        -------
        ndarray, shape (*ids.shape, 3), uint8
            Red, green, blue.

        """
        ids = np.asarray(ids)
        if ids.dtype == np.uint8 and ids.ndim == 2 and ids.size:
            return self._colors_of_bytes(ids)
        if ids.dtype not in (np.uint8, np.uint16):
            ids = ids.astype(np.int64)      # NumPy 2.5 refuses 65535 among int16
            ids = np.where((ids < 0) | (ids > UNKNOWN), UNKNOWN, ids).astype(np.uint16)
        packed = self._packed.take(ids)            # four bytes a pixel: one move, not three
        if self._warns:
            self._warn(packed, ids)
        if not packed.size:
            return np.zeros((*ids.shape, 3), np.uint8)
        # OpenCV drops the fourth byte forty times as fast as a slice of NumPy's.
        pixels = np.ascontiguousarray(packed).view(np.uint8).reshape(1, -1, 4)
        colors: NDArray[np.uint8] = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB), np.uint8)
        return colors.reshape(*ids.shape, 3)

    def _colors_of_bytes(self, ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return colors() of an image of bytes, by OpenCV."""
        packed = self._packed[:256]
        table = packed.view(np.uint8).reshape(256, 1, 4)
        if self._warns and not cv2.LUT(ids, table[:, 0, 3].copy()).all():
            self._warn(packed.take(ids), ids)
        return np.asarray(cv2.applyColorMap(ids, table[..., :3].copy()), np.uint8)

    def _warn(self, packed: NDArray[np.uint32], ids: NDArray[Any]) -> None:
        """Log the ids that the legend does not know, once in its life."""
        strange = packed.view(np.uint8).reshape(*ids.shape, 4)[..., 3] == 0
        if strange.any():
            try:        # threads write images side by side; one of them says it
                self._warns.pop()
            except IndexError:
                return
            LOG.warning('ids %s are not in the legend%s, their colours are made up',
                        ', '.join(map(str, np.unique(ids[strange]).tolist()[:20])),
                        f' {self._title!r}' if self._title else '')


def made_up_colors(ids: NDArray[np.integer[Any]] | list[int]) -> NDArray[np.uint8]:
    """Return distinct colours, shape (n, 3), uint8, for ids without a legend; fixed per id."""
    ids = np.asarray(ids, np.int64)
    hue = ids * 0.6180339887498949 % 1.0            # the golden ratio never comes near itself
    value = np.choose(ids % 3, (0.95, 0.72, 0.5))
    chroma = value * np.choose(ids // 3 % 2, (0.75, 0.5))
    ramp = np.abs((hue[:, None] * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1
    return np.rint(255 * (value[:, None] - chroma[:, None] * (1 - ramp.clip(0, 1)))) \
        .astype(np.uint8)


@cache
def made_up() -> NDArray[np.uint8]:
    """Return the made-up colours of all ids, once a process: 40 ms."""
    return made_up_colors(np.arange(UNKNOWN + 1))
