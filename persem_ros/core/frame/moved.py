"""One frame's observations from another pose: as core.memory.move moves those in a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.observe import Observations
from persem_ros.core.memory.move import regrouped, turns_of
from persem_ros.core.memory.pools import CENTRE
from persem_ros.frames import UNKNOWN


def moved(seen: Observations, best: NDArray[np.float64], voxel_size: float,
          origin: tuple[float, ...]) -> Observations:
    """
    Return what a frame observed, from the pose *best* (4, 4) in place of its own.

    Where no observation leaves its voxel, the Observations themselves. Rows of pixels (where)
    are lost.

    """
    counted = seen.labels != UNKNOWN
    n = int(np.count_nonzero(counted))
    offsets = np.full((n, 3), CENTRE, np.uint8) if seen.offsets is None else seen.offsets[counted]
    new = regrouped(
        np.ascontiguousarray(seen.voxels[counted]), np.ones(n, np.int64),
        np.zeros(n, np.uint8), seen.labels[counted], seen.confidences[counted],
        np.zeros(n, np.int32), offsets, turns_of(seen.T_map_sensor[None], best[None], origin),
        np.ones(1, bool), voxel_size)
    if not new.leaves[0]:
        return seen
    return replace(seen, voxels=new.voxels, labels=new.labels, confidences=new.confidences,
                   where=np.empty(0, np.int32), T_map_sensor=best, offsets=new.offsets)
