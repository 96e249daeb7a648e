"""Which topics of a recording are used; where one is missing, what to type instead."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
import re
from shlex import quote
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.inputs.decode import clouds, image_messages, legends, messages, pose_messages, px4
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.settings.config import NO_TABLE, Topics, topics_of

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source, TopicInfo
    from persem_ros.settings.config import Config

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
DISPARITY = 'stereo_msgs/msg/DisparityImage'
INFO = 'sensor_msgs/msg/CameraInfo'
TF = 'tf2_msgs/msg/TFMessage'
POSES = {'PoseStamped': 'geometry_msgs/msg/PoseStamped',
         'PoseWithCovarianceStamped': 'geometry_msgs/msg/PoseWithCovarianceStamped',
         'Odometry': 'nav_msgs/msg/Odometry',
         'TransformStamped': 'geometry_msgs/msg/TransformStamped',
         'VehicleOdometry': px4.TYPE}
NEEDED = {'labels': 'label images', 'depth': 'depth images', 'camera_info': 'camera infos',
          'pose': 'poses'}
OPTIONAL = {'truth': 'true label images', 'color': 'colour images',
            'confidence': 'confidence images', 'depth_confidence': 'depth confidence images',
            'points': 'point clouds', 'labels_info': "camera infos of the labels' own camera"}
LABELS_INFO, POINTS = 'labels_info', clouds.TYPE
TRANSPORTS = ('compressed', 'compressedDepth')
# Colour images are offered as labels where their topic's name says so and none holds ids.
NAMED = re.compile('label|segment|semantic|class|mask|annot', re.IGNORECASE)
SHOWN = 6           # candidates in one refusal
TRIED = 10          # messages of a topic that are decoded to find a good one


class Choice:
    """
    The topics that a configuration takes from a source.

    Parameters
    ----------
    source : Source
        The open recording.
    config : Config
        The settings topics.*, cameras.*, pose.source and pose.type.

    Attributes
    ----------
    cameras : dict
        Topics by camera and kind; the camera is '' where there is only one.
    tf, tf_static, legends : list
        Topics with transforms and legends.
    problems : list
        What is missing, each with the flags that would help; empty: the choice is complete.

    """

    def __init__(self, source: Source, config: Config) -> None:
        """Match the settings with what is there."""
        self._source = source
        self._encodings: dict[str, str] | None = None
        filled = [topic for topic in source.topics if topic.count]
        self._topics = filled + [topic for topic in source.topics if not topic.count]
        self._pose_types = (POSES[config.pose.type],) if config.pose.type in POSES \
            else tuple(POSES.values())
        self.tf = [t for t in filled if t.msgtype == TF and t.name.rpartition('/')[2] == 'tf']
        self.tf_static = [t for t in filled
                          if t.msgtype == TF and t.name.rpartition('/')[2] == 'tf_static']
        self.legends = _legends(filled, config.labels.topic)
        self._tf = config.topics.tf and f'/{config.topics.tf.strip("/")}'
        self.problems: list[str] = []
        self.cameras = {name: self._camera(config, name)
                        for name in [n for n in config.cameras if n] or ['']}

    def tf_of(self, camera: str) -> list[TopicInfo]:
        """Return the topics with moving transforms of the robot that carries a camera."""
        return self._of_robot(self.tf, camera)

    def tf_static_of(self, camera: str) -> list[TopicInfo]:
        """Return the topics with static transforms of the robot that carries a camera."""
        return self._of_robot(self.tf_static, camera)

    def _of_robot(self, topics: list[TopicInfo], camera: str) -> list[TopicInfo]:
        """Return those of *topics* that lie in the namespace of a camera or above, else all."""
        if self._tf:
            tail = topics[0].name.rpartition('/')[2] if topics else ''
            return [t for t in topics if t.name == self._tf + tail.removeprefix('tf')]
        chosen = self.cameras[camera]
        images = [chosen[kind].name for kind in ('labels', 'depth') if kind in chosen]
        own = [t for t in topics for image in images
               if image.startswith(t.name.rpartition('/')[0] + '/')]
        named = [t for t in own if t.name.count('/') > 1]
        if named:       # the robot's own; what is outside of all namespaces joins them
            deepest = max(t.name.count('/') for t in named)
            own = [t for t in own if t.name.count('/') in (1, deepest)]
        return list(dict.fromkeys(own or topics))

    def check(self) -> None:
        """Refuse a choice with something missing."""
        if self.problems:
            path = self._source.path
            raise PersemError(f'{path}: {"; ".join(self.problems)}; "persem info '
                              f'{quote(str(path))}" lists all topics')

    def candidates(self, kind: str, taken: Sequence[TopicInfo] = ()) -> list[TopicInfo]:
        """Return the topics that could serve as *kind*, the likely ones first; none of *taken*."""
        fitting = [t for t in self._topics if t.msgtype in self._types(kind) and t not in taken]
        if kind not in ('labels', 'depth', 'truth'):
            return fitting
        known = image_messages.DEPTH if kind == 'depth' else image_messages.LABELS
        encodings = self.encodings()
        painted = [t for t in fitting if kind != 'depth' and t.count and NAMED.search(t.name)
                   and encodings.get(t.name) in image_messages.COLOR]
        fitting = [t for t in fitting if _encodes(encodings.get(t.name, ''), kind, known)] \
            or painted
        if kind != 'depth':     # 16UC1 may be either; nobody calls labels so
            fitting = [t for t in fitting if 'depth' not in t.name.lower()]
        return sorted(fitting, key=lambda t: ('depth' in t.name.lower()) != (kind == 'depth'))

    def encodings(self) -> dict[str, str]:
        """Return the encoding or format of the first message of every image topic, by name."""
        if self._encodings is None:
            self._encodings = {}
            wanted = {t.name for t in self._topics if t.msgtype in (IMAGE, COMPRESSED) and t.count}
            for name, msg in first_messages(self._source, wanted).items():
                self._encodings[name] = getattr(msg, 'encoding', '') or getattr(msg, 'format', '')
        return self._encodings

    def _labelled_clouds(self) -> list[tuple[str, str]]:
        """Return (topic, field with ids) of clouds whose points have labels."""
        clouds_there = {t.name for t in self._topics if t.msgtype == POINTS and t.count}
        found = []
        for name, msg in first_messages(self._source, clouds_there).items():
            with suppress(BadMessage):
                dtype = clouds.structured(msg).dtype
                found += [(name, field) for field in dtype.names or ()
                          if dtype[field].kind in 'iu' and NAMED.search(field)][:1]
        return found[:SHOWN]

    def _camera(self, config: Config, camera: str) -> dict[str, TopicInfo]:
        topics = topics_of(config, camera)
        prefix = f'cameras.{camera}.topics' if camera else 'topics'
        chosen: dict[str, TopicInfo] = {}
        missing: dict[str, str] = {}
        roles = roles_of(config, topics)
        for kind, role in roles.items():
            wanted = getattr(topics, role)
            if kind == LABELS_INFO or not wanted and kind not in NEEDED:
                continue
            if kind == 'pose' and config.pose.source == 'tf':
                if not self.tf:
                    missing[kind] = 'no /tf, which pose.source=tf needs'
                continue
            try:
                chosen[kind] = self._labels_info(wanted, topics, chosen.get('labels')) \
                    if role == LABELS_INFO else self._find(role, wanted)
            except LookupError as error:
                # The default of an optional topic may be missing; a name that was typed may not.
                usual = getattr(Topics(), role)
                if kind in NEEDED or not usual or not wanted.endswith(usual):
                    missing[role] = f'no {(NEEDED | OPTIONAL)[role]} on {wanted!r}{error}'
        # What is offered depends on what the other kinds have, so it comes last.
        for kind, problem in missing.items():
            extra = ''
            if kind == 'pose' and self.tf:
                extra = '--set pose.source=tf'
            elif kind == 'pose' and config.pose.source == 'tf':
                extra = '--set pose.source=topic'
            elif kind == 'labels' and config.depth.source == 'image':
                extra = ' or '.join(' '.join(
                    f'--set {name}={value}' for name, value in (
                        (f'{prefix}.points', cloud), ('points.label_field', field))
                    if value != config.points.label_field)
                    for cloud, field in self._labelled_clouds())
            elif kind == 'depth' and config.depth.source == 'image':
                extra = ' or '.join(f'--set depth.source=cloud --set {prefix}.points={topic.name}'
                                    for topic in self.candidates('points')[:SHOWN])
            flags = self._flags((kind,), prefix, tuple(chosen.values()), extra)
            self.problems.append(problem + flags)
        self._refuse_twice(chosen, prefix)
        if LABELS_INFO in roles and not missing:
            self._other_camera(topics, chosen)
        return chosen

    def _other_camera(self, topics: Topics, chosen: dict[str, TopicInfo]) -> None:
        """Add the labels' own camera info where the labels are in another frame than the depth."""
        names = {chosen[kind].name for kind in ('labels', 'depth')}
        frames = {name: messages.frame_id(msg)
                  for name, msg in first_messages(self._source, names).items()}
        labels, depth = (frames.get(chosen[kind].name, '') for kind in ('labels', 'depth'))
        if labels and depth and labels != depth:
            with suppress(LookupError):
                chosen[LABELS_INFO] = self._labels_info(topics.labels_info, topics,
                                                        chosen['labels'])

    def _labels_info(self, wanted: str, topics: Topics, labels: TopicInfo | None) -> TopicInfo:
        """
        Return the topic with the intrinsics of the label images; LookupError where none is.

        The one that is named, or camera_info beside or above the label topic, or that of another
        topic in the labels' frame: a segmenter seldom publishes the info of its input again.

        """
        with suppress(LookupError):
            return self._find(LABELS_INFO, wanted)
        usual = Topics().labels_info
        if labels is None or wanted != usual and not wanted.endswith(f'/{usual}'):
            return self._find(LABELS_INFO, wanted)      # a name that was typed
        infos = {t.name: t for t in self._topics if t.msgtype == INFO and t.count}
        above = labels.name
        while '/' in above:
            for name in (f'{above}/camera_info', f'{above.rpartition("/")[0]}/camera_info'):
                if name in infos and not name.endswith(topics.camera_info):
                    return infos[name]
            above = above.rpartition('/')[0]
        firsts = first_messages(self._source, {labels.name, *infos})
        frame = messages.frame_id(firsts[labels.name]) if labels.name in firsts else ''
        for name, info in infos.items():
            if frame and name in firsts and messages.frame_id(firsts[name]) == frame:
                return info
        return self._find(LABELS_INFO, wanted)

    def _refuse_twice(self, chosen: dict[str, TopicInfo], prefix: str) -> None:
        """Note the topics that one camera uses for two kinds of images."""
        kinds = [kind for kind in ('depth', 'labels', 'truth', 'color') if kind in chosen]
        for i, kind in enumerate(kinds):
            for other in kinds[:i]:
                if chosen[kind] == chosen[other]:
                    flags = self._flags((other, kind), prefix, tuple(chosen.values()))
                    self.problems.append(f'{prefix}.{other} and {prefix}.{kind} are the same '
                                         f'topic, {chosen[kind].name}{flags}')

    def _types(self, kind: str) -> tuple[str, ...]:
        if kind == 'pose':
            return self._pose_types
        if kind == 'points':
            return (POINTS,)
        if kind == 'depth':
            return IMAGE, COMPRESSED, DISPARITY
        return (INFO,) if kind in ('camera_info', LABELS_INFO) else (IMAGE, COMPRESSED)

    def _find(self, kind: str, wanted: str) -> TopicInfo:
        """Return the topic for *wanted*; LookupError with what stands in the way."""
        types = self._types(kind)
        tails = [wanted.strip('/')]
        if IMAGE in types:
            tails += [f'{tails[0]}/{transport}' for transport in TRANSPORTS]
        for tail in tails:
            exact = [t for t in self._topics if t.name.strip('/') == tail]
            fitting = [t for t in exact if t.msgtype in types]
            if fitting and fitting[0].count:
                return fitting[0]
            if fitting:
                raise LookupError(', which has no messages')
            if exact:       # the name is taken by something else
                raise LookupError(f', which is of type {exact[0].msgtype}')
        if wanted.startswith('/'):
            raise LookupError()
        for tail in tails:
            below = [t for t in self._topics if t.name.endswith(f'/{tail}') and t.msgtype in types]
            if len(below) == 1:
                return below[0]
            if below:
                raise LookupError(f', which could be any of {len(below)} topics')
        raise LookupError()

    def _flags(
            self, kinds: Sequence[str], prefix: str, taken: Sequence[TopicInfo], extra: str = ''
    ) -> str:
        """Return ' (--set ... or --set ...)' with the candidates for *kinds* but those *taken*."""
        flags = [f'--set {prefix}.{kind}={t.name}' for kind in kinds
                 for t in self.candidates(kind, taken)[:SHOWN]]
        flags = flags + [extra] if extra else flags
        if flags:
            return f' ({" or ".join(flags)})'
        other = 'other ' if any(map(self.candidates, kinds)) else ''
        beside = f'; recorded later: {self._source.path.name}+OTHER' \
            if {'camera_info', 'labels'} & set(kinds) else ''
        return f' (no {other}topic of that kind is there{beside})'


