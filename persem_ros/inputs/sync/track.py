"""The samples of one transform over time: interpolated, held, never extrapolated."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
import copy
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import matrix_to_quaternion, slerp, transform

NO_POSE = 'no pose'
POSE_GAP = 'pose gap'
POSE_JUMP = 'pose jumps'
POSE_WILD = 'pose is off by itself'
TRIM_EVERY = 256        # samples between two looks at the age of the oldest
SLACK = 0.1             # m that two samples may differ whatever the time between them: noise


class Lookup(NamedTuple):
    """
    The answer to "where was the camera?".

    Attributes
    ----------
    T : ndarray, shape (4, 4), float64, or None
        T_map_camera, None where it is not known.
    final : bool
        False: what is missing may still arrive.
    reason : str
        Why there is no pose, '' where there is one; the key of a drop count.
    mount : ndarray, shape (4, 4), float64, or None
        T_body_camera, where the poses place a body and not the camera.

    """

    T: NDArray[np.float64] | None
    final: bool = True
    reason: str = ''
    mount: NDArray[np.float64] | None = None


class Track:
    """
    The samples of one transform in stamp order.

    Attributes
    ----------
    parent : str
        The frame that the samples are in.
    stamps : list of int
        Nanoseconds, ascending.
    transforms : list of ndarray, shape (4, 4), float64
        T_parent_child.
    latest : int
        The stamp that arrived last, not the largest.

    """

    def __init__(self, parent: str, keep_ns: int) -> None:
        """Start an empty track below *parent* that spans about *keep_ns*."""
        self.parent = parent
        self.stamps: list[int] = []
        self.transforms: list[NDArray[np.float64]] = []
        self._keep = keep_ns
        self.latest: int | None = None
        self._added = 0

    def add(self, stamp: int, T: NDArray[np.float64]) -> bool:
        """Insert a sample; return False where that stamp is there already."""
        i = bisect_left(self.stamps, stamp)
        self.latest = stamp
        if i < len(self.stamps) and self.stamps[i] == stamp:
            return False
        self.stamps.insert(i, stamp)
        self.transforms.insert(i, T)
        self._added += 1
        if self._added % TRIM_EVERY == 0:
            # Against the median: one stamp that is hours ahead must not empty the buffer.
            self.forget(self.stamps[len(self.stamps) // 2] - self._keep)
        return True

    def copy(self) -> Track:
        """Return one with the same samples, which goes its own way from here on."""
        other = copy.copy(self)
        other.stamps, other.transforms = self.stamps.copy(), self.transforms.copy()
        return other

    def forget(self, stamp: int) -> None:
        """Drop samples before *stamp*, but for the last of them."""
        i = bisect_left(self.stamps, stamp) - 1
        if i > 0:
            del self.stamps[:i], self.transforms[:i]

    def at(self, stamp: int, max_gap: int, max_speed: float = math.inf) -> Lookup:
        """
        Return the Lookup of this transform at *stamp*.

        Parameters
        ----------
        stamp : int
            Nanoseconds.
        max_gap : int
            Nanoseconds between two samples that are interpolated across, at most.
        max_speed : float
            Metres per second between two such samples, at most. A sample that is too fast from
            the one before and to the one behind, while these two go together, is a mistake: it
            is no answer for its own stamp either.

        """
        stamps = self.stamps
        i = bisect_left(stamps, stamp)
        if i < len(stamps) and stamps[i] == stamp:
            return self._exact(i, max_speed)
        if i == len(stamps):
            return Lookup(None, False, NO_POSE)
        assert self.latest is not None
        passed = self.latest > stamp    # samples arrive in order, so none will come between
        if i == 0:
            return Lookup(None, passed, NO_POSE)
        if stamps[i] - stamps[i - 1] > max_gap:
            return Lookup(None, passed, POSE_GAP)
        if self.jumps(i - 1, i, max_speed):
            return Lookup(None, passed, POSE_JUMP)
        fraction = (stamp - stamps[i - 1]) / (stamps[i] - stamps[i - 1])
        return Lookup(interpolated(self.transforms[i - 1], self.transforms[i], fraction))

    def held(self, stamp: int) -> Lookup:
        """Return the newest sample not later than *stamp*, whatever its age."""
        i = bisect_right(self.stamps, stamp) - 1
        if i >= 0:
            return Lookup(self.transforms[i])
        return Lookup(None, bool(self.stamps), NO_POSE)

    def jumps(self, i: int, j: int, max_speed: float) -> bool:
        """Return whether a way from sample *i* to *j* is faster than *max_speed* (m/s)."""
        way = math.dist(self.transforms[i][:3, 3], self.transforms[j][:3, 3])
        return way - SLACK > max_speed * abs(self.stamps[j] - self.stamps[i]) / 1e9

    def _exact(self, i: int, max_speed: float) -> Lookup:
        """Return sample *i*, unless it is one that its neighbours know nothing of."""
        if i > 0 and self.jumps(i - 1, i, max_speed):
            if i + 1 == len(self.stamps):
                return Lookup(None, False, POSE_WILD)
            if self.jumps(i, i + 1, max_speed) and not self.jumps(i - 1, i + 1, max_speed):
                return Lookup(None, True, POSE_WILD)
        return Lookup(self.transforms[i])


def interpolated(T0: NDArray[np.float64], T1: NDArray[np.float64],
                 fraction: float) -> NDArray[np.float64]:
    """Return the transform between *T0* and *T1*: lerp of the position, slerp of the rotation."""
    q = slerp(matrix_to_quaternion(T0[:3, :3]), matrix_to_quaternion(T1[:3, :3]), fraction)
    return transform(T0[:3, 3] + fraction * (T1[:3, 3] - T0[:3, 3]), q)


def seconds(stamp: int) -> str:
    """Return a stamp (ns) as text in seconds."""
    return f'{stamp // 10**9}.{stamp % 10**9:09d} s'
