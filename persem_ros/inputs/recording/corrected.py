"""What a corrected trajectory says of the poses in a recording (spec section 10)."""

from __future__ import annotations

from collections.abc import Sequence
import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.core.trajectory import Correction, Trajectory
from persem_ros.errors import PersemError
from persem_ros.guard.words import short
from persem_ros.inputs.decode import messages, pose_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording import finding
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.inputs.trajectory import from_path, from_tum, PATH

if TYPE_CHECKING:
    from persem_ros.inputs.recording.recording import Recording

log = logging.getLogger(__name__)
EVER = 1e9      # s that poses are kept


def load(path: str | Path, map_frame: str) -> Trajectory:
    """
    Return the Trajectory in a TUM file, or in a recording that has one path (BAG:/topic: which).

    Raises
    ------
    PersemError
        Where there is none, or it cannot be used.

    """
    name, topic = str(path), ''
    if not Path(name).exists() and ':/' in name:
        name, _, topic = name.rpartition(':/')
        topic = f'/{topic}'
    if not (Path(name).is_dir() or finding.is_stored(Path(name))):
        return from_tum(path)
    with Source(name) as source:
        there = [t.name for t in source.topics if t.msgtype == PATH and t.count]
        chosen = [t for t in there if t == topic] if topic else there
        if len(chosen) != 1:
            listed = ' or '.join(f'{name}:{t}' for t in there) or 'none is there'
            raise PersemError(f'{path}: expected a recording with one topic of type {PATH} '
                              f'({listed})')
        found = last_path(source, chosen[0], map_frame)
        assert found is not None
        return found


def last_path(source: Source, topic: str, map_frame: str) -> Trajectory | None:
    """Return the Trajectory in the last message of a topic, None where it has none."""
    last = None
    for _, kind, _, data in source.messages({topic}):
        last = kind, data
    if last is None:
        return None
    try:
        return from_path(source.decode(last[1], last[0]), map_frame, topic)
    except BadMessage as fault:
        raise PersemError(f'{source.path}: {topic}: {fault}') from None


def named(recording: Recording) -> Trajectory | None:
    """Return the Trajectory on topics.trajectory, None where there is no such topic."""
    wanted = recording.config.topics.trajectory.strip('/')
    if not wanted:
        return None
    there = [t for t in recording.source.topics if t.msgtype == PATH and t.count]
    fitting = [t for t in there if t.name.strip('/') == wanted] or \
        [t for t in there if t.name.endswith(f'/{wanted}')]
    if len(fitting) != 1:
        others = ', '.join(t.name for t in there) or 'none'
        recording.note('trajectory', f'no path on topics.trajectory {short(wanted)}, poses are '
                       f'taken as recorded; topics of type {PATH}: {others}')
        return None
    return last_path(recording.source, fitting[0].name, recording.config.frames.map)


def correct(recording: Recording, trajectory: Trajectory) -> str:
    """
    Have a recording give its frames by corrected poses; return what that did, in a sentence.

    Between the trajectory's stamps its correction is interpolated, not its poses: what was flown
    between two keyframes stays as it was recorded.

    Raises
    ------
    PersemError
        Where the trajectory is of another time.

    """
    far, count = 0.0, 0
    for camera in recording.topics:
        buffer, frame = _poses(recording, camera), _frame(recording, camera)
        stamps = buffer.span(frame)
        if stamps is None:
            raise PersemError(f'{recording.path} has no poses that could be corrected')
        trajectory.check(*stamps, f'the poses of {recording.name}')
        found = [(k, T) for k, T in enumerate(
            buffer.body(int(at), frame).T for at in trajectory.stamps) if T is not None]
        if not found:
            raise PersemError(f'{trajectory.name}: no pose lies between two of {recording.name} '
                              'that are within pose.max_gap and pose.max_speed')
        rows = [k for k, _ in found]
        placed = np.stack([T for _, T in found])
        recording.corrections[camera] = Correction(
            trajectory.stamps[rows], trajectory.poses[rows], placed, recording.config.map.origin)
        away = np.linalg.norm(trajectory.poses[rows, :3, 3] - placed[:, :3, 3], axis=1)
        far, count = max(far, float(away.max())), len(rows)
    return (f'{trajectory.name}: {count} poses correct those of {recording.name}, by up to '
            f'{far:.3g} m')


def correct_all(recordings: Sequence[Recording], trajectory: Trajectory | None) -> None:
    """Have recordings give their frames by corrected poses, where there are any."""
    if trajectory is None:
        for recording in recordings:
            own = named(recording)
            if own is not None:
                log.info('%s', correct(recording, own))
        return
    errors = []
    for recording in recordings:
        try:
            log.info('%s', correct(recording, trajectory))
        except PersemError as error:
            errors.append(error)
    if len(errors) == len(recordings):
        raise errors[0]


def _poses(recording: Recording, camera: str) -> PoseBuffer:
    """Return all poses and transforms of a camera."""
    buffer = PoseBuffer(recording.config, EVER, recording.knows_map(camera))
    for transform in recording.statics_of(camera):
        buffer.add_static(*transform)
    chosen, moving = recording.topics[camera], recording.choice.tf_of(camera)
    names = {t.name for t in moving} if 'pose' not in chosen or recording.needs_tf(camera) \
        else set()
    if 'pose' in chosen:
        names.add(chosen['pose'].name)
    for topic, kind, _, data in recording.source.messages(names):
        try:
            msg = recording.source.decode(data, kind)
            if 'pose' in chosen and topic == chosen['pose'].name:
                buffer.add(*pose_messages.pose(msg))
            else:
                for found in pose_messages.transforms(msg)[0]:
                    buffer.add_tf(*found)
        except BadMessage:
            continue        # a reading counts it
    return buffer


def _frame(recording: Recording, camera: str) -> str:
    """Return the frame of a camera's images."""
    return recording.config.camera.frame or _first_frame(recording, recording.topics[camera])


def _first_frame(recording: Recording, chosen: dict[str, Any]) -> str:
    """Return the frame that the first depth (or labels) message is in."""
    name = chosen['depth' if 'depth' in chosen else 'labels'].name
    for _, _, _, data in recording.source.messages({name}):
        return messages.header(data)[1]
    return ''
