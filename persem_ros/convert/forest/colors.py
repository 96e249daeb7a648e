"""Label images that are coded by colour."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.settings.legend import Legend

UNLABELLED = 255


def ids_of_colors(rgb: NDArray[np.uint8], legend: Legend, where: Path) -> NDArray[np.uint8]:
    """
    Return the ids of a label image in the legend's colours.

    Parameters
    ----------
    rgb : ndarray, shape (H, W, 3), uint8
        The image.
    legend : Legend
        Ids and colours.
    where : str or Path
        For messages.

    Returns
    -------
    ndarray, shape (H, W), uint8
        255 for colours that the legend does not have; a tenth of such pixels is refused.

    """
    key = rgb[..., 0].astype(np.int32) << 16 | rgb[..., 1].astype(np.int32) << 8 | rgb[..., 2]
    table = {r << 16 | g << 8 | b: c.id for c in reversed(legend.classes) if c.id < UNLABELLED
             for r, g, b in [c.color]}
    values, places = np.unique(key, return_inverse=True)
    found = np.array([table.get(int(v), UNLABELLED) for v in values], np.uint8)
    ids = found[places.reshape(key.shape)]
    strange = np.count_nonzero(ids == UNLABELLED)
    if 10 * strange > ids.size:
        worst = max((v for v, c in zip(values, found) if c == UNLABELLED),
                    key=lambda v: np.count_nonzero(key == v))
        raise PersemError(f'{where}: {100 * strange / ids.size:.0f} % of the pixels have colours '
                          f'that the legend does not have, most of them ({worst >> 16}, '
                          f'{worst >> 8 & 255}, {worst & 255}); give another with --legend')
    return ids
