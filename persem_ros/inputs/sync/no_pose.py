"""Sentences that say why an image has no pose, and what to type."""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING

import numpy as np
from persem_ros.inputs.sync.mount import bodies, unheard, unsaid
from persem_ros.inputs.sync.track import seconds

if TYPE_CHECKING:
    from persem_ros.inputs.sync.poses import PoseBuffer
    from persem_ros.inputs.sync.track import Track

LATCHED = '{history: keep_last, depth: 10, reliability: reliable, durability: transient_local}'
CLOCKS = 0.5            # s between a frame and the poses that clocks may be to blame for


def mount_sentence(poses: PoseBuffer, frame: str, setting: str = 'camera.frame') -> str:
    """
    Return the sentence that says what NO_MOUNT or UNSAID lacks for images in *frame*.

    *setting* is the one that names the frame of the images where they do not.

    """
    if unsaid(poses, frame):
        body = bodies(poses, frame)[0]
        return (f'the poses do not say what they place, the camera {frame!r} or {body!r}, on '
                f'which it is mounted: --set pose.child_frame={body} if they place '
                f'the body, --set pose.child_frame={frame} if the camera')
    if unheard(poses, frame):
        return (f'the poses do not say what they place, the camera {frame!r} or what carries it'
                f'{_unheard(poses)}; --set pose.child_frame={frame or "NAME"} if the poses place '
                'the camera itself')
    if not frame:
        leaves = sorted(poses.tree.static.keys() - {up for up, _ in poses.tree.static.values()})
        flags = ' or '.join(f'--set {setting}={name}' for name in leaves)
        return (f'the poses place the frame {poses.child!r}, and the images name no frame '
                f'(header.frame_id is empty); {flags or f"--set {setting}=NAME"} names it, '
                'or --set pose.extrinsic=[x,y,z,qx,qy,qz,qw] gives the mounting')
    return (f'the poses place the frame {poses.child!r}, the images are in {frame!r}, and '
            f'/tf_static ({_static_edges(poses)}) does not connect them; give the mounting '
            'with --set pose.extrinsic=[x,y,z,qx,qy,qz,qw], or --set '
            f'pose.child_frame={frame} if the poses place the camera itself{_unheard(poses)}')


def other_frame_sentence(poses: PoseBuffer) -> str:
    """Return the sentence that says what OTHER_FRAME lacks."""
    parent = poses.poses.parent if poses.poses else ''
    return (f'the poses are in the frame {parent!r}, the map is in {poses.map_frame!r}, and '
            f'/tf ({poses.tree.edges()}) does not connect them; start what publishes '
            f'{poses.map_frame} -> {parent}, or map in that frame: --set frames.map={parent}')


def explain(poses: PoseBuffer, stamp: int, frame: str) -> str:
    """Return the sentence that says why *frame* has no pose at *stamp*."""
    target = frame
    if poses.settings.source != 'tf':
        if poses.poses is None:
            return 'the pose topic has no pose that can be used'
        if poses.pose_at(stamp).T is None:
            return _explain_topic(poses, stamp)
        target = poses.poses.parent
        for track, child in poses.tree.links(poses.child, frame):
            if poses.tree.at(child, stamp, track.parent).T is None:
                return _explain_link(poses, stamp, track, child)
    for track, child in poses.tree.links(poses.map_frame, target):
        if poses.tree.at(child, stamp, track.parent).T is None:
            other = '' if poses.settings.source == 'tf' else \
                f'; --set frames.map={target} maps in the frame of the poses'
            return _explain_link(poses, stamp, track, child) + other
    return (f'at {seconds(stamp)} /tf gives no chain from {poses.map_frame!r} to {target!r}: '
            f'{poses.tree.edges()}{_unheard(poses)}')


def _unheard(poses: PoseBuffer) -> str:
    """Return who publishes /tf_static and was not heard, and what to type; '' for nobody."""
    if not poses.unheard:
        return ''
    return (f'; {poses.unheard} publishes /tf_static volatile, which reaches only who listens '
            'already, and nothing of it has come: start that after the node (ros2 bag play '
            f"--delay 3), or latched: echo '/tf_static: {LATCHED}' > latched.yaml and ros2 bag "
            'play --qos-profile-overrides-path latched.yaml')


def _explain_topic(poses: PoseBuffer, stamp: int) -> str:
    """Return why the pose topic has nothing at *stamp*."""
    assert poses.poses is not None and poses.heard is not None
    first, last = poses.heard
    if first <= stamp <= last:
        return f'a frame is at {seconds(stamp)}, {_between(poses, poses.poses, stamp)}'
    return (f'a frame is at {seconds(stamp)}, the poses run from {seconds(first)} to '
            f'{seconds(last)}{_apart(stamp, first, last)}')


def _explain_link(poses: PoseBuffer, stamp: int, track: Track, child: str) -> str:
    """Return why a moving link of /tf has nothing at *stamp*."""
    first, last = track.stamps[0], track.stamps[-1]
    link = f'the transform {track.parent} -> {child} of /tf'
    hold = f'--set pose.hold={child} holds the newest one' \
        if child not in poses.settings.hold else 'nothing is held before the first one'
    if len(track.stamps) == 1:
        return (f'at {seconds(stamp)} {link} has one sample only, of {seconds(first)}, '
                f'{abs(stamp - first) / 1e9:.2f} s {"after" if first > stamp else "before"} '
                f'the image: {hold}')
    if first <= stamp <= last:
        return (f'at {seconds(stamp)} {link}: {_between(poses, track, stamp)}, or {hold}')
    late = f'; if it is only sent so rarely: {hold}' if stamp > last else ''
    return (f'a frame is at {seconds(stamp)}, {link} runs from {seconds(first)} to '
            f'{seconds(last)}{_apart(stamp, first, last)}{late}')


def _between(poses: PoseBuffer, track: Track, stamp: int) -> str:
    """Return why two samples of a track around *stamp* are not interpolated."""
    i = min(max(bisect_left(track.stamps, stamp), 1), len(track.stamps) - 1)
    gap = (track.stamps[i] - track.stamps[i - 1]) / 1e9
    if gap > poses.settings.max_gap:
        return (f'a gap of {gap:.2f} s is wider than pose.max_gap '
                f'({poses.settings.max_gap:g} s): --set pose.max_gap={1.2 * gap:.1f} '
                'bridges it')
    way = float(np.hypot.reduce(track.transforms[i][:3, 3] - track.transforms[i - 1][:3, 3]))
    return (f'the poses go {way:.4g} m in {gap:.3g} s, faster than pose.max_speed '
            f'({poses.settings.max_speed:g} m/s): a jump (relocalisation, loop closure) is '
            'not interpolated; topics.trajectory takes corrected poses, --set '
            f'pose.max_speed={1.2 * way / gap if gap else 0:.3g} if they are right')


def _static_edges(poses: PoseBuffer) -> str:
    return ', '.join(f'{up} -> {child}' for child, (up, _) in poses.tree.static.items()) \
        or 'empty'


def _apart(stamp: int, first: int, last: int) -> str:
    """Return how far *stamp* lies outside of *first* to *last*, and what to do about it."""
    away = max(stamp - last, first - stamp) / 1e9
    text = f': the newest is {away:.2f} s older than the image' if stamp > last else \
        f': the oldest is {away:.2f} s newer than the image'
    if away < CLOCKS:
        return f'{text}, and nothing is extrapolated'
    late = ', or do poses come later than sync.max_wait' if stamp > last else ''
    return f'{text}; do the clocks differ (chrony, PTP, use_sim_time everywhere){late}?'
