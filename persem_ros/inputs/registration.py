"""Depth of another camera, or of a LiDAR, seen from the camera of the labels (spec section 11)."""

import math

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.core.transforms import transformed
from persem_ros.frames import Matching
from persem_ros.inputs.views import View

BEHIND = 0.03       # of its depth, by which a point may lie behind another of its pixel
FOCAL = 1e-6        # least focal length, pixels


def registered(depth: NDArray[np.float64], seen: View, labels: View,
               T_labels_depth: NDArray[np.float64]) -> Matching:
    """
    Return which pixels of a depth and of a label image of two cameras show one place.

    Every depth pixel is taken to the label camera; one that another hides there gets no label.

    Parameters
    ----------
    depth : ndarray, shape (h, w), float64
        Metres along the axis of the depth camera; 0, NaN and infinity are "no measurement".
    seen, labels : View
        The two cameras, of the images' sizes.
    T_labels_depth : ndarray, shape (4, 4)
        Maps points of the depth camera to the label camera.

    """
    d = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
    points = np.dstack([seen.camera.rays * d[..., None], d]).reshape(-1, 3)
    z, u, v = _projected(points, labels, T_labels_depth)
    ratio = labels.camera.K[0, 0] / max(seen.camera.K[0, 0], FOCAL)
    nearest, winner = _splat(z, u, v, math.ceil(ratio / 2), labels)
    places = _visible(z, u, v, nearest)
    return Matching(places.reshape(depth.shape), winner)


def depth_of_cloud(points: NDArray[np.float64], labels: View,
                   T_labels_cloud: NDArray[np.float64], splat: int) -> NDArray[np.float64]:
    """
    Return the depth image (H, W) that a cloud gives in the label camera, NaN where none.

    Parameters
    ----------
    points : ndarray, shape (N, 3), float64
        Metres in the cloud's frame; NaN for no measurement.
    labels : View
        The camera of the labels.
    T_labels_cloud : ndarray, shape (4, 4)
        Maps points of the cloud to the label camera.
    splat : int
        Width, pixels, of the square with which a point hides what is behind it.

    """
    z, u, v = _projected(points, labels, T_labels_cloud)
    nearest, _ = _splat(z, u, v, splat // 2, labels)
    places = _visible(z, u, v, nearest)
    depth = np.full(labels.camera.rays.shape[:2], np.inf)
    np.minimum.at(depth.reshape(-1), places[places >= 0], z[places >= 0])
    depth[np.isinf(depth)] = np.nan
    return depth


def _projected(points: NDArray[np.float64], labels: View, T: NDArray[np.float64]) -> tuple[
        NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return depth and pixel (column, row) of points in the label camera; -1 outside of it."""
    moved = transformed(points, T)
    pixels = labels.project(moved)
    height, width = labels.camera.rays.shape[:2]
    with np.errstate(invalid='ignore'):
        inside = (pixels > -0.5).all(1) & (pixels[:, 0] < width - 0.5) \
            & (pixels[:, 1] < height - 0.5) & (moved[:, 2] > 0.0)
    u, v = (np.rint(np.where(inside, axis, -1.0)).astype(np.int64) for axis in pixels.T)
    return moved[:, 2], u, v


def _splat(z: NDArray[np.float64], u: NDArray[np.int64], v: NDArray[np.int64], half: int,
           labels: View) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the least depth (H, W) of squares around points, and whose it is, -1 for none."""
    shape = labels.camera.rays.shape[:2]
    nearest, winner = np.full(shape, np.inf), np.full(shape, -1, np.int32)
    _draw(z, u, v, half, nearest, winner)
    return nearest, winner


@cached
def _draw(z, u, v, half, nearest, winner):
    """Draw squares into a depth buffer."""
    height, width = nearest.shape
    for p in range(len(z)):
        if u[p] < 0:
            continue
        for row in range(max(v[p] - half, 0), min(v[p] + half + 1, height)):
            for column in range(max(u[p] - half, 0), min(u[p] + half + 1, width)):
                if z[p] < nearest[row, column]:
                    nearest[row, column] = z[p]
                    winner[row, column] = p


@cached
def _visible(z, u, v, nearest):
    """Return the pixel of each point, row by row; -1 for one that is hidden or outside."""
    places = np.full(len(z), -1, np.int32)
    for p in range(len(z)):
        if u[p] >= 0 and z[p] <= (1.0 + BEHIND) * nearest[v[p], u[p]]:
            places[p] = v[p] * nearest.shape[1] + u[p]
    return places
