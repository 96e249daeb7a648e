"""Why nothing of a recording went into the map: what its pixels lacked, and what to type."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.images import counted, on_depth
from persem_ros.preflight.depth_fit import likely_unit

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.settings.config import Memory

SHOWN = 8       # ids in a sentence


class Emptiness:
    """
    What the pixels of frames without any observation have.

    Parameters
    ----------
    settings : persem_ros.settings.config.Memory
    trusting : bool
        Whether depth.min_confidence leaves pixels out.

    """

    def __init__(self, settings: Memory, trusting: bool = False) -> None:
        self._settings, self._trusting = settings, trusting
        self._low, self._high = math.inf, -math.inf     # of the depths that are measurements
        self._near = self._in_range = self._labelled = self._both = False
        self._ids: set[int] = set()

    def frame(self, frame: Frame) -> None:
        """Look at one that gave no observation."""
        settings, labels = self._settings, on_depth(frame, frame.labels)
        inside = self.depth(frame.depth)
        known = counted(labels, settings) >= 0
        self._labelled |= bool(known.any())
        self._both |= bool((inside & known).any())
        if len(self._ids) <= SHOWN:
            self._ids.update(np.unique(labels).tolist())

    def depth(self, depth: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Look at a depth image (H, W), metres; return which pixels are in range."""
        settings = self._settings
        found = depth[np.isfinite(depth) & (depth > 0.0)]
        if found.size:
            self._low = min(self._low, float(found.min()))
            self._high = max(self._high, float(found.max()))
            self._near |= bool((found < settings.min_depth).any())
        inside = (depth > 0.0) & (settings.min_depth <= depth) & (depth <= settings.max_depth)
        self._in_range |= bool(inside.any())
        return inside

    def of_depth(self) -> str:
        """Return why the depth alone leaves nothing, '' where it is in range somewhere."""
        settings = self._settings
        if self._high < 0:
            return 'no pixel has a depth: all of them are 0, negative, NaN or infinite' + (
                '; depth.min_confidence may be what leaves them out' if self._trusting else '')
        if not self._in_range:
            return (f'no pixel was between memory.min_depth {settings.min_depth:g} m and '
                    f'memory.max_depth {settings.max_depth:g} m; depths are {self._low:.4g} to '
                    f"{self._high:.4g} m: is the depth's unit right?{self._other_range()}")
        return ''

    def sentence(self) -> str:
        """Return why nothing was observed."""
        settings, of_depth = self._settings, self.of_depth()
        if of_depth:
            return of_depth
        if not self._labelled:
            ids = sorted(self._ids)[:SHOWN]
            more = ', …' if len(self._ids) > SHOWN else ''
            return (f'no pixel has a label that counts; the ids are '
                    f'{", ".join(map(str, ids))}{more}, left out are memory.ignore_labels '
                    f'{list(settings.ignore_labels)}, memory.dynamic_labels '
                    f'{list(settings.dynamic_labels)} and ids below 0 or above 65534')
        if not self._both:
            return ('no pixel has both, a depth in range and a label that counts: pixels with a '
                    'label have no depth between memory.min_depth and memory.max_depth, or are '
                    'the images of different places?')
        if settings.min_pixels > 1:
            return (f'no voxel was seen by memory.min_pixels {settings.min_pixels} pixels of a '
                    f'frame (memory.stride is {_stride(settings)})')
        return (f'no pixel of those that memory.stride {_stride(settings)} leaves has depth and '
                'a label that counts, or positions and depths are of no place (a million voxels '
                'away)')

    def _other_range(self) -> str:
        """Return the options with which the depths would be in range."""
        unit = likely_unit(self._low, self._high, self._settings)
        if unit:
            return f' {unit[0].upper()}{unit[1:]}'
        if not self._near:
            return f' If so: --set memory.max_depth={_up(self._high)}'
        if self._high < self._settings.min_depth:
            return f' If so: --set memory.min_depth={_down(self._low)}'
        return ''


def _stride(settings: Memory) -> str:
    return str(settings.stride or '0, auto')


def _up(metres: float) -> str:
    """Return the next larger number of two digits, as text."""
    step = 10.0 ** (math.floor(math.log10(metres)) - 1)
    return f'{math.ceil(metres / step) * step:.6g}'


def _down(metres: float) -> str:
    """Return the next smaller number of two digits, as text."""
    step = 10.0 ** (math.floor(math.log10(metres)) - 1)
    return f'{math.floor(metres / step) * step:.6g}'
