"""Topics of a recording that could serve as a kind, by type, encoding and name."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import re
from typing import TYPE_CHECKING

from persem_ros.inputs.decode import clouds, image_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording.first_messages import first_messages
from persem_ros.inputs.recording.kinds import (
    COMPRESSED, DISPARITY, IMAGE, INFO, LABELS_INFO, POINTS, POSES)

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source, TopicInfo

# Colour images are offered as labels where their topic's name says so and none holds ids.
NAMED = re.compile('label|segment|semantic|class|mask|annot', re.IGNORECASE)
OWN_MAP = '/mapper/map'     # what a node or a replay has published is no input
SHOWN = 6           # candidates in one refusal


class Candidates:
    """
    Of one recording.

    Parameters
    ----------
    source : Source
        The open recording.
    pose_type : str
        The setting pose.type.

    Attributes
    ----------
    topics : list of TopicInfo
        All topics, those with messages first.

    """

    def __init__(self, source: Source, pose_type: str) -> None:
        """Know the topics; messages are looked at when they are asked for."""
        self._source = source
        self._encodings: dict[str, str] | None = None
        self.topics = sorted(source.topics, key=lambda topic: not topic.count)
        self._pose_types = (POSES[pose_type],) if pose_type in POSES else tuple(POSES.values())

    def types(self, kind: str) -> tuple[str, ...]:
        """Return the message types that a kind may have."""
        if kind == 'pose':
            return self._pose_types
        if kind == 'points':
            return (POINTS,)
        if kind == 'depth':
            return IMAGE, COMPRESSED, DISPARITY
        return (INFO,) if kind in ('camera_info', LABELS_INFO) else (IMAGE, COMPRESSED)

    def of(self, kind: str, taken: Sequence[TopicInfo] = ()) -> list[TopicInfo]:
        """Return the topics that could serve as *kind*, the likely ones first; none of *taken*."""
        fitting = [t for t in self.topics if t.msgtype in self.types(kind) and t not in taken
                   and not t.name.endswith(OWN_MAP)]
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
            wanted = {t.name for t in self.topics if t.msgtype in (IMAGE, COMPRESSED) and t.count}
            for name, msg in first_messages(self._source, wanted).items():
                self._encodings[name] = getattr(msg, 'encoding', '') or getattr(msg, 'format', '')
        return self._encodings

    def labelled_clouds(self) -> list[tuple[str, str]]:
        """Return (topic, field with ids) of clouds whose points have labels."""
        clouds_there = {t.name for t in self.topics if t.msgtype == POINTS and t.count
                        and not t.name.endswith(OWN_MAP)}
        found = []
        for name, msg in first_messages(self._source, clouds_there).items():
            with suppress(BadMessage):
                dtype = clouds.structured(msg).dtype
                found += [(name, field) for field in dtype.names or ()
                          if dtype[field].kind in 'iu' and NAMED.search(field)][:1]
        return found[:SHOWN]


def _encodes(encoding: str, kind: str, known: dict[str, str]) -> bool:
    """Return whether an image encoding or format can serve as labels or depth."""
    if not encoding or 'compressedDepth' in encoding:
        return not encoding or kind == 'depth'
    if 'jpeg' in encoding or 'jpg' in encoding:
        return False
    return encoding in known or 'png' in encoding.lower()
