"""Depth images from LiDAR scans."""

from __future__ import annotations

from pathlib import Path
import re

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.images import read_npy
from persem_ros.errors import PersemError

NAME = re.compile(r'image(\d+\.\d+)_lidar(\d+\.\d+)\.(?:txt|npy)')
NEAREST = 0.05      # metres: what is nearer is the vehicle itself


def scans_of(folder: Path) -> dict[str, Path]:
    """Return {image stamp as text: path} of the scans in a folder, in order of stamps."""
    found = {}
    for path in sorted(Path(folder).iterdir()):
        match = NAME.fullmatch(path.name)
        if match:
            found[match[1]] = path
    return found


def read_scan(path: Path) -> NDArray[np.float64]:
    """
    Return the points of a scan, shape (N, 3), float64, metres, LiDAR frame.

    Raises
    ------
    PersemError
        When the file is not lines of at least three numbers.

    """
    try:
        if path.suffix == '.npy':
            points = read_npy(path)
        elif path.stat().st_size == 0:
            return np.empty((0, 3))
        else:
            points = np.loadtxt(path, ndmin=2)
        if points.ndim != 2 or points.shape[1] < 3:
            raise ValueError(f'shape {points.shape}')
        points = points[:, :3].astype(np.float64)
    except OSError as error:
        raise PersemError(f'{path}: cannot be read: {error.strerror or error}') from error
    except (ValueError, EOFError) as error:
        raise PersemError(f'{path}: expected lines of "x y z": {error}') from None
    return points[np.isfinite(points).all(axis=1)]


def depth_of_points(
        points: NDArray[np.float64], K: NDArray[np.float64],
        D: NDArray[np.float64] | tuple[float, ...], size: tuple[int, int]) -> NDArray[np.float32]:
    """
    Return the depth image of a point cloud; the nearest point of a pixel counts.

    Parameters
    ----------
    points : ndarray, shape (N, 3), float64
        In the optical frame, metres.
    K : ndarray, shape (3, 3)
        Pinhole matrix of the image.
    D : sequence of float
        Distortion k1 k2 p1 p2 k3, empty for none.
    size : tuple of int
        (width, height).

    Returns
    -------
    ndarray, shape (height, width), float32
        z in metres, 0 where no point falls.

    """
    width, height = size
    points = points[points[:, 2] > NEAREST]
    uv = points[:, :2] / points[:, 2:] * [K[0, 0], K[1, 1]] + K[:2, 2]
    if len(D) and np.any(D) and len(points):
        # Far outside the image the distortion folds back into it: keep to its surroundings.
        near = (np.abs(uv - [width / 2, height / 2]) < [width, height]).all(axis=1)
        points = points[near]
        uv = cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K,
                               np.asarray(D, float))[0].reshape(-1, 2) if near.any() \
            else np.empty((0, 2))
    u, v = np.rint(uv).astype(np.int64).T if len(uv) else np.empty((2, 0), np.int64)
    seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    depth = np.full(width * height, np.inf, np.float32)
    np.minimum.at(depth, v[seen] * width + u[seen], points[seen, 2].astype(np.float32))
    depth[np.isinf(depth)] = 0
    return depth.reshape(height, width)
