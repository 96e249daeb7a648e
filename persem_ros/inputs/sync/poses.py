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
OTHER_FRAME = 'poses in another frame than the map'
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
    mount : ndarray, shape (4, 4), float64, or None
        T_body_camera, where the poses place a body and not the camera.

    """

    T: np.ndarray
    final: bool = True
    reason: str = ''
    mount: np.ndarray = None


class Track:
    """The samples of one transform in stamp order."""

    def __init__(self, parent, keep_ns):
        """Start an empty track below *parent* that spans about *keep_ns*."""
        self.parent = parent
        self.stamps = []
        self.transforms = []
        self._keep = keep_ns
        self.latest = None      # the stamp that arrived last, not the largest
        self._added = 0

    def add(self, stamp, T):
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
        passed = self.latest > stamp       # samples arrive in order, so none will come between
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
    strict : bool
        True: poses in another frame than frames.map, to which no chain leads, are refused (a
        node, whose localisation may come later). False: that frame is taken for the map's, which
        `notes` says.

    """

    def __init__(self, config, keep=60.0, strict=False):
        """Start empty."""
        self.notes = {}
        self._strict, self._astray = strict, True
        self._map = config.frames.map
        self.configure(config.pose)
        self._keep = round(keep * 1e9)
        self._poses = None
        self._span = None       # smallest and largest stamp of a pose
        self._child = ''
        self._moving = {}       # child -> Track
        self._static = {}       # child -> (parent, T)

    def configure(self, pose, map_frame=None):
        """Go on with other settings pose.* (persem_ros.settings.config.Pose) and frames.map."""
        self._settings = pose
        self._map = map_frame or self._map
        self._extrinsic = _extrinsic(pose.extrinsic)
        self._mounts = {}
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
        self._child = child
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

    @property
    def child(self):
        """Return the frame that the poses place, '' where neither settings nor messages say."""
        return self._settings.child_frame or self._child

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
        above = self._above(self._poses.parent, stamp)
        mount = self._mount(self.child, frame)
        self._astray = mount is None or self._poses.parent not in ('', self._map)
        if above.T is None:
            return above
        if mount is None:
            return Lookup(None, False, NO_MOUNT)
        return Lookup(above.T @ found.T @ mount, mount=mount)

    @property
    def needs_tf(self) -> bool:
        """Return whether /tf may have to say where the poses are: not once they have led home."""
        return self._settings.source == 'tf' or self._astray

    def newest(self, frame: str) -> int | None:
        """Return the largest stamp that came last on the way to *frame*, ns; None: none."""
        if self._settings.source == 'tf':
            tracks = self._moving_between(self._map, frame)
        else:
            tracks = [self._poses] if self._poses else []
            if self._poses and self._poses.parent not in ('', self._map):
                tracks += self._moving_between(self._map, self._poses.parent)
        return max((track.latest for track in tracks), default=None)

    def mount_sentence(self, frame):
        """Return the sentence that says what NO_MOUNT lacks for images in *frame*."""
        known = ', '.join(f'{parent} -> {child}' for child, (parent, _) in self._static.items())
        return (f'the poses place the frame {self.child!r}, the images are in {frame!r}, and '
                f'/tf_static ({known or "empty"}) does not connect them; give the mounting with '
                '--set pose.extrinsic=[x,y,z,qx,qy,qz,qw], or --set '
                f'pose.child_frame={frame} if the poses place the camera itself')

    def other_frame_sentence(self) -> str:
        """Return the sentence that says what OTHER_FRAME lacks."""
        parent = self._poses.parent if self._poses else ''
        return (f'the poses are in the frame {parent!r}, the map is in {self._map!r}, and '
                f'/tf ({self._edges()}) does not connect them; start what publishes '
                f'{self._map} -> {parent}, or map in that frame: --set frames.map={parent}')

    def explain(self, stamp, frame):
        """Return the sentence that says why *frame* has no pose at *stamp*."""
        target = frame
        if self._settings.source != 'tf':
            if self._span is None:
                return 'the pose topic has no pose that can be used'
            if self._poses is None or self._poses.at(stamp, self._gap).T is None:
                return self._explain_topic(stamp)
            target = self._poses.parent
        for track, link in self._links(self._map, target):
            if track.at(stamp, self._gap).T is None:
                return self._explain_link(stamp, track, link)
        return (f'at {_seconds(stamp)} /tf gives no chain from {self._map!r} to {target!r}: '
                f'{self._edges()}')

    def _explain_topic(self, stamp):
        """Return why the pose topic has nothing at *stamp*."""
        first, last = self._span
        text = (f'a frame is at {_seconds(stamp)}, the poses run from {_seconds(first)} to '
                f'{_seconds(last)}')
        if first <= stamp <= last:
            return f'{text} and gaps beyond pose.max_gap ({self._settings.max_gap:g} s) are not ' \
                   'bridged'
        return f'{text}{_apart(stamp, first, last)}'

    def _explain_link(self, stamp, track, link):
        """Return why a moving link of /tf has nothing at *stamp*."""
        first, last = track.stamps[0], track.stamps[-1]
        if first <= stamp <= last:
            i = bisect_left(track.stamps, stamp)
            gap = (track.stamps[i] - track.stamps[i - 1]) / 1e9
            return (f'at {_seconds(stamp)} the transform {link} of /tf has a gap of {gap:.2f} s; '
                    f'pose.max_gap is {self._settings.max_gap:g} s: --set pose.max_gap='
                    f'{1.2 * gap:.1f} bridges it')
        return (f'a frame is at {_seconds(stamp)}, the transform {link} of /tf runs from '
                f'{_seconds(first)} to {_seconds(last)}{_apart(stamp, first, last)}')

    def _edges(self):
        """Return all edges of /tf and /tf_static as text."""
        edges = sorted({f'{track.parent} -> {child}' for child, track in self._moving.items()}
                       | {f'{up} -> {child}' for child, (up, _) in self._static.items()})
        return ', '.join(edges) or 'it is empty'

    def _links(self, target, source):
        """Return [(track, name)] of the moving links between two frames."""
        up_source, up_target = self._path(source, 0), self._path(target, 0)
        meet = next((frame for frame in up_source if frame in up_target), None)
        if meet is None:
            return []
        frames = up_source[:up_source.index(meet)] + up_target[:up_target.index(meet)]
        return [(self._moving[frame], f'{self._moving[frame].parent} -> {frame}')
                for frame in frames if frame not in self._static]

    def _moving_between(self, target, source):
        return [track for track, _ in self._links(target, source)]

    def _above(self, parent, stamp):
        """Return the Lookup of T_map_parent, where *parent* is the frame of the pose topic."""
        if parent in ('', self._map):
            return Lookup(np.eye(4))
        if set(self._path(parent, stamp)) & set(self._path(self._map, stamp)):
            return self._chain(self._map, parent, stamp)
        if self._strict:
            return Lookup(None, False, OTHER_FRAME)
        self.notes['map'] = (
            f'the poses are in the frame {parent!r}, which is taken for the map frame '
            f'{self._map!r}; --set frames.map={parent} says so')
        return Lookup(np.eye(4))

    def _mount(self, child, frame):
        """Return T_child_camera, None where it is not known."""
        key = child, frame
        if key not in self._mounts:
            self._mounts[key] = self._mounted(child, frame)
        return self._mounts[key]

    def _mounted(self, child, frame):
        if child in ('', frame):
            if self._extrinsic is not None:
                self.notes['extrinsic'] = (
                    'pose.extrinsic is not used: the poses name no frame but that of the camera; '
                    '--set pose.child_frame=base_link says that they place the body')
            return np.eye(4)
        if self._extrinsic is not None:
            return self._extrinsic
        return self._chain(child, frame, None).T

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


def _apart(stamp, first, last):
    """Return how far *stamp* lies outside of *first* to *last*, and what to do about it."""
    if stamp > last:
        return (f': the newest is {(stamp - last) / 1e9:.2f} s older than the image; do the '
                'clocks differ (chrony, PTP, use_sim_time everywhere), or do poses come later '
                'than sync.max_wait?')
    return (f': the oldest is {(first - stamp) / 1e9:.2f} s newer than the image; do the clocks '
            'differ (chrony, PTP, use_sim_time everywhere)?')
