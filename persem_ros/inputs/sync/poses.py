"""Where the camera was: a pose topic or /tf, and what leads from there to the image's frame."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.trajectory import Correction
from persem_ros.inputs.sync.mount import extrinsic_of, unheard, unsaid
from persem_ros.inputs.sync.track import Lookup, NO_POSE, Track
from persem_ros.inputs.sync.tree import Tree
from persem_ros.settings.config import Config, Pose

NO_MOUNT = 'no transform from the pose to the camera'
UNSAID = 'poses that do not say what they place'
OTHER_FRAME = 'poses in another frame than the map'


class PoseBuffer:
    """
    Everything known about frames; needs no ROS and no clock, live and replay share it.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
        The settings frames.map and pose.*.
    keep : float
        Seconds of samples that are kept at least.
    strict : bool
        True: poses in another frame than frames.map, to which no chain leads, are refused (a
        node, whose localisation may come later). False: that frame is taken for the map's, which
        `notes` says.

    Attributes
    ----------
    notes : dict of str to str
        Sentences for the user.
    tree : Tree
        Of /tf and /tf_static.
    settings : persem_ros.settings.config.Pose
    map_frame : str
    extrinsic : ndarray, shape (4, 4), float64, or None
        The setting pose.extrinsic, None where it is all 0.
    heard : (int, int) or None
        Smallest and largest stamp of a pose, ns.
    unheard : str
        Who publishes /tf_static once for all and was not heard (a node), '' for nobody.
    correction : persem_ros.core.trajectory.Correction or None
        What a corrected trajectory says of the poses (a replay).

    """

    def __init__(self, config: Config, keep: float = 60.0, strict: bool = False) -> None:
        """Start empty."""
        self.notes: dict[str, str] = {}
        self._strict, self._astray = strict, True
        self.correction: Correction | None = None
        self.unheard = ''
        self.map_frame = config.frames.map
        self._keep = round(keep * 1e9)
        self.tree = Tree(self._keep)
        self._poses: Track | None = None
        self.heard: tuple[int, int] | None = None
        self._child = ''
        self.configure(config.pose)

    def configure(self, pose: Pose, map_frame: str | None = None) -> None:
        """Go on with other settings pose.* and frames.map."""
        self.settings = pose
        self.map_frame = map_frame or self.map_frame
        self.extrinsic = extrinsic_of(pose.extrinsic)
        self._mounts: dict[tuple[str, str], NDArray[np.float64] | None] = {}
        self._gap, self._speed = round(pose.max_gap * 1e9), pose.max_speed
        self.tree.configure(pose)

    def copy(self) -> PoseBuffer:
        """Return one with the same samples, which goes its own way from here on."""
        other = copy.copy(self)
        other.notes, other._mounts = dict(self.notes), {}
        other.tree = self.tree.copy()
        other._poses = self._poses.copy() if self._poses else None
        return other

    def clear(self) -> None:
        """Forget every sample (the clock went back); static transforms stay."""
        self._poses = None
        self.tree.clear()

    def forget(self, stamp: int) -> None:
        """Drop what only frames before *stamp* (ns) would ask for."""
        if self._poses:
            self._poses.forget(stamp)
        self.tree.forget(stamp)

    def add(self, stamp: int, T: NDArray[np.float64], parent: str, child: str) -> bool:
        """Take a message of the pose topic; return False for a stamp that repeats."""
        if self._poses is None or self._poses.parent != parent:
            self._poses = Track(parent, self._keep)
        self._child = child
        first, last = self.heard or (stamp, stamp)
        self.heard = min(first, stamp), max(last, stamp)
        return self._poses.add(stamp, T)

    def add_tf(self, stamp: int, T: NDArray[np.float64], parent: str, child: str) -> None:
        """Take a transform of /tf."""
        self.tree.add(stamp, T, parent, child)

    def add_static(self, T: NDArray[np.float64], parent: str, child: str) -> None:
        """Take a transform of /tf_static."""
        self.tree.add_static(T, parent, child)
        self._mounts.clear()

    @property
    def poses(self) -> Track | None:
        """Return the samples of the pose topic, None before the first."""
        return self._poses

    @property
    def child(self) -> str:
        """Return the frame that the poses place, '' where neither settings nor messages say."""
        return self.settings.child_frame or self._child

    def lookup(self, stamp: int, frame: str) -> Lookup:
        """
        Return where the camera was.

        Parameters
        ----------
        stamp : int
            Nanoseconds.
        frame : str
            The image's frame_id.

        Returns
        -------
        Lookup
            T_map_camera, or why there is none.

        """
        if self.settings.source == 'tf':
            found, mount = self.tree.chain(self.map_frame, frame, stamp), \
                self._mount_in_tree(frame, stamp)
            if found.T is not None and self.extrinsic is not None:
                found = found._replace(T=found.T @ self.extrinsic)
                mount = self.extrinsic if mount is None else mount @ self.extrinsic
            return self._corrected(found, stamp, mount)
        if self._poses is None:
            return Lookup(None, False, NO_POSE)
        found = self.pose_at(stamp)
        if found.T is None:
            return found
        above = self._above(self._poses.parent, stamp)
        mounted = self._mount(frame, stamp)
        self._astray = self._mounts[self.child, frame] is None \
            or self._poses.parent not in ('', self.map_frame)
        if above.T is None:
            return above
        if mounted.T is None:
            return mounted
        return self._corrected(Lookup(above.T @ found.T @ mounted.T), stamp, mounted.T)

    def pose_at(self, stamp: int) -> Lookup:
        """Return the Lookup of the pose topic, held where pose.hold names what it places."""
        assert self._poses is not None
        if self.child and self.child in self.settings.hold:
            return self._poses.held(stamp)
        return self._poses.at(stamp, self._gap, self._speed)

    def body(self, stamp: int, frame: str) -> Lookup:
        """
        Return where what the poses place was, T_map_body, as recorded.

        Where /tf gives the poses that is pose.child_frame, else the camera *frame* itself.

        """
        if self.settings.source == 'tf':
            return self.tree.chain(self.map_frame, self.settings.child_frame or frame, stamp)
        if self._poses is None:
            return Lookup(None, False, NO_POSE)
        found = self.pose_at(stamp)
        if found.T is None:
            return found
        above = self._above(self._poses.parent, stamp)
        return above if above.T is None else Lookup(above.T @ found.T)

    @property
    def needs_tf(self) -> bool:
        """Return whether /tf may have to say where the poses are: not once they have led home."""
        return self.settings.source == 'tf' or self._astray

    def newest(self, frame: str) -> int | None:
        """Return the largest stamp that came last on the way to *frame*, ns; None: none."""
        if self.settings.source == 'tf':
            tracks = self._tracks(self.map_frame, frame)
        else:
            tracks = [self._poses] if self._poses else []
            if self._poses and self._poses.parent not in ('', self.map_frame):
                tracks += self._tracks(self.map_frame, self._poses.parent)
        return max((track.latest for track in tracks if track.latest is not None), default=None)

    def span(self, frame: str) -> tuple[int, int] | None:
        """Return the stamps between which poses, or /tf to *frame*, are known, ns."""
        if self.settings.source != 'tf':
            return (self._poses.stamps[0], self._poses.stamps[-1]) if self._poses else None
        tracks = [t for t in self._tracks(self.map_frame, self.settings.child_frame or frame)
                  if t.stamps]
        if not tracks:
            return None
        return max(t.stamps[0] for t in tracks), min(t.stamps[-1] for t in tracks)

    def tie(self, target: str, source: str, stamp: int) -> Lookup:
        """Return the Lookup of T_target_source at *stamp*, by /tf_static and /tf alone."""
        return self.tree.chain(target, source, stamp)

    def _tracks(self, target: str, source: str) -> list[Track]:
        return [track for track, _ in self.tree.links(target, source)]

    def _above(self, parent: str, stamp: int) -> Lookup:
        """Return the Lookup of T_map_parent, where *parent* is the frame of the pose topic."""
        if parent in ('', self.map_frame):
            return Lookup(np.eye(4))
        if self.tree.connected(self.map_frame, parent):
            return self.tree.chain(self.map_frame, parent, stamp)
        if self._strict:
            return Lookup(None, False, OTHER_FRAME)
        self.notes['map'] = (
            f'the poses are in the frame {parent!r}, which is taken for the map frame '
            f'{self.map_frame!r}; --set frames.map={parent} says so')
        return Lookup(np.eye(4))

    def _corrected(self, found: Lookup, stamp: int, mount: NDArray[np.float64] | None) -> Lookup:
        """Return the Lookup of a camera with its mount, the pose corrected."""
        if found.T is None:
            return found
        T = found.T if self.correction is None else self.correction.pose(found.T, stamp)
        return found._replace(T=T, mount=mount)

    def _mount_in_tree(self, frame: str, stamp: int) -> NDArray[np.float64] | None:
        """Return T_body_camera where /tf gives the poses and pose.child_frame names the body."""
        body = self.settings.child_frame
        return self.tree.chain(body, frame, stamp).T if body else None

    def _mount(self, frame: str, stamp: int) -> Lookup:
        """Return the Lookup of T_child_camera, along moving links where static ones do not do."""
        key = self.child, frame
        if key not in self._mounts:
            self._mounts[key] = self._mounted(*key)
        mount = self._mounts[key]
        if mount is not None and not unheard(self, frame):
            return Lookup(mount)
        if unsaid(self, frame):
            return Lookup(None, False, UNSAID)
        if self.child and self.tree.connected(self.child, frame):
            return self.tree.chain(self.child, frame, stamp)
        return Lookup(None, False, NO_MOUNT)

    def _mounted(self, child: str, frame: str) -> NDArray[np.float64] | None:
        """Return T_child_camera where it never changes, None where it may or is not known."""
        if child == frame or not child and not unsaid(self, frame):
            if self.extrinsic is not None:
                self.notes['extrinsic'] = (
                    'pose.extrinsic is not used: the poses name no frame but that of the camera; '
                    '--set pose.child_frame=base_link says that they place the body')
            return np.eye(4)
        if self.extrinsic is not None:
            return self.extrinsic
        return self.tree.chain(child, frame, None).T if child else None
