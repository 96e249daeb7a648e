"""Points to observations: what one frame says about each voxel (spec section 1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.pools import CENTRE
from persem_ros.errors import PersemError
from persem_ros.frames import IGNORED, MAX_ID, UNKNOWN

NOWHERE = np.int64(-1)      # key of a point without a place
STRIPE = 21 + 4             # bit of a key: 16 voxels along y
MIX = np.uint64(0x9E3779B97F4A7C15)     # Fibonacci hashing
REACH = 1 << 20             # farthest voxel from the sensor's own, along each axis
LIMIT = 2.0 ** 31 - 2.0 ** 21           # voxel indices are int32, with room for the reach
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
    if weights is not None:
        labels = np.where(weights > 0, labels, IGNORED)
    offsets = np.empty(np.size(points) // 3, np.int32)
    keys, base = place(points, T_map_sensor, voxel_size, origin, offsets)
    return gather(keys, base, labels, min_pixels, stamp, T_map_sensor, sensor, offsets,
                  weights=weights)


def gather(keys: NDArray[np.int64], base: NDArray[np.int64], labels: NDArray[np.int32],
           min_pixels: int, stamp: int, T_map_sensor: NDArray[np.float64], sensor: str,
           offsets: Any = None, T_body_sensor: Any = None, weights: Any = None) -> Observations:
    """
    Return the Observations of placed points; parameters as in observe() and place().

    With *weights*, uint32 (N,), of counted points above 0, in units of 2 ** -16, the vote is by
    their sums and the confidence is the winner's over the number of points (spec section 11).

    """
    if offsets is None or len(keys) > MOST_OFFSETS:
        offsets = np.empty(0, np.int32)
    weights = np.empty(0, np.uint32) if weights is None else \
        np.require(weights, np.uint32, ('C', 'W')).reshape(-1)
    labels = np.require(labels, np.int32, ('C', 'W')).reshape(-1)
    where = np.empty(len(keys), np.int32)
    halves: list[Half] = sum(split(_halves, 2, keys, base, labels, offsets, int(min_pixels), where,
                                   weights, grain=1), [])
    voxels, best, confidence, means = (np.concatenate(parts)
                                       for parts in list(zip(*halves))[:4])
    split(_join, len(where), len(halves[0][0]), where, grain=65536)
    return Observations(voxels, best, confidence, where,
                        np.flatnonzero(halves[0][4] | halves[1][4]).astype(np.uint16),
                        int(stamp), np.array(T_map_sensor, np.float64), sensor, means,
                        T_body_sensor)


def place(
        points: NDArray[np.float64], T_map_sensor: NDArray[np.float64], voxel_size: float,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0), offsets: Any = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """
    Return the voxel of each point as (keys, base); parameters as in observe().

    offsets (N,) int32, where it is given, receives each point's place in its voxel: 256ths of
    the edge along x, y and z, 8 bits each, x highest.

    Returns
    -------
    keys : ndarray, shape (N,), int64
        Voxel index minus base plus 2 ** 20 per axis, 21 bits each; NOWHERE for none.
    base : ndarray, shape (3,), int64
        The sensor's own voxel.

    """
    points = np.require(points, np.float64, ('C', 'W')).reshape(-1, 3)
    pose, base = placing(T_map_sensor, voxel_size, origin)
    keys = np.empty(len(points), np.int64)
    offsets = np.empty(0, np.int32) if offsets is None else offsets
    split(locate, len(points), points, pose, base, float(voxel_size), keys, offsets, grain=32768)
    return keys, base.astype(np.int64)


def placing(T_map_sensor: NDArray[np.float64], voxel_size: float,
            origin: tuple[float, float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return what key_of() needs: the pose as 9 + 3 numbers, and the sensor's own voxel, float64.

    Raises
    ------
    PersemError
        When the sensor is so far away that voxel indices would not fit 32 bits.

    """
    T = np.asarray(T_map_sensor, np.float64)
    pose = np.concatenate([T[:3, :3].ravel(), T[:3, 3] - np.asarray(origin, np.float64)])
    base = np.floor(pose[9:] / voxel_size)
    if not np.abs(base).max() < LIMIT:
        raise PersemError(
            f'position {T[:3, 3].tolist()} m is too far away for voxels of {voxel_size} m: '
            'expected finite coordinates near map.origin')
    return pose, base


