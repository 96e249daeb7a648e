"""The nouns: a camera and a frame; shape, dtype, unit and coordinate frame of every array."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

IGNORED = -1        # a pixel without a label, wherever labels are int32
MAX_ID = 65534      # the largest class id
UNKNOWN = 65535     # "no label" where labels are uint16
ASPECT_TOLERANCE = 0.005    # sizes are whole pixels: 854 x 480 is 1920 x 1080


@dataclass(frozen=True, eq=False)
class Camera:
    """
    What a depth image's pixels look at.

    Attributes
    ----------
    rays : ndarray, shape (H, W, 2), float64
        The point that pixel (u, v) sees is (rays[v, u, 0] * d, rays[v, u, 1] * d, d) in the
        optical frame (x right, y down, z forward) for depth d. For a pinhole camera this is
        ((u - cx) / fx, (v - cy) / fy), spec section 1.
    K : ndarray, shape (3, 3), float64
        The pinhole matrix in force, pixels; for projecting, not for measuring.
    frame_id : str
        The optical frame.

    """

    rays: np.ndarray
    K: np.ndarray
    frame_id: str = ''

    @property
    def height(self) -> int:
        """Rows of the depth image."""
        return self.rays.shape[0]

    @property
    def width(self) -> int:
        """Columns of the depth image."""
        return self.rays.shape[1]


def pinhole(
        width: int, height: int, fx: float, fy: float, cx: float, cy: float, frame_id: str = ''
) -> Camera:
    """Return the Camera without distortion of *width* x *height* pixels."""
    rays = np.empty((height, width, 2))
    rays[..., 0] = ((np.arange(width) - cx) / fx)[None, :]
    rays[..., 1] = ((np.arange(height) - cy) / fy)[:, None]
    return Camera(rays, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), frame_id)


def same_aspect(size: tuple[float, float], other: tuple[float, float]) -> bool:
    """Return whether two sizes (width, height) have one aspect ratio, but for rounding."""
    (w, h), (w2, h2) = size, other
    return abs(w * h2 - w2 * h) <= max(ASPECT_TOLERANCE * w * h2, 0.5 * max(w, h, w2, h2))


@dataclass(frozen=True, eq=False)
class Matching:
    """
    Which pixels of a label image and of a depth image show the same place.

    Attributes
    ----------
    labels_of : ndarray, shape (h, w), int32
        For each depth pixel the label pixel, row by row from 0; -1 for none.
    depth_of : ndarray, shape (H, W), int32
        For each label pixel the depth pixel; -1 for none.

    """

    labels_of: NDArray[np.int32]
    depth_of: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Cloud:
    """
    The points of a labelled cloud as they came.

    Attributes
    ----------
    points : structured ndarray, shape (h, w)
        All fields of the message.
    field : str
        That with the label.

    """

    points: np.ndarray
    field: str

    def with_labels(self, labels: NDArray[np.int32]) -> np.ndarray:
        """Return the same points, little-endian, with other labels (h, w); the rest stays."""
        copy = self.points.astype(self.points.dtype.newbyteorder('<'))
        kind = copy.dtype[self.field]
        if kind.kind in 'iu':
            limits = np.iinfo(kind)
            labels = np.clip(labels, limits.min, limits.max)
        copy[self.field] = labels
        return copy


@dataclass(frozen=True, eq=False)
class Frame:
    """
    One label image with its depth and pose: what the pipeline eats.

    Attributes
    ----------
    stamp : int
        Nanoseconds, the label image's header stamp.
    labels : ndarray, shape (H, W), int32
        Class ids 0 .. 65534; anything else is an ignored pixel.
    depth : ndarray, shape (h, w), float64
        Metres along the optical axis; 0, NaN and infinity are "no measurement". The aspect
        ratio is that of the labels, the size may differ.
    camera : Camera
        Of the depth image, (h, w).
    T_map_camera : ndarray, shape (4, 4), float64
        Maps points of the camera's optical frame to the map frame (map.origin not yet taken
        off).
    sensor : str
        The camera's name, '' where there is only one.
    frame_id : str
        The label image's header frame.
    encoding : str
        The label image's encoding, which refined images keep.
    matching : Matching, optional
        Where label and depth image do not show the same rectangle (cropped, letterboxed, or of
        two cameras): which of their pixels belong together. None: both show all of it.
    weights : ndarray, shape (H, W), uint32, optional
        Confidence of each label in units of 2 ** -16, 0 .. 65536; None: all are certain.
    points : ndarray, shape (h, w, 3), float64, optional
        Metres in the sensor's frame, for a labelled cloud: depth is then the distance, and the
        camera's rays mean nothing. A cloud without rows has h = 1, and no flicker.
    cloud : Cloud, optional
        Where points and labels came from, which refined clouds keep.
    truth : ndarray, shape (H, W), int32, optional
        True ids on the labels' grid.
    color : ndarray, shape (., ., 3), uint8, optional
        RGB, any size.
    T_body_camera : ndarray, shape (4, 4), float64, optional
        The camera's mount: maps its points to the frame that the poses place; None: the poses
        place the camera itself.

    """

    stamp: int
    labels: np.ndarray
    depth: np.ndarray
    camera: Camera
    T_map_camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    sensor: str = ''
    frame_id: str = ''
    encoding: str = 'mono16'
    matching: Matching | None = None
    weights: np.ndarray | None = None
    points: np.ndarray | None = None
    cloud: Cloud | None = None
    truth: np.ndarray | None = None
    color: np.ndarray | None = None
    T_body_camera: np.ndarray | None = None

    @property
    def has_grid(self) -> bool:
        """Whether neighbours in the arrays are neighbours in space, as in every image."""
        return self.points is None or self.labels.shape[0] > 1
