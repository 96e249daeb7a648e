"""What of a camera's place is on /tf: what ties poses to the map, and what carries the camera."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from persem_ros.inputs.decode import messages, pose_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording.first_messages import first_messages, links
from persem_ros.inputs.sync.mount import fixed
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.settings.config import frame_of

if TYPE_CHECKING:
    from persem_ros.inputs.recording.recording import Recording


def knows_map(recording: Recording, camera: str) -> bool:
    """
    Return whether poses in another frame than frames.map are tied to it by transforms.

    Then frames from before the first of these (a localisation that came late) have no place.

    """
    parent, target = _parent(recording, camera), recording.config.frames.map
    names = {t.name for t in (*recording.choice.tf_of(camera),
                              *recording.choice.tf_static_of(camera))}
    return parent not in ('', target) and any(
        target in (up, child) for up, child in links(recording.source, names))


def _parent(recording: Recording, camera: str) -> str:
    """Return the frame that a camera's poses are in, '' where none is said."""
    chosen = recording.topics[camera]
    firsts = first_messages(recording.source, {chosen['pose'].name}) if 'pose' in chosen else {}
    with suppress(BadMessage):
        return next((pose_messages.pose(msg)[2] for msg in firsts.values()), '')
    return ''


def carried(recording: Recording, camera: str) -> bool:
    """Return whether a camera moves on the body that its pose topic places (a gimbal)."""
    chosen, config = recording.topics[camera], recording.config
    names = {chosen[kind].name for kind in ('pose', 'depth') if kind in chosen}
    firsts = first_messages(recording.source, names)
    if len(names) < 2 or len(firsts) < 2 or not recording.choice.tf_of(camera):
        return False
    frame = frame_of(config, camera) or messages.frame_id(firsts[chosen['depth'].name]) \
        or messages.frame_id(recording.infos[chosen['camera_info'].name])
    poses = PoseBuffer(config)
    for transform in recording.statics_of(camera):
        poses.add_static(*transform)
    try:
        poses.add(*pose_messages.pose(firsts[chosen['pose'].name]))
    except BadMessage:
        return False
    return not fixed(poses, frame)
