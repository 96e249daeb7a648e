"""A recording as a stream of frames: what a replay reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard import limits
from persem_ros.inputs import names
from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording import latched, tied
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.inputs.recording.index import Index
from persem_ros.inputs.recording.reading import Reading
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.topics import Choice
from persem_ros.inputs.sync.pairing import UNUSED
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.core.trajectory import Correction
    from persem_ros.frames import Frame
    from persem_ros.inputs.decode.legends import Table
    from persem_ros.inputs.recording.latched import Static
    from persem_ros.settings.config import Config

SHOWN = 6       # classes in a note


class Recording:
    """
    A rosbag2 recording and the topics of it that are used.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder (mcap or sqlite3, compressed or not), or a single .mcap or .db3 file;
        'A+B' is one input in two recordings.
    config : persem_ros.settings.config.Config
        The settings topics.*, cameras.*, pose.*, frames.map, sync.* and camera.*.
    source : Source, optional
        The recording, where it is open already; it is closed with this.
    excerpt : Excerpt
        Which of the frames are used.

    Attributes
    ----------
    path : Path
        The same.
    name : str
        A short name for people.
    topics : dict
        TopicInfo of what is used, by camera ('' where there is only one) and kind.
    dropped : collections.Counter
        Of the last reading: messages that were not used, by reason. Reasons without a colon
        count label images; others start with the kind of message.
    examples : dict
        One whole sentence for reasons that have one.
    said : set
        Notes that the user has read.
    names : persem_ros.inputs.names.Names
        The classes of the map.
    corrections : dict
        What a corrected trajectory says of the poses of a camera (corrected.correct).
    given_legend : persem_ros.settings.legend.Legend or None
        That of labels.legend, or of the map that goes on (then *strict*).

    Raises
    ------
    PersemError
        Not a recording, a topic missing or of the wrong type, an unusable camera info.

    """

    def __init__(
            self, path: Path | str, config: Config, source: Source | None = None,
            excerpt: Excerpt = WHOLE
    ) -> None:
        """Open the recording, choose topics, read static transforms and camera infos."""
        limits.use(config.inputs.max_pixels)
        self.source = source or Source(path)
        self.path, self.name = self.source.path, self.source.name
        self.excerpt = excerpt
        self.config = config
        self.dropped: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        self.said: set[str] = set()
        self.corrections: dict[str, Correction] = {}
        self._notes: dict[str, str] = {}
        self._known: dict[str, bool] = {}       # by camera, what knows_map() says
        self._index: Index | None = None
        self._bounds: tuple[int | None, int | None] | None = None
        try:
            self.choice = Choice(self.source, config)
            self.choice.check()
            self.topics = self.choice.cameras
            self._latched = latched.read(self.source, self.choice)
            self.infos = self._read_infos()
            self.given_legend = load_legend(config.labels.legend) if config.labels.legend else None
            self.strict = False
            self.names = names.filled(config, self.given_legend, self._latched.tables)
            if said := self.names.difference():
                self.note('names', said)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Recording:
        """Return the open recording."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        self.source.close()

    @property
    def notes(self) -> list[str]:
        """Return what the user should know and what did not prevent the use: sentences."""
        return self.source.notes + self._latched.faults + list(self._notes.values())

    @property
    def legend(self) -> Legend:
        """Return that of the map: labels.legend, else the recording's, with all names."""
        return self.names.legend

    @property
    def legend_text(self) -> str:
        """Return the same as YAML, '' where there is none."""
        return self.names.legend.to_yaml()

    @property
    def tables(self) -> list[Table]:
        """Return the tables of class names in the order of the recording."""
        return self._latched.tables

    @property
    def statics(self) -> list[Static]:
        """Return the static transforms: (T_parent_child, parent, child)."""
        return self._latched.statics

    def go_on(self, legend: Legend) -> None:
        """Give classes the ids that *legend* has for their names: that of earlier sessions."""
        self.given_legend, self.strict = legend, True
        self.names = names.filled(self.config, legend, self._latched.tables, True)
        moved = [f'{name!r} {old} is {new}' for name, (old, new) in self.names.moved().items()]
        if moved:
            more = ', …' if len(moved) > SHOWN else ''
            self.note('ids', f'ids follow their names, as the recording before has them: '
                             f'{", ".join(moved[:SHOWN])}{more}')

    def statics_of(self, camera: str) -> list[Static]:
        """Return the static transforms of the robot that carries a camera."""
        return self._latched.of(self.choice.tf_static_of(camera))

    @property
    def index(self) -> Index:
        """Return that of everything that a reading may use, made when it is first asked."""
        if self._index is None:
            used = {topic for chosen in self.topics.values() for topic in chosen.values()}
            used |= {*self.choice.tf, *self.choice.legends}
            self._index = Index(self.source, {topic.name for topic in used},
                                {chosen['labels'].name for chosen in self.topics.values()})
            there = self._index.counts()
            for topic in sorted(used):
                if there.get(topic.name, 0) < topic.count:
                    self.note(topic.name, f'{topic.name}: {there.get(topic.name, 0)} of '
                              f'{topic.count} messages can be read')
        return self._index

    @property
    def bounds(self) -> tuple[int | None, int | None]:
        """Return the stamps between which label images are used, ns; None: no bound."""
        if self._bounds is None:
            first = None
            if self.excerpt.needs_first:
                found = next(Reading(self).frames(), None)
                first = found.stamp if found else None
            self._bounds = self.excerpt.bounds(first)
        return self._bounds

    @property
    def expected(self) -> int:
        """Return the number of label images, for progress; frames may be fewer."""
        if self.excerpt == WHOLE:
            return sum(chosen['labels'].count for chosen in self.topics.values())
        names = {chosen['labels'].name for chosen in self.topics.values()}
        return -(-self.index.between(names, *self.bounds) // self.excerpt.every)

    def knows_map(self, camera: str) -> bool:
        """Return whether transforms tie poses in another frame to frames.map (tied.knows_map)."""
        if camera not in self._known:
            self._known[camera] = tied.knows_map(self, camera)
        return self._known[camera]

    def needs_tf(self, camera: str) -> bool:
        """
        Return whether poses are not all that places a camera: something on /tf moves, too.

        That is the way from the body to the camera (a gimbal), or from the map to the frame that
        the poses are in (odometry that a localisation corrects).

        """
        return self.knows_map(camera) or tied.carried(self, camera)

    def has(self, kind: str) -> bool:
        """Return whether any camera has the optional topic 'truth' or 'color'."""
        return any(kind in chosen for chosen in self.topics.values())

    def frames(self, truth: bool = False, color: bool = False) -> Iterator[Frame]:
        """
        Read the recording once.

        Parameters
        ----------
        truth, color : bool
            Whether true labels and colour images are wanted, where there are any.

        Yields
        ------
        persem_ros.frames.Frame
            In stamp order.

        Raises
        ------
        PersemError
            When the whole recording gave no frame: why, in one sentence.

        """
        bounds, used = self.bounds, 0
        self.dropped = Counter()
        self.examples = {}
        for frame in Reading(self, truth, color, *bounds, self.excerpt.every).frames():
            used += 1
            yield frame
        if not used:
            raise PersemError(self.nothing())

    def note(self, key: str, text: str) -> None:
        """Keep a sentence for the user, one for each *key*."""
        self._notes[key] = text

    def nothing(self) -> str:
        """Return the sentence that says why no frame could be made."""
        if self.excerpt != WHOLE and not self.expected:
            names = {chosen['labels'].name for chosen in self.topics.values()}
            return f'{self.path}: {self.excerpt.outside(*self.index.span(names))}'
        reasons = [(n, reason) for reason, n in self.dropped.items() if reason != UNUSED]
        if not reasons:
            return f'{self.path} has no label images that could make a frame'
        counted = ', '.join(f'{reason} ({n})' for n, reason in sorted(reasons, reverse=True))
        worst = max(reasons)[1]
        why = self.examples.get(worst, '')
        return f'{self.path} gave no frame: {counted}' + (f'; {why}' if why else '')

    def _read_infos(self) -> dict[str, Any]:
        """Return the first camera info of each topic, refusing those that no image can use."""
        names = {chosen['camera_info'].name for chosen in self.topics.values()
                 if 'camera_info' in chosen}
        infos: dict[str, Any] = {}
        if not names:
            return infos
        for name, kind, _, data in self.source.messages(names):
            if name in infos:
                continue
            msg = self.source.decode(data, kind)
            try:
                Assembler(self.config).add_info(msg)
            except BadMessage as fault:
                raise PersemError(f'{name}: {fault}') from None
            infos[name] = msg
            if len(infos) == len(names):
                return infos
        missing = ' and '.join(sorted(names - set(infos)))
        raise PersemError(f'{self.path}: {missing} has no camera info that can be read')
