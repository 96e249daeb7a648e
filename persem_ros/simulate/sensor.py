"""A depth camera's and a pose estimate's errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate import materials as mat
from persem_ros.simulate.path import gusts, rotation
from persem_ros.simulate.segmenter import picture_noise

if TYPE_CHECKING:
    from persem_ros.simulate.render import View


@dataclass(frozen=True)
class DepthErrors:
    """
    How measured depth differs from the true one.

    Attributes
    ----------
    scale : float
        Factor on everything; 0: exact and without holes.
    floor, square : float
        The noise's standard deviation is floor + square * depth**2, metres; half of its
        variance is white, half smooth over the picture, as a matcher's is.
    edge : float
        Share of pixels lost beside a depth edge.
    water : float
        Share of pixels lost on water.
    patches : float
        Share of pixels lost in patches anywhere.
    max_range : float
        Farther than that nothing is measured, metres.

    """

    scale: float = 1.0
    floor: float = 0.02
    square: float = 1.2e-5
    edge: float = 0.6
    water: float = 0.35
    patches: float = 0.012
    max_range: float = 180.0


def measured(view: View, errors: DepthErrors, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the depth image, shape (H, W), float32, metres, NaN without measurement."""
    depth = view.depth.astype(np.float32)
    height, width = depth.shape
    lost = ~(depth <= errors.max_range)
    if errors.scale > 0:
        smooth = picture_noise(rng, height, width, 0.02)
        white = rng.standard_normal((height, width), np.float32)
        known = np.where(lost, np.float32(errors.max_range), depth)
        sigma = np.float32(errors.scale) * (errors.floor + errors.square * known ** 2)
        luck = rng.random((height, width), np.float32)
        patch = picture_noise(rng, height, width, 0.015)
        lost |= edges(known) & (luck < errors.edge * min(errors.scale, 1.5))
        lost |= (view.labels == mat.WATER) & (luck < errors.water * errors.scale) & (patch > -.8)
        lost |= patch > 2.26 - 0.25 * (errors.scale - 1)    # the normal tail of 1.2 %
        depth = depth + sigma * np.sqrt(np.float32(0.5)) * (smooth + white)
    depth[lost] = np.nan
    return depth


def edges(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where depth jumps between neighbouring pixels, widened by one, bool (H, W)."""
    kernel = np.ones((3, 3), np.uint8)
    return cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 0.03 * depth


@dataclass(frozen=True)
class PoseErrors:
    """
    How recorded poses of the body differ from the true ones.

    Attributes
    ----------
    noise : float
        Standard deviation of white noise on each coordinate, metres.
    attitude : float
        Standard deviation of white noise on roll, pitch and yaw, degrees.
    drift : float
        Standard deviation of a slow wander on each coordinate, metres, after 100 m of flight;
        it grows with the root of the way.
    odometry: float = 0.0
        Factor on the drift of a dead reckoning: of heading 1 degree, of length 0.4 % and of height
        0.3 m after 100 m of flight, more or less so on the way. It is smooth, and begins with
        the true pose.

    """

    noise: float = 0.0
    attitude: float = 0.0
    drift: float = 0.0
    odometry: float = 0.0


def recorded(
        poses: list[NDArray[np.float64]], errors: PoseErrors, rng: np.random.Generator
) -> list[NDArray[np.float64]]:
    """Return the list of T_map_body *poses*, in order of time, with *errors* added."""
    n = len(poses)
    T = np.stack(poses)
    if errors.odometry:
        T = dead_reckoned(T, errors.odometry, np.random.default_rng(rng.integers(2 ** 32)))
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))])
    steps = rng.standard_normal((n, 3)) * np.sqrt(np.diff(way, prepend=0.0) / 100)[:, None]
    shift = errors.drift * np.cumsum(steps, axis=0)
    shift += errors.noise * rng.standard_normal((n, 3))
    angles = np.radians(errors.attitude) * rng.standard_normal((n, 3))
    for i in range(n):
        T[i, :3, 3] += shift[i]
        if errors.attitude:
            T[i, :3, :3] = T[i, :3, :3] @ rotation(*angles[i])
    return list(T)


def dead_reckoned(
        T: NDArray[np.float64], scale: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return poses (n, 4, 4) that are added up from steps with smooth errors."""
    steps = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    way = np.cumsum(steps)
    turn, length, climb = (
        scale * rate * rng.choice((-1, 1)) * (1 + gusts(rng, way, 0.6, (90.0, 230.0)))
        for rate in (np.radians(1.0) / 100, 0.004, 0.003))
    heading = np.cumsum(turn * steps)
    cos, sin = np.cos(heading), np.sin(heading)
    move = np.diff(T[:, :3, 3], axis=0) * (1 + length)[:, None]
    turned = np.stack([cos * move[:, 0] - sin * move[:, 1], sin * move[:, 0] + cos * move[:, 1],
                       move[:, 2] + climb * steps], axis=1)
    drifted = T.copy()
    drifted[1:, :3, 3] = T[0, :3, 3] + np.cumsum(turned, axis=0)
    for i in range(1, len(T)):
        drifted[i, :3, :3] = rotation(0.0, 0.0, heading[i - 1]) @ T[i, :3, :3]
    return drifted
