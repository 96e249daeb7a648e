"""Points to observations: what one frame says about each voxel (spec section 1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.place import Measured, measured_points, placing
from persem_ros.core.frame.tally import (
    EXTRA, merge, renumber, TALLY, tally, vote, WEIGHED, WEIGHED_EXTRA)
from persem_ros.core.jit import split
from persem_ros.frames import MAX_ID

GRAIN = 16384           # points that are worth a thread
EVERY = np.arange(MAX_ID + 1, dtype=np.int32)
MOST_OFFSETS = 1 << 24  # points of a frame; the sums of more offsets might not fit 32 bits


@dataclass(frozen=True, eq=False)
class Observations:
    """
    What one frame says: at most one observation of each voxel.

    Attributes
    ----------
    voxels : ndarray, shape (n, 3), int32
        Indices of the voxels that the points fall into, in order of first appearance.
    labels : ndarray, shape (n,), uint16
        The most frequent id there; UNKNOWN (65535) where no counted point makes it an
        observation.
    confidences : ndarray, shape (n,), float32
        Share of that id among the counted points.
    where : ndarray, shape (N,), int32
        Row in voxels of each point, -1 for a point without a place.
    ids : ndarray, shape (k,), uint16
        The distinct ids of all counted points.
    stamp : int
        Nanoseconds.
    T_map_sensor : ndarray, shape (4, 4), float64
    sensor : str
    offsets : ndarray, shape (n, 3), uint8, optional
        Mean place of the counted points in the voxel, in 256ths of its edge from its lowest
        corner; None: not known, taken for the middle.
    T_body_sensor : ndarray, shape (4, 4), float64, optional
        The sensor's mount on what the pose topic places; None: the sensor itself is placed.

    """

    voxels: NDArray[np.int32]
    labels: NDArray[np.uint16]
    confidences: NDArray[np.float32]
    where: NDArray[np.int32]
    ids: NDArray[np.uint16]
    stamp: int
    T_map_sensor: NDArray[np.float64]
    sensor: str
    offsets: NDArray[np.uint8] | None = None
    T_body_sensor: NDArray[np.float64] | None = None


def observe(points: NDArray[np.float64], labels: NDArray[np.int32],
            T_map_sensor: NDArray[np.float64], voxel_size: float, min_pixels: int = 1,
            origin: tuple[float, float, float] = (0.0, 0.0, 0.0), stamp: int = 0, sensor: str = '',
            weights: Any = None) -> Observations:
    """
    Return the Observations of one frame.

    Parameters
    ----------
    points : ndarray, shape (N, 3), float64
        Metres in the sensor frame; NaN or infinity: no measurement. A point a million voxels
        (REACH) away from the sensor has no place either.
    labels : ndarray, shape (N,), int32
        Class ids; below 0 or above 65534: the point is placed but not counted.
    T_map_sensor : ndarray, shape (4, 4), float64
        Maps sensor points to the map.
    voxel_size : float
        Metres.
    min_pixels : int
        Counted points that make an observation.
    origin : sequence of 3 floats
        Subtracted from all positions, metres.
    stamp : int
        Nanoseconds.
    sensor : str
        Name of the sensor.
    weights : ndarray, shape (N,), uint32, optional
        Confidence of each label in units of 2 ** -16; a label with 0 does not count.

    """
    return gather(measured_points(points), labels, EVERY, T_map_sensor, voxel_size, min_pixels,
                  origin, stamp, sensor, weights=weights)


def gather(
        measured: Measured, labels: NDArray[np.int32], counting: NDArray[np.int32],
        T_map_sensor: NDArray[np.float64], voxel_size: float, min_pixels: int = 1,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0), stamp: int = 0, sensor: str = '',
        T_body_sensor: Any = None, weights: Any = None) -> Observations:
    """
    Return the Observations of what a sensor measured; further parameters as in observe().

    counting (65535,) int32 says what each id is counted as, -1: not at all. With *weights* the
    vote is by their sums and the confidence is the winner's over the number of counted points
    (spec section 11).

    The points are cut in as many parts as there are threads, each of which counts one on its own;
    what the parts counted is then added up.

    """
    n = measured.size
    labels = np.require(labels, np.int32, ('C', 'W')).reshape(-1)
    weights = np.empty(0, np.uint32) if weights is None else \
        np.require(weights, np.uint32, ('C', 'W')).reshape(-1)
    pose, base = placing(T_map_sensor, voxel_size, origin)
    where = np.empty(n, np.int32)
    parts: list[Part] = sum(split(_part, n, *measured, pose, base, float(voxel_size), labels,
                                  counting, weights, where, grain=GRAIN), [])
    whole = parts[0] if parts else _part(0, 0, *measured, pose, base, float(voxel_size), labels,
                                         counting, weights, where)[0]
    merged = [(part, whole.add(part)) for part in parts[1:]]
    n, slices = whole.n, max(1, len(parts))
    voxels, best = np.empty((n, 3), np.int32), np.empty(n, np.uint16)
    confidence, means = np.empty(n, np.float32), np.empty((n, 3), np.uint8)
    split(_finish, slices, slices, merged, where, n, whole.tallies, whole.extras, whole.numbers,
          base.astype(np.int64), int(min_pixels), len(where) <= MOST_OFFSETS, voxels, best,
          confidence, means, grain=1)
    return Observations(voxels, best, confidence, where,
                        np.flatnonzero(whole.seen.view(bool)).astype(np.uint16), int(stamp),
                        np.array(T_map_sensor, np.float64), sensor, means, T_body_sensor)


class Part:
    """What was counted of the points begin .. end."""

    def __init__(self, begin: int, end: int, *arguments: Any) -> None:
        """Count them; the first part has room for all."""
        *placed, labels, counting, weights, where = arguments
        self.begin, self.end = begin, end
        room = end - begin if begin else len(where)
        self.numbers = np.empty(room + 1 if len(weights) else 0, np.int32)
        kinds = (WEIGHED, WEIGHED_EXTRA) if len(weights) else (TALLY, EXTRA)
        self.tallies, self.extras = np.empty(room + 1, kinds[0]), np.empty(room, kinds[1])
        self.n, self.n_extras, self.cubes, self.seen = tally(
            begin, end, *placed, labels, counting, weights, where, self.tallies, self.extras,
            self.numbers)

    def add(self, other: Part) -> NDArray[np.int32]:
        """Add what was counted of later points; return the row of each of their voxels."""
        rows: NDArray[np.int32]
        self.n, self.n_extras, self.cubes, rows = merge(
            self.tallies, self.extras, self.numbers, self.n, self.n_extras, self.cubes,
            other.tallies[:other.n], other.extras, other.numbers)
        self.seen |= other.seen
        return rows


def _part(begin: int, end: int, *arguments: Any) -> list[Part]:
    """Return what was counted of some points, for split()."""
    return [Part(begin, end, *arguments)]


def _finish(begin: int, end: int, slices: int, merged: list[tuple[Part, NDArray[np.int32]]],
            where: NDArray[np.int32], n: int, *arguments: Any) -> None:
    """Say the rows as they are now of points that were merged, and vote: slices begin .. end."""
    for part, rows in merged:
        size = part.end - part.begin
        renumber(part.begin + size * begin // slices, part.begin + size * end // slices, rows,
                 where)
    vote(n * begin // slices, n * end // slices, *arguments)
