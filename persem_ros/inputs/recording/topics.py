"""Which topics of a recording are used; where one is missing, what to type instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from shlex import quote
from typing import TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.inputs.decode import legends, messages
from persem_ros.inputs.recording.candidates import Candidates, SHOWN
from persem_ros.inputs.recording.first_messages import first_messages
from persem_ros.inputs.recording.kinds import (
    IMAGE, INFO, LABELS_INFO, NEEDED, OPTIONAL, roles_of, TF)
from persem_ros.settings.config import Labels, NO_TABLE, Topics, topics_of

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source, TopicInfo
    from persem_ros.settings.config import Config

TRANSPORTS = ('compressed', 'compressedDepth')


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
        self._candidates = Candidates(source, config.pose.type)
        filled = [topic for topic in source.topics if topic.count]
        self._topics = self._candidates.topics
        self.tf = [t for t in filled if t.msgtype == TF and t.name.rpartition('/')[2] == 'tf']
        self.tf_static = [t for t in filled
                          if t.msgtype == TF and t.name.rpartition('/')[2] == 'tf_static']
        self.legends = _legends(filled, config.labels.topic)
        self._tf = config.topics.tf and f'/{config.topics.tf.strip("/")}'
        self.problems: list[str] = []
        self.cameras = {name: self._camera(config, name)
                        for name in [n for n in config.cameras if n] or ['']}
        self._refuse_names(config.labels.topic, filled)

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
            self.problems.append(problem + self._flags(
                (kind,), prefix, tuple(chosen.values()), self._other_way(config, kind, prefix)))
        self._refuse_twice(chosen, prefix, topics)
        if LABELS_INFO in roles and not missing:
            self._other_camera(topics, chosen)
        return chosen

    def _other_way(self, config: Config, kind: str, prefix: str) -> str:
        """Return the flags that take what is missing from somewhere else, '' where none do."""
        if kind == 'pose' and self.tf:
            return '--set pose.source=tf'
        if kind == 'pose' and config.pose.source == 'tf':
            return '--set pose.source=topic'
        if kind == 'labels' and config.depth.source == 'image':
            return ' or '.join(' '.join(
                f'--set {name}={value}' for name, value in (
                    (f'{prefix}.points', cloud), ('points.label_field', field))
                if value != config.points.label_field)
                for cloud, field in self._candidates.labelled_clouds())
        if kind == 'depth' and config.depth.source == 'image':
            return ' or '.join(f'--set depth.source=cloud --set {prefix}.points={topic.name}'
                               for topic in self._candidates.of('points')[:SHOWN])
        return ''

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

    def _refuse_twice(self, chosen: dict[str, TopicInfo], prefix: str, topics: Topics) -> None:
        """Note the topics that one camera uses for two kinds of images."""
        kinds = [kind for kind in ('depth', 'labels', 'truth', 'color') if kind in chosen]
        for i, kind in enumerate(kinds):
            for other in kinds[:i]:
                if chosen[kind] == chosen[other]:
                    typed = [one for one in (other, kind)
                             if not getattr(topics, one).endswith(getattr(Topics(), one))]
                    flags = self._flags(typed or (other, kind), prefix, tuple(chosen.values()))
                    self.problems.append(f'{prefix}.{other} and {prefix}.{kind} are the same '
                                         f'topic, {chosen[kind].name}{flags}')

    def _refuse_names(self, wanted: str, filled: list[TopicInfo]) -> None:
        """Note a topic of class names that was typed and is none."""
        usual = Labels().topic
        if wanted in ('', NO_TABLE, usual) or any(_called(t, wanted) for t in self.legends):
            return
        exact = [t for t in self._topics if t.name.strip('/') == wanted.strip('/')]
        why = '' if not exact else ', which has no messages' \
            if exact[0].msgtype in legends.TYPES else f', which is of type {exact[0].msgtype}'
        flags = ' or '.join(f'--set labels.topic={t.name}' for t in _legends(filled, usual)) or \
            f'no other topic of that kind is there; without names: --set labels.topic={NO_TABLE}'
        self.problems.append(f'no names of classes on {wanted!r}{why} ({flags})')

    def _find(self, kind: str, wanted: str) -> TopicInfo:
        """Return the topic for *wanted*; LookupError with what stands in the way."""
        types = self._candidates.types(kind)
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
                 for t in self._candidates.of(kind, taken)[:SHOWN]]
        flags = flags + [extra] if extra else flags
        if flags:
            return f' ({" or ".join(flags)})'
        other = 'other ' if any(map(self._candidates.of, kinds)) else ''
        beside = f'; recorded later: {quote(str(self._source.path))}+OTHER' \
            if {'camera_info', 'labels'} & set(kinds) else ''
        return f' (no {other}topic of that kind is there{beside})'


def _legends(topics: list[TopicInfo], wanted: str) -> list[TopicInfo]:
    """Return the topic with class names, [] where there is none: one, for two may contradict."""
    if wanted == NO_TABLE:
        return []
    fitting = [t for t in topics if t.msgtype in legends.TYPES]
    ways: tuple[Callable[[TopicInfo], bool], ...] = (
            lambda t: t.name.strip('/') == wanted.strip('/'),
            lambda t: _called(t, wanted),
            lambda t: t.msgtype == legends.LABEL_INFO,
            lambda t: t.name.endswith('legend'),
            lambda t: t.name.endswith(('semantic_labels', 'label_info', '/labels')))
    return next(([t] for way in ways for t in fitting if way(t)), [])


def _called(topic: TopicInfo, wanted: str) -> bool:
    """Return whether a topic has the name that is wanted, in whatever namespace."""
    return f'/{topic.name}'.endswith('/' + wanted.strip('/'))
