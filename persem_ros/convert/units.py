"""Is the depth in the unit that its files are read in? Frames with known poses tell it."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.images import UNITS
from persem_ros.core.agreement import unit_factor, WORST

LOG = logging.getLogger(__name__)


def check_unit(depths: dict[int, NDArray[np.float64]], poses: dict[int, NDArray[np.float64]],
               K: NDArray[np.float64], per_metre: float) -> tuple[float, float]:
    """
    Warn when another unit fits better than *per_metre*, the stored units that make a metre.

    Returns
    -------
    float
        The factor that the depth needs; 1 where it is right or cannot be told.
    float
        The error of unit_factor() as it is read.

    """
    factor, now, then = unit_factor(depths, poses, K)
    if factor != 1.0:
        where = 'nowhere within 10.0 %' if now > 0.99 * WORST else f'within {100 * now:.1f} %'
        LOG.warning('the depth unit looks wrong: depth of one frame meets that of another %s, but '
                    'within %.1f %% with --depth-unit %s', where, 100 * then,
                    name_of_unit(per_metre / factor))
    return factor, now


def name_of_unit(per_metre: float) -> str:
    """Return m, cm or mm, or else the number of units that make a metre."""
    for name, value in UNITS.items():
        if abs(per_metre / value - 1) < 1e-6:
            return name
    return f'{per_metre:g}'
