"""The page's own colours: distinguishable for colour-blind readers (Okabe and Ito, viridis)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# In the order of outputs.map.cloud.SOURCES.
SOURCE_COLORS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167), (213, 94, 0))
SOURCE_TEXTS = {
    'majority': 'the most evidence of the voxel itself',
    'history': "the neighbours' histories outweighed it",
    'trust': 'recent, trusted observations, verified by the neighbours',
    'context': "the neighbours' majority",
    'geometry': 'what places of this shape are called here, and its neighbours'}
VERDICT_COLORS = ((86, 180, 233), (230, 110, 20))
VERDICTS = ('mended', 'spoilt')


def ramp() -> NDArray[np.uint8]:
    """Return the viridis colour ramp, (256, 3) uint8, dark to bright."""
    steps = np.arange(256, dtype=np.uint8)[:, None]
    return np.ascontiguousarray(cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1])


def css(color: NDArray[np.uint8] | tuple[int, int, int]) -> str:
    """Return (red, green, blue) as a CSS colour."""
    return '#{:02x}{:02x}{:02x}'.format(*(int(v) for v in color))


def css_gradient() -> str:
    """Return the ramp as a CSS gradient from left to right."""
    return f'linear-gradient(to right, {", ".join(css(c) for c in ramp()[::17])})'
