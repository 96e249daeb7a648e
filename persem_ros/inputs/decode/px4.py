"""px4_msgs/VehicleOdometry: north-east-down and forward-right-down to ROS's axes."""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import transform

TYPE = 'px4_msgs/msg/VehicleOdometry'
BODY = 'base_link'          # what REP 105 calls what these poses place
HEAD = 28 + 24              # bytes up to the end of q, encapsulation included
LONG = 200                  # bytes: messages before PX4 1.14 carry two covariance matrices
LATEST = 2**31 * 10**9      # ns: a header's seconds are int32
SAME = 10**6                # µs that the sample is older than the message, at most
# Frames of the position by their number: up to 1.13 and since.
BEFORE, SINCE = {0: 'ned', 1: 'frd'}, {1: 'ned', 2: 'frd'}
WORLDS = {'ned': np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),        # to east, north, up
          'frd': np.diag([1.0, -1.0, -1.0])}                            # to forward, left, up
FLU = np.diag([1.0, -1.0, -1.0])    # points of the body: forward, left, up to …, right, down


class VehicleOdometry(NamedTuple):
    """The pose of such a message, whatever its version; `frame` is a key of WORLDS or ''."""

    timestamp: int              # µs
    timestamp_sample: int       # µs
    frame: str
    position: tuple[float, ...]
    q: tuple[float, ...]        # w x y z


def stamp_of(head: bytes) -> int | None:
    """Return the stamp in the first bytes of a serialized message, ns; None where it ends."""
    if len(head) < 20:
        return None
    stamp = _stamp(*struct.unpack_from(f'{"<" if head[1] & 1 else ">"}QQ', head, 4))
    return stamp if stamp < LATEST else None


def decoded(data: bytes | memoryview) -> VehicleOdometry:
    """
    Return what a serialized message holds; all versions begin alike.

    Raises
    ------
    ValueError
        Where it ends too early.

    """
    if len(data) < HEAD:
        raise ValueError(f'{len(data)} bytes are too few')
    order = '<' if data[1] & 1 else '>'
    now, sample, frame, *numbers = struct.unpack_from(f'{order}QQB3x7f', data, 4)
    frames = BEFORE if len(data) > LONG else SINCE
    return VehicleOdometry(now, sample, frames.get(frame, ''), tuple(numbers[:3]),
                           tuple(numbers[3:]))


def pose(msg: VehicleOdometry) -> tuple[int, NDArray[np.float64], str, str]:
    """
    Read a pose.

    Returns
    -------
    stamp : int
        Nanoseconds, of the measurement where the message says it.
    T : ndarray, shape (4, 4), float64
        Maps points of the body (x forward, y left, z up) to the map (east, north, up; x ahead at
        the start where the estimator knows no north).
    parent, child : str
        '' (whatever the map is called) and BODY.

    Raises
    ------
    ValueError
        (reason, sentence): without an estimate (NaN), or in no frame that is known.

    """
    w, x, y, z = msg.q
    xyz, norm = np.array(msg.position), math.hypot(*msg.q)
    if msg.frame not in WORLDS:
        raise ValueError('no known frame', f'a {TYPE} has a position in no frame that is known, '
                         'expected NED or FRD')
    if not np.isfinite(xyz).all() or not abs(norm - 1) < 1e-2:
        raise ValueError('no estimate', f'a {TYPE} has the position {xyz.tolist()} and the '
                         f'quaternion {[w, x, y, z]}: the estimator has none, yet')
    stamp = _stamp(msg.timestamp, msg.timestamp_sample)
    if stamp >= LATEST:
        raise ValueError('no time', f'a {TYPE} is of {msg.timestamp} µs, more than stamps can be')
    T = transform(xyz, np.array([x, y, z, w]) / norm)
    T[:3] = WORLDS[msg.frame] @ T[:3]
    T[:3, :3] = T[:3, :3] @ FLU
    return stamp, T, '', BODY


def _stamp(now: int, sample: int) -> int:
    """Return the time of the measurement, ns; that of the message where the other is none."""
    return 1000 * (sample if 0 <= now - sample <= SAME else now)