@kernel
def locate(start, stop, points, pose, base, voxel_size, keys, offsets):
    """Write the key of each point's voxel, and its place there where offsets has room."""
    if len(offsets) == 0:
        for p in range(start, stop):
            keys[p] = key_of(points[p, 0], points[p, 1], points[p, 2], pose, base, voxel_size)[0]
    else:
        for p in range(start, stop):
            keys[p], offsets[p] = key_of(points[p, 0], points[p, 1], points[p, 2], pose, base,
                                         voxel_size)


@inlined
def key_of(x, y, z, pose, base, voxel_size):
    """
    Return the voxel of a point, floor((R p + t) / voxel_size) per axis (spec section 1).

    Three indices relative to the sensor's own voxel in one integer, 21 bits each; NOWHERE for a
    point without a place (NaN, or a million voxels away). Beside it the point's place in the
    voxel, three times 8 bits (see place()).

    """
    reach = np.float64(REACH)
    a = (pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) / voxel_size
    b = (pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) / voxel_size
    c = (pose[6] * x + pose[7] * y + pose[8] * z + pose[11]) / voxel_size
    low_a, low_b, low_c = np.floor(a), np.floor(b), np.floor(c)
    i, j, k = low_a - base[0], low_b - base[1], low_c - base[2]
    if abs(i) < reach and abs(j) < reach and abs(k) < reach:    # false for NaN
        key = (np.int64(i + reach) << 42) | (np.int64(j + reach) << 21) | np.int64(k + reach)
        # min: a hair below zero is, less its floor, 1.0
        offset = (np.int32(min((a - low_a) * 256.0, 255.0)) << 16) \
            | (np.int32(min((b - low_b) * 256.0, 255.0)) << 8) \
            | np.int32(min((c - low_c) * 256.0, 255.0))
        return key, np.int32(offset)
    return NOWHERE, np.int32(0)


# What is known of a voxel while a frame's points are counted: its place, its first id with the
# number of points, where the list of further ids begins, and the sums of the counted points'
# offsets. Two records to a cache line.
TALLY = np.dtype([('key', 'i8'), ('id', 'i4'), ('count', 'i4'), ('more', 'i4'), ('x', 'u4'),
                  ('y', 'u4'), ('z', 'u4')])
EXTRA = np.dtype([('id', 'i4'), ('count', 'i4'), ('more', 'i4')])
# The same where points have weights, whose sums are larger.
WEIGHED = np.dtype([(name, 'i8' if name == 'count' else kind) for name, kind, *_ in TALLY.descr])
WEIGHED_EXTRA = np.dtype([('id', 'i4'), ('count', 'i8'), ('more', 'i4')])
ONE = 1 << 16       # the weight of a label that is certain
# Voxels, ids, confidences, offsets, and which ids there are.
Half = tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.float32], NDArray[np.uint8],
             NDArray[np.uint8]]


def _halves(begin: int, end: int, *arguments: Any) -> list[Half]:
    """Return what group() returns for the halves begin .. end of the world."""
    keys, weights = arguments[0], arguments[-1]
    kinds = (WEIGHED, WEIGHED_EXTRA) if len(weights) else (TALLY, EXTRA)
    return [group(half, *arguments, *(np.empty(len(keys), kind) for kind in kinds))
            for half in range(begin, end)]


