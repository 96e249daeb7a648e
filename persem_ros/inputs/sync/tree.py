"""The tree of frames that /tf and /tf_static span: paths, chains, and what a chain lacks."""

from collections.abc import Iterator, Sequence
import math

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverse
from persem_ros.inputs.sync.track import Lookup, NO_POSE, Track
from persem_ros.settings.config import Pose


class Tree:
    """
    Static and moving transforms, child by child; where a frame has several parents the last holds.

    Parameters
    ----------
    keep_ns : int
        Nanoseconds of moving transforms that are kept at least.

    Attributes
    ----------
    static : dict of str to (str, ndarray (4, 4))
        Parent and T_parent_child, by child.
    moving : dict of str to Track
        By child.
    parents : dict of str to set of str
        Every parent that a child was ever given.

    """

    def __init__(self, keep_ns: int) -> None:
        self._keep = keep_ns
        self.static: dict[str, tuple[str, NDArray[np.float64]]] = {}
        self.moving: dict[str, Track] = {}
        self.parents: dict[str, set[str]] = {}
        self.configure(Pose())

    def configure(self, pose: Pose) -> None:
        """Go on with the settings pose.max_gap, pose.max_speed and pose.hold."""
        self._gap = round(pose.max_gap * 1e9)
        self._speed = pose.max_speed
        self._hold = frozenset(pose.hold)

    def add(self, stamp: int, T: NDArray[np.float64], parent: str, child: str) -> None:
        """Take a transform of /tf."""
        self.parents.setdefault(child, set()).add(parent)
        track = self.moving.get(child)
        if track is None or track.parent != parent:
            track = self.moving[child] = Track(parent, self._keep)
        track.add(stamp, T)

    def add_static(self, T: NDArray[np.float64], parent: str, child: str) -> None:
        """Take a transform of /tf_static."""
        self.parents.setdefault(child, set()).add(parent)
        self.static[child] = parent, T

    def path(self, frame: str, moving: bool = True) -> list[str]:
        """Return *frame* and its ancestors, the root last."""
        path = [frame]
        while True:
            if frame in self.static:
                frame = self.static[frame][0]
            elif moving and frame in self.moving:
                frame = self.moving[frame].parent
            else:
                return path
            if frame in path:       # a loop: whoever publishes that is not to be followed
                return path
            path.append(frame)

    def chain(self, target: str, source: str, stamp: int | None) -> Lookup:
        """
        Return the Lookup of T_target_source, where *stamp* None allows static transforms only.

        Both frames are followed towards the root until the paths meet; what lies above that
        is not asked for.

        """
        ways = self._ways(target, source, stamp is not None)
        if ways is None:
            return Lookup(None, False, NO_POSE)
        found = self._product(ways[0], stamp)
        if found.T is None:
            return found
        back = self._product(ways[1], stamp)
        return Lookup(inverse(back.T) @ found.T) if back.T is not None else back

    def connected(self, target: str, source: str, moving: bool = True) -> bool:
        """Return whether a chain leads from one frame to another."""
        return self._ways(target, source, moving) is not None

    def links(self, target: str, source: str) -> list[tuple[Track, str]]:
        """Return (track, child) of the moving links between two frames."""
        ways = self._ways(target, source, True) or ([], [])
        return [(self.moving[frame], frame) for way in ways for frame in way
                if frame not in self.static]

    def at(self, child: str, stamp: int) -> Lookup:
        """Return the Lookup of one moving link, held where pose.hold says so."""
        track = self.moving[child]
        if child in self._hold:
            return track.held(stamp)
        return track.at(stamp, self._gap, self._speed)

    def edges(self) -> str:
        """Return all edges as text."""
        found = sorted({f'{track.parent} -> {child}' for child, track in self.moving.items()}
                       | {f'{up} -> {child}' for child, (up, _) in self.static.items()})
        return ', '.join(found) or 'it is empty'

    def roots(self, frame: str) -> list[str]:
        """Return every frame without a parent that leads to *frame*, also by former parents."""
        found, seen, waiting = set(), set(), [frame]
        while waiting:
            name = waiting.pop()
            if name in seen:
                continue
            seen.add(name)
            above = self.parents.get(name, set())
            if not above and name != frame:
                found.add(name)
            waiting += above
        return sorted(found)

    def _ways(self, target: str, source: str,
              moving: bool) -> tuple[list[str], list[str]] | None:
        """Return the frames from *source* and from *target* up to where they meet."""
        up, down = self.path(source, moving), self.path(target, moving)
        meet = next((frame for frame in up if frame in down), None)
        return None if meet is None else (up[:up.index(meet)], down[:down.index(meet)])

    def _product(self, frames: Sequence[str], stamp: int | None) -> Lookup:
        """Return the Lookup of the transform from the first of *frames* to above the last."""
        T = np.eye(4)
        for frame in frames:
            if frame in self.static:
                T = self.static[frame][1] @ T
                continue
            assert stamp is not None
            found = self.at(frame, stamp)
            if found.T is None:
                return found
            T = found.T @ T
        return Lookup(T)


def gaps(track: Track) -> Iterator[float]:
    """Yield the seconds between the samples of a track."""
    for one, two in zip(track.stamps, track.stamps[1:], strict=False):
        yield (two - one) / 1e9


def widest(track: Track) -> float:
    """Return the widest gap of a track, seconds; infinity with fewer than two samples."""
    return max(gaps(track), default=math.inf)
