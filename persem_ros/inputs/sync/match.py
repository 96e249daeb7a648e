"""A label image and its partners: kinds of images, an image not decoded, a match of several."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LABELS, DEPTH, TRUTH, COLOR = 'labels', 'depth', 'truth', 'color'
CONFIDENCE, DEPTH_CONFIDENCE = 'confidence', 'depth_confidence'


class Raw(NamedTuple):
    """An image that has not been decoded: most of those without a partner never are."""

    msgtype: str
    data: bytes
    frame_id: str
    stamp: int = 0      # ns
    tables: int = 0     # of class names without a stamp, that had come before it


@dataclass(eq=False)
class Match:
    """
    A label image and what belongs to it.

    Attributes
    ----------
    stamp : int
        The label image's, nanoseconds.
    items : dict
        What was pushed, by kind; a companion that is missing has no entry.
    T_map_camera : ndarray, shape (4, 4), float64
        The pose, None where no poses are asked for.
    T_body_camera : ndarray, shape (4, 4), float64, or None
        The camera's mount, where it is known (inputs.sync.track.Lookup).
    T_labels_depth : ndarray, shape (4, 4), float64, or None
        Maps points of the depth camera, or of the LiDAR, at their stamp to the labels' at theirs;
        None where both are the same.

    """

    stamp: int
    items: dict[str, Raw]
    T_map_camera: NDArray[np.float64] | None = None
    arrival: int = 0
    complete: float | None = None       # when the depth image was found
    size: int = 0
    missing: set[str] = field(default_factory=set)
    ready: int | None = None            # when nothing of it was missing any more
    T_body_camera: NDArray[np.float64] | None = None
    T_labels_depth: NDArray[np.float64] | None = None