@kernel
def group(half, keys, base, labels, offsets, min_pixels, where, weights, tallies, extras):
    """
    Gather points by voxel and vote: the heart of observe().

    The world is cut into stripes 16 voxels wide, which belong to half 0 and half 1 in turn, so
    that two threads can work without a voxel in common. Half 0 writes the row of each of its
    points to where, and -1 for points without a place; half 1 writes -2 - row.

    A point in the voxel of its predecessor needs no look-up: three in five of an image's. (Asking
    the pixel above, too, saves more look-ups and is a third slower: branches mispredict.)

    """
    bits = np.uint64(64 - 10)       # of a hash, to be shifted out: the table has 2 ** 10 places
    while 6 << (64 - np.int64(bits)) < len(keys):
        bits -= np.uint64(1)
    table = np.zeros(1 << (64 - np.int64(bits)), np.int32)
    weighed = len(weights) > 0
    numbers = np.empty(len(weights), np.int32)      # of counted points
    seen = np.zeros(65536, np.uint8)
    n, n_extras, measured = 0, 0, len(offsets) > 0
    last, last_key = 0, NOWHERE
    for p in range(len(keys)):
        key = keys[p]
        if key == NOWHERE:
            if half == 0:
                where[p] = -1
            continue
        if key >> STRIPE & 1 != half:
            continue
        if key == last_key:
            g = last
        else:
            slot = np.int64((np.uint64(key) * MIX) >> bits)
            while table[slot] != 0 and tallies[table[slot] - 1].key != key:
                slot = (slot + 1) & (len(table) - 1)
            g = np.int64(table[slot]) - 1
            if g < 0:
                g = n
                n += 1
                table[slot] = n
                tallies[g].key = key
                tallies[g].id = -1
                tallies[g].count = 0
                tallies[g].more = -1
                tallies[g].x = tallies[g].y = tallies[g].z = 0
                if weighed:
                    numbers[g] = 0
                if 10 * n > 7 * len(table):
                    bits -= np.uint64(1)
                    table = _grown(table, bits, tallies, n)
            last, last_key = g, key
        where[p] = g if half == 0 else -2 - g
        c = labels[p]
        if not 0 <= c <= MAX_ID:
            continue
        weight = np.int64(1)
        if weighed:
            weight = np.int64(weights[p])
            numbers[g] += 1
        if measured:
            tallies[g].x += offsets[p] >> 16
            tallies[g].y += offsets[p] >> 8 & 255
            tallies[g].z += offsets[p] & 255
        if c == tallies[g].id:
            tallies[g].count += weight
        else:
            if tallies[g].id < 0:
                tallies[g].id = c
                tallies[g].count = weight
                seen[c] = 1
            elif _count_extra(tallies, extras, n_extras, g, c, weight):
                n_extras += 1
                seen[c] = 1
    voxels = np.empty((n, 3), np.int32)
    for g in range(n):
        key = tallies[g].key
        voxels[g, 0] = (key >> 42) - REACH + base[0]
        voxels[g, 1] = (key >> 21 & 0x1fffff) - REACH + base[1]
        voxels[g, 2] = (key & 0x1fffff) - REACH + base[2]
    best, confidence, means = _vote(np.int64(n), min_pixels, tallies, extras, measured, numbers)
    return voxels, best, confidence, means, seen


@inlined
def _count_extra(tallies, extras, n_extras, g, c, weight):
    """Count id c, not the first of voxel g; return whether it is new there."""
    e = np.int64(tallies[g].more)
    while e >= 0:
        if extras[e].id == c:
            extras[e].count += weight
            return False
        e = np.int64(extras[e].more)
    extras[n_extras].id = c
    extras[n_extras].count = weight
    extras[n_extras].more = tallies[g].more
    tallies[g].more = n_extras
    return True


@kernel
def _join(begin, end, first, where):
    """Give the rows of half 1 numbers after the *first* ones of half 0."""
    for p in range(begin, end):
        if where[p] < -1:
            where[p] = first - 2 - where[p]


@kernel
def _grown(table, bits, tallies, n):
    """Return a table twice as large that holds the first n tallies."""
    table = np.zeros(2 * len(table), np.int32)
    for g in range(n):
        slot = np.int64((np.uint64(tallies[g].key) * MIX) >> bits)
        while table[slot] != 0:
            slot = (slot + 1) & (len(table) - 1)
        table[slot] = g + 1
    return table


@kernel
def _vote(n, min_pixels, tallies, extras, measured, numbers):
    """
    Return each voxel's most frequent id (a tie: the smaller), its share, the mean offset.

    Where counts are sums of weights, *numbers* are those of the counted points; else it is empty.

    """
    best = np.full(n, UNKNOWN, np.uint16)
    confidence = np.zeros(n, np.float32)
    means = np.full((n, 3), CENTRE, np.uint8)
    for g in range(n):
        total = most = np.int64(tallies[g].count)
        label = np.int64(tallies[g].id)
        e = np.int64(tallies[g].more)
        while e >= 0:
            count, c = np.int64(extras[e].count), np.int64(extras[e].id)
            total += count
            if count > most or (count == most and c < label):
                most, label = count, c
            e = np.int64(extras[e].more)
        if len(numbers) > 0:
            total = np.int64(numbers[g])
        if total >= min_pixels and total > 0:
            best[g] = label
            share = most / total
            confidence[g] = np.float32(share / ONE if len(numbers) > 0 else share)
            if measured:    # rounded, not cut off: the mean of offsets that were cut off
                means[g, 0] = min(np.int64((tallies[g].x + 0.5 * total) / total), 255)
                means[g, 1] = min(np.int64((tallies[g].y + 0.5 * total) / total), 255)
                means[g, 2] = min(np.int64((tallies[g].z + 0.5 * total) / total), 255)
    return best, confidence, means
