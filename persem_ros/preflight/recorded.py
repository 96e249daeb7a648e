"""The sample of a recording: one pass that decodes no image, and depth on demand."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.inputs import names
from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.decode import messages, pose_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording import latched
from persem_ros.inputs.recording.first_messages import first_messages
from persem_ros.inputs.recording.kinds import INFO, POINTS
from persem_ros.inputs.recording.source import Head, Source, TopicInfo
from persem_ros.inputs.recording.stamps import stamp_of
from persem_ros.inputs.recording.topics import Choice
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.preflight.depth_fit import measured
from persem_ros.preflight.sample import Sample, Shot, View
from persem_ros.settings.config import Config, frame_of
from persem_ros.settings.legend_files import load_legend

FIRSTS = 3              # messages of a role that are decoded to judge it
FOREVER = 1e9           # s
TREE = 100              # messages of a topic with transforms that tell its frames
MOST = 200_000          # messages of a long recording that are looked at
HEADS = 'heads'         # the role of those that keep the heads of a topic's messages
IMAGES = ('labels', 'depth', 'camera_info', 'confidence', 'depth_confidence')
POSE, TF = 'pose', 'tf'


def sample(source: Source, choice: Choice, config: Config) -> Sample:
    """
    Look at a recording.

    Parameters
    ----------
    source : Source
        The open recording.
    choice : Choice
        Its topics, complete.
    config : Config
        The settings.

    """
    once = latched.read(source, choice)
    given = config.labels.legend
    classes = names.filled(config, load_legend(given) if given else None, once.tables)
    own = names.filled(config, None, once.tables).legend if classes.changes else classes.legend
    roles: dict[str, list[tuple[str, Any]]] = {}
    found = {}
    for name, chosen in choice.cameras.items():
        poses = PoseBuffer(config, FOREVER)
        for transform in once.of(choice.tf_static_of(name)):
            poses.add_static(*transform)
        heads: dict[str, list[tuple[int, Head]]] = {role: [] for role in (*IMAGES, POSE)}
        found[name] = heads, poses
        for role in [role for role in IMAGES if role in chosen]:
            roles.setdefault(chosen[role].name, []).append((HEADS, heads[role]))
        tf = choice.tf_of(name)
        if POSE in chosen:
            roles.setdefault(chosen[POSE].name, []).extend(((HEADS, heads[POSE]), (POSE, poses)))
            tf = tf if _moves(source, config, name, chosen, poses) else []
        for topic in tf:
            roles.setdefault(topic.name, []).append((TF, poses))
    _read(source, roles)
    views = [_view(source, name, chosen, *found[name])
             for name, chosen in choice.cameras.items()]
    trees = {name: _trees(source, choice.tf_of(name), choice.tf_static_of(name))
             for name in choice.cameras}
    infos = _infos(source)
    return Sample(config, views, legend=classes.legend, own_legend=own, tf=trees,
                  info_frames={name: messages.frame_id(msg) for name, msg in infos.items()},
                  stereo={name: -float(msg.p[3]) for name, msg in infos.items() if msg.p[3] < 0})


def _moves(source: Source, config: Config, camera: str, chosen: Mapping[str, TopicInfo],
           statics: PoseBuffer) -> bool:
    """Return whether static transforms do not lead from map to poses, or from these to images."""
    image = chosen.get('depth', chosen['labels']).name
    firsts = first_messages(source, {chosen[POSE].name, image})
    if len(firsts) < 2:
        return False
    try:
        _, _, parent, child = pose_messages.pose(firsts[chosen[POSE].name])
    except BadMessage:
        return True
    frame = frame_of(config, camera) or messages.frame_id(firsts[image])
    child = statics.child or child
    if parent not in ('', config.frames.map):
        return True
    return not child or child != frame and not statics.tree.connected(child, frame, False)


def _trees(source: Source, *topics: Iterable[TopicInfo]) -> dict[str, set[str]]:
    """Return the frames that a few transforms of each robot's topics name, by namespace."""
    found: dict[str, set[str]] = {}
    for topic in (topic for group in topics for topic in group):
        frames = found.setdefault(topic.name.rpartition('/')[0], set())
        for _, kind, _, data in islice(source.messages({topic.name}), TREE):
            with suppress(BadMessage):
                for _, _, parent, child in pose_messages.transforms(source.decode(data, kind))[0]:
                    frames |= {parent, child}
    return found


def _read(source: Source, roles: Mapping[str, list[tuple[str, Any]]]) -> None:
    """Fill the lists of Heads with stamps and the buffers of *roles* {topic: [(role, taker)]}."""
    for head in islice(source.heads(set(roles)), MOST):
        data = b''
        for role, taker in roles[head.topic]:
            try:
                if role == HEADS:
                    stamp = stamp_of(head.msgtype, head.start)
                    if stamp is not None:
                        taker.append((stamp, head))
                    continue
                data = data or source.read(head.file, head.place)
                if role == POSE:
                    taker.add(*pose_messages.pose(source.decode(data, head.msgtype)))
                    continue
                for found in pose_messages.transforms(source.decode(data, head.msgtype))[0]:
                    taker.add_tf(*found)
            except BadMessage:      # the reading counts them
                continue


def _view(source: Source, name: str, chosen: Mapping[str, TopicInfo],
          found: Mapping[str, list[tuple[int, Head]]], poses: PoseBuffer) -> View:
    firsts = {role: list(_some(source, rows)) for role, rows in found.items()}

    def shots(stamps: Iterable[int], config: Config) -> dict[int, Shot]:
        wanted = set(stamps)
        if 'depth' not in chosen or chosen['depth'].msgtype == POINTS:
            return {}
        return _shots(source, config, firsts['camera_info'],
                      [row for row in found['depth'] if row[0] in wanted])

    def within(role: str, kept: NDArray[np.bool_]) -> list[Any]:
        return list(_some(source, [row for row, keep in zip(found[role], kept) if keep]))

    return View(name, {role: topic.name for role, topic in chosen.items()}, firsts,
                {role: np.array([stamp for stamp, _ in rows], np.int64)
                 for role, rows in found.items()},
                {role: np.array([head.time for _, head in rows], np.int64)
                 for role, rows in found.items()}, poses, shots, within)


def _some(source: Source, rows: list[tuple[int, Head]]) -> Iterator[Any]:
    """Yield the first messages and one of the middle: a camera may have to warm up."""
    for _, head in rows[:FIRSTS] + rows[max(FIRSTS, len(rows) // 2):][:1]:
        try:
            yield source.decode(source.read(head.file, head.place), head.msgtype)
        except BadMessage:
            continue


def _infos(source: Source) -> dict[str, Any]:
    """Return the first camera info of every topic that has one."""
    names = {topic.name for topic in source.topics if topic.msgtype == INFO and topic.count}
    return first_messages(source, names)


def _shots(source: Source, config: Config, infos: list[Any],
           wanted: list[tuple[int, Head]]) -> dict[int, Shot]:
    """Return the depth images of some messages, those of them that can be read."""
    found = {}
    assembler = Assembler(config)
    for info in infos:
        with suppress(BadMessage):
            assembler.add_info(info)
    for stamp, head in wanted:
        with suppress(BadMessage):
            depth, view = assembler.seen(source.decode(source.read(head.file, head.place),
                                                       head.msgtype))
            found[stamp] = Shot(measured(depth), view)
    return found