def roles_of(config: Config, topics: Topics) -> dict[str, str]:
    """
    Return what a camera needs or may have: {kind: the setting topics.* that says where}.

    A labelled cloud takes the place of the label images and needs no depth; with
    depth.source=cloud that of the depth images, seen by the camera of the labels.

    """
    if topics.points and config.depth.source == 'image':
        return {'labels': 'points', 'pose': 'pose'}
    roles = {kind: kind for kind in (*NEEDED, *OPTIONAL) if kind not in ('points', LABELS_INFO)}
    if config.depth.source == 'cloud':
        del roles['depth_confidence']
        return {**roles, 'depth': 'points', 'camera_info': LABELS_INFO}
    return {**roles, LABELS_INFO: LABELS_INFO}


def _legends(topics: list[TopicInfo], wanted: str) -> list[TopicInfo]:
    """Return the topic with class names, [] where there is none: one, for two may contradict."""
    if wanted == NO_TABLE:
        return []
    fitting = [t for t in topics if t.msgtype in legends.TYPES]
    ways: tuple[Callable[[TopicInfo], bool], ...] = (
            lambda t: t.name.strip('/') == wanted.strip('/'),
            lambda t: t.name.endswith('/' + wanted.strip('/')),
            lambda t: t.msgtype == legends.LABEL_INFO,
            lambda t: t.name.endswith('legend'),
            lambda t: t.name.endswith(('semantic_labels', 'label_info', '/labels')))
    return next(([t] for way in ways for t in fitting if way(t)), [])


def first_messages(source: Source, names: set[str]) -> dict[str, Any]:
    """Return the first message of each topic in *names* that can be decoded, by name."""
    found: dict[str, Any] = {}
    for name in sorted(names):      # one search each: it ends where the topic begins
        for _, kind, _, data in islice(source.messages({name}), TRIED):
            try:
                found[name] = source.decode(data, kind)
            except BadMessage:
                continue
            break
    return found


def links(source: Source, names: set[str]) -> Iterator[tuple[str, str]]:
    """Yield (parent, child) of the transforms of some topics, as they are recorded."""
    for _, kind, _, data in source.messages(names):
        with suppress(BadMessage):
            for _, _, parent, child in pose_messages.transforms(source.decode(data, kind))[0]:
                yield parent, child


def _encodes(encoding: str, kind: str, known: dict[str, str]) -> bool:
    """Return whether an image encoding or format can serve as labels or depth."""
    if not encoding or 'compressedDepth' in encoding:
        return not encoding or kind == 'depth'
    if 'jpeg' in encoding or 'jpg' in encoding:
        return False
    return encoding in known or 'png' in encoding.lower()
