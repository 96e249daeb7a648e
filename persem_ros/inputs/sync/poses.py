"""Poses at a stamp: interpolated, never extrapolated, along static and moving frames."""

from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from persem_ros.core.transforms import inverse, matrix_to_quaternion, slerp, transform
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.messages import unit_quaternion

NO_POSE = 'no pose'
POSE_GAP = 'pose gap'
NO_MOUNT = 'no transform from the pose to the camera'
TRIM_EVERY = 256        # samples between two looks at the age of the oldest


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

    """

    T: np.ndarray
    final: bool = True
    reason: str = ''


class Track:
    """The samples of one transform in stamp order."""

    def __init__(self, parent, keep_ns):
        """Start an empty track below *parent* that spans about *keep_ns*."""
        self.parent = parent
        self.stamps = []
        self.transforms = []
        self._keep = keep_ns
        self._latest = None     # the stamp that arrived last, not the largest
        self._added = 0

    def add(self, stamp, T):
        """Insert a sample; return False where that stamp is there already."""
        i = bisect_left(self.stamps, stamp)
        self._latest = stamp
        if i < len(self.stamps) and self.stamps[i] == stamp:
            return False
        self.stamps.insert(i, stamp)
        self.transforms.insert(i, T)
        self._added += 1
        if self._added % TRIM_EVERY == 0:
            # Against the median: one stamp that is hours ahead must not empty the buffer.
            self.forget(self.stamps[len(self.stamps) // 2] - self._keep)
        return True

    def forget(self, stamp):
        """Drop samples before *stamp*, but for the last of them."""
        i = bisect_left(self.stamps, stamp) - 1
        if i > 0:
            del self.stamps[:i], self.transforms[:i]

    def at(self, stamp, max_gap):
        """Return the Lookup of this transform at *stamp* across at most *max_gap* ns."""
        stamps = self.stamps
        i = bisect_left(stamps, stamp)
        if i < len(stamps) and stamps[i] == stamp:
            return Lookup(self.transforms[i])
        if i == len(stamps):
            return Lookup(None, False, NO_POSE)
        passed = self._latest > stamp       # samples arrive in order, so none will come between
        if i == 0:
            return Lookup(None, passed, NO_POSE)
        if stamps[i] - stamps[i - 1] > max_gap:
            return Lookup(None, passed, POSE_GAP)
        fraction = (stamp - stamps[i - 1]) / (stamps[i] - stamps[i - 1])
        return Lookup(interpolated(self.transforms[i - 1], self.transforms[i], fraction))


class PoseBuffer:
    """
    Everything known about frames; needs no ROS and no clock, live and replay share it.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
        The settings frames.map and pose.*.
    keep : float
        Seconds of samples that are kept at least.

    """

    def __init__(self, config, keep=60.0):
        """Start empty."""
        self.notes = {}
        self._map = config.frames.map
        self.configure(config.pose)
        self._keep = round(keep * 1e9)
        self._poses = None
        self._span = None       # smallest and largest stamp of a pose
        self._child = ''
        self._moving = {}       # child -> Track
        self._static = {}       # child -> (parent, T)
        self._mounts = {}
        self._extrinsic = _extrinsic(config.pose.extrinsic)

    def configure(self, pose):
        """Go on with another pose.max_gap (persem_ros.settings.config.Pose)."""
        self._settings = pose
        self._gap = round(pose.max_gap * 1e9)

    def clear(self):
        """Forget every sample (the clock went back); static transforms stay."""
        self._poses = None
        self._moving.clear()

    def forget(self, stamp):
        """Drop what only frames before *stamp* (ns) would ask for."""
        for track in [self._poses, *self._moving.values()]:
            if track:
                track.forget(stamp)

    def add(self, stamp, T, parent, child):
        """Take a message of the pose topic; return False for a stamp that repeats."""
        if self._poses is None or self._poses.parent != parent:
            self._poses = Track(parent, self._keep)
        self._child = self._settings.child_frame or child
        first, last = self._span or (stamp, stamp)
        self._span = min(first, stamp), max(last, stamp)
        return self._poses.add(stamp, T)

    def add_tf(self, stamp, T, parent, child):
        """Take a transform of /tf."""
        track = self._moving.get(child)
        if track is None or track.parent != parent:
            track = self._moving[child] = Track(parent, self._keep)
        track.add(stamp, T)

    def add_static(self, T, parent, child):
        """Take a transform of /tf_static."""
        self._static[child] = (parent, T)
        self._mounts.clear()

    def lookup(self, stamp, frame):
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
        if self._settings.source == 'tf':
            return self._chain(self._map, frame, stamp)
        if self._poses is None:
            return Lookup(None, False, NO_POSE)
        found = self._poses.at(stamp, self._gap)
        if found.T is None:
            return found
        mount = self._mount(self._poses.parent, self._child, frame)
        if mount is None:
            return Lookup(None, False, NO_MOUNT)
        before, after = mount
        return Lookup(before @ found.T @ after)

    def mount_sentence(self, frame):
        """Return the sentence that says what NO_MOUNT lacks for images in *frame*."""
        known = ', '.join(f'{parent} -> {child}' for child, (parent, _) in self._static.items())
        return (f'the poses place the frame {self._child!r}, the images are in {frame!r}, and '
                f'/tf_static ({known or "empty"}) does not connect them; give the mounting with '
                '--set pose.extrinsic=[x,y,z,qx,qy,qz,qw], or --set '
                f'pose.child_frame={frame} if the poses place the camera itself')

    def explain(self, stamp, frame):
        """Return the sentence that says why *frame* has no pose at *stamp*."""
        if self._settings.source == 'tf':
            edges = sorted({f'{track.parent} -> {child}' for child, track in self._moving.items()}
                           | {f'{up} -> {child}' for child, (up, _) in self._static.items()})
            return (f'at {_seconds(stamp)} /tf gives no chain from {self._map!r} to {frame!r}: '
                    f'{", ".join(edges) or "it is empty"}')
        if self._span is None:
            return 'the pose topic has no pose that can be used'
        first, last = map(_seconds, self._span)
        return (f'a frame is at {_seconds(stamp)}, the poses run from {first} to {last} and gaps '
                f'beyond pose.max_gap ({self._settings.max_gap:g} s) are not bridged')

    def _mount(self, parent, child, frame):
        """Return (T_map_parent, T_child_camera), None where the second is not known."""
        key = parent, child, frame
        if key not in self._mounts:
            self._mounts[key] = self._mounted(parent, child, frame)
        return self._mounts[key]

    def _mounted(self, parent, child, frame):
        before = self._chain(self._map, parent, None).T
        if before is None:
            before = np.eye(4)
            if parent:
                self.notes['map'] = (
                    f'the poses are in the frame {parent!r}, which is taken for the map frame '
                    f'{self._map!r}; --set frames.map={parent} says so')
        if child in ('', frame):
            if self._extrinsic is not None:
                self.notes['extrinsic'] = (
                    'pose.extrinsic is not used: the poses name no frame but that of the camera; '
                    '--set pose.child_frame=base_link says that they place the body')
            return before, np.eye(4)
        after = self._extrinsic
        if after is None:
            after = self._chain(child, frame, None).T
        return None if after is None else (before, after)

    def _chain(self, target, source, stamp):
        """
        Return the Lookup of T_target_source, where *stamp* None allows static transforms only.

        Both frames are followed towards the root until the paths meet; what lies above that
        is not asked for.

        """
        up_source, up_target = self._path(source, stamp), self._path(target, stamp)
        meet = next((frame for frame in up_source if frame in up_target), None)
        if meet is None:
            return Lookup(None, False, NO_POSE)
        T_meet_source = self._product(up_source[:up_source.index(meet)], stamp)
        if T_meet_source.T is None:
            return T_meet_source
        T_meet_target = self._product(up_target[:up_target.index(meet)], stamp)
        if T_meet_target.T is None:
            return T_meet_target
        return Lookup(inverse(T_meet_target.T) @ T_meet_source.T)

    def _path(self, frame, stamp):
        """Return *frame* and its ancestors."""
        path = [frame]
        while True:
            if frame in self._static:
                frame = self._static[frame][0]
            elif stamp is not None and frame in self._moving:
                frame = self._moving[frame].parent
            else:
                return path
            if frame in path:       # a loop: whoever publishes that is not to be followed
                return path
            path.append(frame)

    def _product(self, frames, stamp):
        """Return the Lookup of the transform from the first of *frames* to above the last."""
        T = np.eye(4)
        for frame in frames:
            if frame in self._static:
                T = self._static[frame][1] @ T
                continue
            found = self._moving[frame].at(stamp, self._gap)
            if found.T is None:
                return found
            T = found.T @ T
        return Lookup(T)


def interpolated(T0, T1, fraction):
    """Return the transform between *T0* and *T1*: lerp of the position, slerp of the rotation."""
    q = slerp(matrix_to_quaternion(T0[:3, :3]), matrix_to_quaternion(T1[:3, :3]), fraction)
    return transform(T0[:3, 3] + fraction * (T1[:3, 3] - T0[:3, 3]), q)


def _extrinsic(values):
    """Return the 4x4 matrix of the setting pose.extrinsic, None where it is all 0."""
    if not any(values):
        return None
    try:
        return transform(values[:3], unit_quaternion(values[3:]))
    except PersemError:
        raise PersemError(f'pose.extrinsic: expected x y z and a quaternion qx qy qz qw of '
                          f'length 1, got {list(values)}') from None


def _seconds(stamp):
    return f'{stamp // 10**9}.{stamp % 10**9:09d} s'
