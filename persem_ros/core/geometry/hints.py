"""What somebody knows of the classes: at which heights above the ground they are found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.groups import HEIGHTS, SHAPES
from persem_ros.settings.heights import parsed

UNLIKELY = 0.01     # how often a class is found where it is not said to be, against elsewhere


def hints(heights: str, classes: NDArray[np.uint16]) -> NDArray[np.float64]:
    """
    Return a factor for P_1(z|b): 1, or UNLIKELY where a shape's heights are out of a class's.

    Parameters
    ----------
    heights : str
        refine.geometry.heights; '': nothing is known.
    classes : ndarray, shape (K,), uint16
        Their ids.

    Returns
    -------
    ndarray, shape (96, K)

    """
    step = np.arange(SHAPES) // (SHAPES // (len(HEIGHTS) + 1))
    factors = np.ones((SHAPES, len(classes)))
    for c, low, high in parsed(heights):
        factors[np.ix_(steps_out(low, high)[step], classes == c)] = UNLIKELY
    return factors


def steps_out(low: float, high: float) -> NDArray[np.bool_]:
    """Return which steps of height (8,) lie wholly out of *low* .. *high* voxels."""
    edges = np.array([-np.inf, *HEIGHTS, np.inf])
    return (edges[1:] <= low) | (edges[:-1] > high)
