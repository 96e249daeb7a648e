"""The camera infos of one camera in time, and what its images of any size look at."""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Camera
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.camera import camera, check, content, projection
from persem_ros.inputs.decode.messages import BadMessage

CAMERAS_KEPT = 8        # a zoom lens must not fill the memory
CHANGES_KEPT = 64


class View(NamedTuple):
    """
    What the pixels of an image look at, and where points are in it.

    Attributes
    ----------
    camera : Camera
        Rays of (H, W) pixels, 0 where a pixel is blind.
    blind : ndarray, shape (H, W), bool, or None
        Pixels that the distortion model cannot reach.
    lengths : ndarray, shape (H, W), float64
        Of the rays with z = 1.
    project : callable
        project(points (N, 3)) gives their pixels (N, 2): column, row; NaN behind the camera.

    """

    camera: Camera
    blind: NDArray[np.bool_] | None
    lengths: NDArray[np.float64]
    project: Callable[[NDArray[np.float64]], NDArray[np.float64]]


class Views:
    """
    The infos of one camera.

    Parameters
    ----------
    rectified : bool
        The setting camera.rectified.

    """

    def __init__(self, rectified: bool) -> None:
        """Start without an info."""
        # (stamp, content, info) at changes.
        self._infos: deque[tuple[int, tuple[Any, ...], Any]] = deque(maxlen=CHANGES_KEPT)
        self._rectified = rectified
        self._views: dict[tuple[tuple[Any, ...], int, int, str], View] = {}

    @property
    def frame_id(self) -> str | None:
        """Return the frame of the first info, None before it has come."""
        return messages.frame_id(self._infos[0][2]) if self._infos else None

    def add(self, info: Any) -> None:
        """Use *info* for images from its stamp on; refuse (BadMessage) an unusable one."""
        key = content(info)
        if self._infos and self._infos[-1][1] == key:
            return
        check(info, self._rectified)
        self._infos.append((messages.stamp_ns(info), key, info))

    def of(self, msg: Any, width: int, height: int) -> View:
        """Return the View of an image message of a size; BadMessage without an info."""
        if not self._infos:
            raise BadMessage('no camera info', 'no camera info came before the first frame')
        stamp = messages.stamp_ns(msg)
        _, content_key, info = next((entry for entry in reversed(self._infos)
                                     if entry[0] <= stamp), self._infos[0])
        frame_id = messages.frame_id(msg)
        key = content_key, width, height, frame_id
        if key not in self._views:
            if len(self._views) >= CAMERAS_KEPT:
                self._views.pop(next(iter(self._views)))
            view = camera(info, width, height, self._rectified, frame_id)
            blind = np.isnan(view.rays[..., 0])
            view.rays[blind] = 0.0
            self._views[key] = View(
                view, blind if blind.any() else None,
                np.sqrt(1.0 + (view.rays ** 2).sum(-1)),
                projection(info, width, height, self._rectified, view))
        return self._views[key]
