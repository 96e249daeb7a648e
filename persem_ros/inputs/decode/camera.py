"""Camera infos to cameras: what every pixel looks at, spec section 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Camera, pinhole, same_aspect
from persem_ros.inputs.decode.messages import BadMessage

MODELS = ('plumb_bob', 'rational_polynomial', 'equidistant')
LENGTHS = (4, 5, 8, 12, 14)     # of OpenCV's distortion vectors
MAX_ERROR = 0.1             # pixels between a ray projected again and its pixel
FOLDED = 3.0                # pixels, on the undistorted image, between a point and its ray
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


def camera(
        info: Any, width: int, height: int, rectified: bool = False, frame_id: str = '') -> Camera:
    """
    Make the Camera of an image.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
        Of the sensor at full size; binning and region of interest are honoured.
    width, height : int
        Size of the image, pixels; K is scaled when the info's size is another one.
    rectified : bool
        True: P is used and D ignored. False: K and D.
    frame_id : str
        The optical frame; '' takes the info's.

    Returns
    -------
    Camera
        Its rays are NaN at pixels that the distortion model cannot reach.

    Raises
    ------
    BadMessage
        K (or P) with zeros or NaN, another aspect ratio, an unknown distortion model.

    """
    K = _scaled(_matrix(info, rectified), *_seen(info, width, height), width, height)
    frame_id = frame_id or info.header.frame_id.lstrip('/')
    D = _distortion(info, rectified)
    if not D.any():
        return pinhole(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], frame_id)
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
    rays = _undistorted(pixels, K, info.distortion_model, D)
    return Camera(rays.reshape(height, width, 2), K, frame_id)


def projection(
        info: Any, width: int, height: int, rectified: bool, view: Camera
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """
    Return the function of points (N, 3) in a camera's frame to its pixels (N, 2): column, row.

    NaN for points that are not in front of it, and for those that a distortion model far outside
    of what it was fitted to would fold into the image: there *view*'s rays do not meet them.

    """
    K, D, model = view.K, _distortion(info, rectified), info.distortion_model

    def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(divide='ignore', invalid='ignore'):
            rays = np.where(points[:, 2:] > 0.0, points[:, :2] / points[:, 2:], np.nan)
        if not D.any() or not len(points):
            return rays * (K[0, 0], K[1, 1]) + (K[0, 2], K[1, 2])
        known = np.isfinite(rays).all(1)
        pixels = np.full((len(points), 2), np.nan)
        if not known.any():
            return pixels
        ahead = rays[known].reshape(-1, 1, 2)
        if model == 'equidistant':
            found = cv2.fisheye.distortPoints(ahead, K, D)
        else:
            found = cv2.projectPoints(np.dstack([ahead, np.ones(ahead.shape[:2])]), np.zeros(3),
                                      np.zeros(3), K, D)[0]
        pixels[known] = found.reshape(-1, 2)
        inside = known & (pixels > -0.5).all(1) & (pixels < (width - 0.5, height - 0.5)).all(1)
        u, v = np.rint(pixels[inside]).astype(int).T
        off = np.abs(view.rays[v, u] - rays[inside]) * (K[0, 0], K[1, 1])
        pixels[np.flatnonzero(inside)[(off > FOLDED).any(1)]] = np.nan
        return pixels
    return project


def check(info: Any, rectified: bool = False) -> None:
    """Refuse (BadMessage) an info that no image could use, before any image has come."""
    _matrix(info, rectified)
    _distortion(info, rectified)


def content(info: Any) -> tuple[Any, ...]:
    """Return what makes a camera info differ from another, hashable; stamps do not."""
    roi = info.roi
    return (info.width, info.height, info.distortion_model, tuple(info.d), tuple(info.k),
            tuple(info.p), info.binning_x, info.binning_y,
            roi.x_offset, roi.y_offset, roi.width, roi.height, info.header.frame_id)


def _matrix(info: Any, rectified: bool) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of the whole sensor, refusing what cannot be a camera."""
    name = 'P' if rectified else 'K'
    m = np.asarray(info.p if rectified else info.k, float).reshape(3, -1)
    values = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
    if not (np.isfinite(values).all() and m[0, 0] > 0 and m[1, 1] > 0):
        shown = ', '.join(f'{x:g}' for x in values)
        raise BadMessage(f'camera info: bad {name}', f'a camera info has fx, fy, cx, cy = {shown} '
                         f'in {name}, expected finite numbers and focal lengths above 0; '
                         'calibrate the camera' + (' or --set camera.rectified=false'
                                                   if rectified else ''))
    return values


