"""A trajectory that somebody corrected, and what it does to poses (spec section 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverses, quaternions, rotations, slerps
from persem_ros.errors import PersemError

SHARE = 0.8                 # of a trajectory's poses that must lie within the session
GAP = 500_000_000           # ns between poses across which one is not interpolated


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    Corrected poses of what the pose topic places.

    Attributes
    ----------
    stamps : ndarray, shape (n,), int64
        Nanoseconds, ascending.
    poses : ndarray, shape (n, 4, 4), float64
        T_map_body.
    name : str
        Where it comes from, for people.

    """

    stamps: NDArray[np.int64]
    poses: NDArray[np.float64]
    name: str

    def check(self, first: int, last: int, what: str) -> None:
        """
        Refuse a trajectory that hardly covers the time from *first* to *last* (ns).

        Raises
        ------
        PersemError
            Where less than SHARE of its poses lie within; *what* says what lasted so long.

        """
        within = int(np.count_nonzero((self.stamps >= first) & (self.stamps <= last)))
        if within < max(1.0, SHARE * len(self.stamps)):
            span = f'it runs from {seconds(self.stamps[0])} to {seconds(self.stamps[-1])}' \
                if len(self.stamps) else 'it is empty'
            raise PersemError(
                f'{self.name}: {within} of {len(self.stamps)} poses lie within {what}, '
                f'{seconds(first)} to {seconds(last)}; {span}, expected {SHARE:.0%} of its poses '
                'there: is it of another flight, or are its stamps of another clock?')


class Correction:
    """
    K = best * placed^-1 at some stamps, interpolated in between (lerp, slerp).

    Before the first and after the last stamp the nearest one's.

    Parameters
    ----------
    stamps : ndarray, shape (n,), int64
        Nanoseconds, ascending, one at least.
    best, placed : ndarray, shape (n, 4, 4), float64
        T_map_body as it is known now, and as it was taken for.
    origin : sequence of 3 floats
        Point of the map frame about which K is interpolated: of coordinates as large as UTM's
        the smallest turn moves the frame's origin by metres.

    """

    def __init__(self, stamps: NDArray[np.int64], best: NDArray[np.float64],
                 placed: NDArray[np.float64], origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
        self.stamps = stamps
        self._origin = np.asarray(origin, float)
        best, placed = best.copy(), placed.copy()
        for poses in (best, placed):
            poses[:, :3, 3] -= self._origin
        self._K = best @ inverses(placed)

    def at(self, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return K, shape (n, 4, 4), at the given stamps (n,)."""
        K = between(self.stamps, self._K, np.clip(stamps, self.stamps[0], self.stamps[-1]))
        K[:, :3, 3] += self._origin - K[:, :3, :3] @ self._origin
        return K

    def pose(self, T: NDArray[np.float64], stamp: int) -> NDArray[np.float64]:
        """Return the corrected pose of T, shape (4, 4), that was taken at *stamp*."""
        return self.at(np.array([stamp], np.int64))[0] @ T


def correction(trajectory: Trajectory, stamps: NDArray[np.int64], placed: NDArray[np.float64],
               what: str, origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Correction:
    """
    Return what a trajectory corrects of poses that were recorded.

    Parameters
    ----------
    trajectory : Trajectory
        Of the same body.
    stamps : ndarray, shape (m,), int64
        Nanoseconds, ascending.
    placed : ndarray, shape (m, 4, 4), float64
        T_map_body at these.
    what : str
        What is corrected, for people.
    origin : sequence of 3 floats
        See Correction.

    Raises
    ------
    PersemError
        Where the trajectory is of another time.

    """
    trajectory.check(int(stamps[0]), int(stamps[-1]), what)
    at = trajectory.stamps
    after = np.clip(np.searchsorted(stamps, at), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    known = (stamps[after] == at) | (
        (at >= stamps[0]) & (at <= stamps[-1]) & (stamps[after] - stamps[before] <= GAP))
    if not known.any():
        raise PersemError(f'{trajectory.name}: no pose lies at the stamp of a pose of {what}, or '
                          f'between two that are at most {GAP / 1e9:g} s apart')
    return Correction(at[known], trajectory.poses[known], between(stamps, placed, at[known]),
                      origin)


def between(stamps: NDArray[np.int64], poses: NDArray[np.float64],
            at: NDArray[np.int64]) -> NDArray[np.float64]:
    """
    Return poses (n, 4, 4) at other stamps (n,) than theirs (m,), which lie around.

    Positions are interpolated linearly, rotations along the shorter arc.

    """
    after = np.clip(np.searchsorted(stamps, at), 0, len(stamps) - 1)
    before = np.where(stamps[after] == at, after, np.maximum(after - 1, 0))
    length = (stamps[after] - stamps[before]).astype(float)
    fraction = ((at - stamps[before]) / np.where(length > 0, length, 1.0))[:, None]
    result = poses[before]
    moves = np.flatnonzero(before != after)
    a, b, fraction = poses[before[moves]], poses[after[moves]], fraction[moves]
    result[moves, :3, 3] = a[:, :3, 3] + fraction * (b[:, :3, 3] - a[:, :3, 3])
    result[moves, :3, :3] = rotations(slerps(
        quaternions(a[:, :3, :3]), quaternions(b[:, :3, :3]), fraction))
    return result


def seconds(stamp: int) -> str:
    """Return a stamp (ns) as people read it."""
    return f'{int(stamp) / 1e9:.3f} s'
