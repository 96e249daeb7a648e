"""The tree of frames that /tf and /tf_static span: paths, chains, and what a chain lacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import copy
import math

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverse
from persem_ros.inputs.sync.track import Lookup, NO_POSE, Track
from persem_ros.settings.config import Pose

Edge = tuple[str, str]
DEEPEST = 30        # links of a chain that is looked for along former parents


class Tree:
    """
    Static and moving transforms, child by child.

    Where a frame has several parents the last one holds, unless only a former one leads to where
    a chain is to go.

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
        self._former: dict[tuple[str, str], Track] = {}     # by parent and child
        self.parents: dict[str, set[str]] = {}
        self.configure(Pose())

    def configure(self, pose: Pose) -> None:
        """Go on with the settings pose.max_gap, pose.max_speed and pose.hold."""
        self._gap = round(pose.max_gap * 1e9)
        self._speed = pose.max_speed
        self._hold = frozenset(pose.hold)

    def copy(self) -> Tree:
        """Return one with the same transforms, which goes its own way from here on."""
        other = copy.copy(self)
        other.static = dict(self.static)
        other.parents = {child: set(parents) for child, parents in self.parents.items()}
        other._former = {edge: track.copy() for edge, track in self._former.items()}
        other.moving = {child: other._former[track.parent, child]
                        for child, track in self.moving.items()}
        return other

    def add(self, stamp: int, T: NDArray[np.float64], parent: str, child: str) -> None:
        """Take a transform of /tf."""
        self.parents.setdefault(child, set()).add(parent)
        track = self.moving.get(child)
        if track is None or track.parent != parent:
            track = self._former.get((parent, child)) or Track(parent, self._keep)
            self._former[parent, child] = self.moving[child] = track
        track.add(stamp, T)

    def forget(self, stamp: int) -> None:
        """Drop what only frames before *stamp* (ns) would ask for."""
        for track in self._former.values():
            track.forget(stamp)

    def clear(self) -> None:
        """Forget all moving transforms."""
        self.moving.clear()
        self._former.clear()

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
        return [(self._track(*edge), edge[0]) for way in ways for edge in way
                if not self._is_static(*edge)]

    def at(self, child: str, stamp: int, parent: str = '') -> Lookup:
        """Return the Lookup of one moving link, held where pose.hold says so."""
        track = self._track(child, parent)
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
              moving: bool) -> tuple[list[Edge], list[Edge]] | None:
        """Return the links (child, parent) from *source* and from *target* to where they meet."""
        for up in self._paths(source, moving):
            for down in self._paths(target, moving):
                meet = next((frame for frame in up if frame in down), None)
                if meet is not None:
                    return _edges(up, meet), _edges(down, meet)
        return None

    def _paths(self, frame: str, moving: bool) -> Iterator[list[str]]:
        """Yield the path to the root, then those along former parents."""
        yield self.path(frame, moving)
        if moving and any(len(self.parents.get(name, ())) > 1 for name in self._above(frame)):
            yield from self._former_paths([frame])

    def _former_paths(self, path: list[str]) -> Iterator[list[str]]:
        """Yield all paths that go on from *path*."""
        ups = self.parents.get(path[-1], set()) - set(path)
        if not ups or len(path) > DEEPEST:
            yield path
        for up in sorted(ups):
            if (up, path[-1]) in self._former or self._is_static(path[-1], up):
                yield from self._former_paths([*path, up])

    def _above(self, frame: str) -> set[str]:
        """Return a frame and all that it was ever below of."""
        found, waiting = set(), [frame]
        while waiting:
            name = waiting.pop()
            if name not in found:
                found.add(name)
                waiting += self.parents.get(name, ())
        return found

    def _is_static(self, child: str, parent: str) -> bool:
        return child in self.static and self.static[child][0] == parent

    def _track(self, child: str, parent: str) -> Track:
        """Return the samples of a moving link."""
        return self._former.get((parent, child)) or self.moving[child]

    def _product(self, edges: Sequence[Edge], stamp: int | None) -> Lookup:
        """Return the Lookup of the transform from the first frame of *edges* to above the last."""
        T = np.eye(4)
        for child, parent in edges:
            if self._is_static(child, parent):
                T = self.static[child][1] @ T
                continue
            assert stamp is not None
            found = self.at(child, stamp, parent)
            if found.T is None:
                return found
            T = found.T @ T
        return Lookup(T)


def _edges(path: list[str], meet: str) -> list[Edge]:
    """Return the links (child, parent) of a path up to the frame *meet*."""
    part = path[:path.index(meet) + 1]
    return list(zip(part, part[1:], strict=False))


def gaps(track: Track) -> Iterator[float]:
    """Yield the seconds between the samples of a track."""
    for one, two in zip(track.stamps, track.stamps[1:], strict=False):
        yield (two - one) / 1e9


def widest(track: Track) -> float:
    """Return the widest gap of a track, seconds; infinity with fewer than two samples."""
    return max(gaps(track), default=math.inf)