def _distortion(info: Any, rectified: bool) -> NDArray[np.float64]:
    """Return the distortion coefficients in force, refusing those of an unknown model."""
    D = np.zeros(1) if rectified else np.asarray(info.d, float)
    if not np.isfinite(D).all():
        raise BadMessage('camera info: D not finite', f'a camera info has the distortion '
                         f'{D.tolist()}, expected finite numbers')
    model = info.distortion_model
    if not D.any():
        return np.zeros(4)
    if model not in MODELS:
        raise BadMessage('camera info: unknown distortion model', 'a camera info has the '
                         f'distortion model {model!r}, expected one of '
                         f'{", ".join(MODELS)}, or --set camera.rectified=true for rectified '
                         'images')
    if model == 'equidistant' and D.size > 4 or D.size > LENGTHS[-1]:
        raise BadMessage('camera info: too many distortion coefficients', 'a camera info has '
                         f'{D.size} coefficients for the distortion model {model!r}')
    length = 4 if model == 'equidistant' else next(n for n in LENGTHS if n >= D.size)
    return np.append(D, np.zeros(length - D.size))


def _seen(info: Any, width: int, height: int) -> tuple[int, int, int, int]:
    """Return the part of the sensor that the image shows: x, y, width, height in its pixels."""
    roi = info.roi
    if roi.width and roi.height:
        part = roi.x_offset, roi.y_offset, roi.width, roi.height
    elif info.width and info.height:
        part = 0, 0, info.width, info.height
    else:
        return 0, 0, width, height      # drivers that leave the size out mean the image's
    binned = part[2] / max(info.binning_x, 1), part[3] / max(info.binning_y, 1)
    if not same_aspect(binned, (width, height)):
        raise BadMessage('camera info: another aspect ratio', f'a depth image has the size '
                         f'{width} x {height}, its camera info {binned[0]:g} x {binned[1]:g}, '
                         'expected one aspect ratio')
    return part


def _scaled(values: tuple[float, float, float, float], x: int, y: int, seen_width: int,
            seen_height: int, width: int, height: int) -> NDArray[np.float64]:
    """Return K for an image of *width* x *height* that shows the given part of the sensor."""
    fx, fy, cx, cy = values
    sx, sy = width / seen_width, height / seen_height
    return np.array([[sx * fx, 0.0, sx * (cx - x + 0.5) - 0.5],
                     [0.0, sy * fy, sy * (cy - y + 0.5) - 0.5],
                     [0.0, 0.0, 1.0]])


def _undistorted(pixels: Any, K: Any, model: Any, D: Any) -> Any:
    """Return the normalised rays (N, 2) of *pixels* (N, 1, 2); NaN where there is none."""
    if model == 'equidistant':
        rays = cv2.fisheye.undistortPoints(pixels, K, D, criteria=CRITERIA)
        again = cv2.fisheye.distortPoints(rays, K, D)
    else:
        rays = _iterated(pixels, K, D)
        points = np.dstack([rays, np.ones(rays.shape[:2])])
        again = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0]
    error = np.abs(again.reshape(-1, 2) - pixels[:, 0]).max(1)
    rays = rays.reshape(-1, 2)
    rays[~(error <= MAX_ERROR)] = np.nan
    return rays


def _iterated(pixels: Any, K: Any, D: Any) -> Any:
    """Undistort to convergence: OpenCV's default of 5 iterations is off by pixels at corners."""
    if hasattr(cv2, 'undistortPointsIter'):                 # OpenCV 4
        return cv2.undistortPointsIter(pixels, K, D, np.eye(3), np.eye(3), CRITERIA)
    return cv2.undistortPoints(pixels, K, D, R=np.eye(3), P=np.eye(3), criteria=CRITERIA)
