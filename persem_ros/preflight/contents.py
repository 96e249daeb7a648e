"""What is in a recording: one row a topic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, TYPE_CHECKING

from persem_ros.inputs.decode import image_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording.first_messages import TRIED
from persem_ros.inputs.recording.kinds import COMPRESSED, DISPARITY, IMAGE, INFO, POSES, TF
from persem_ros.inputs.recording.stamps import stamp_of

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Head, Source

HEADERS = {IMAGE, COMPRESSED, DISPARITY, INFO, *POSES.values()}
SHORTEST = 10**8             # ns; latched messages come in a burst, which is no rate


@dataclass
class Row:
    """
    What one topic holds.

    Stamps are those of the headers, for types without a header those of the recorder, whose
    clock may be another one.

    """

    name: str
    msgtype: str
    count: int = 0
    encoding: str = ''
    size: str = ''
    frame: str = ''
    first: int | None = None    # smallest stamp, ns
    last: int | None = None     # largest stamp, ns
    back: int = 0               # stamps smaller than the one before
    repeated: int = 0
    recorded: int | None = None     # earliest time of the recorder, ns
    tried: int = field(default=0, repr=False)
    previous: int | None = field(default=None, repr=False)

    @property
    def stamped(self) -> bool:
        """Whether the messages carry stamps that mean something."""
        moving = self.msgtype == TF and not self.name.endswith('tf_static')
        return self.msgtype in HEADERS or moving

    @property
    def rate(self) -> float:
        """Messages per second between the first and the last stamp, 0 where there is none."""
        span = (self.last or 0) - (self.first or 0)
        return (self.count - 1) * 1e9 / span if span >= SHORTEST else 0.0

    def see(self, stamp: int | None) -> None:
        """Count a message with *stamp*, None where it has none."""
        self.count += 1
        if stamp is None:
            return
        self.first = stamp if self.first is None else min(self.first, stamp)
        self.last = stamp if self.last is None else max(self.last, stamp)
        if self.previous is not None and self.msgtype in HEADERS:
            self.back += stamp < self.previous
            self.repeated += stamp == self.previous
        self.previous = stamp


def survey(
        source: Source, progress: Callable[[Iterable[Head]], Iterable[Head]] = iter
) -> list[Row]:
    """
    Walk over a whole recording without reading its images.

    Parameters
    ----------
    source : Source
        The open recording.
    progress
        Wraps the messages, for a progress bar.

    Returns
    -------
    list of Row
        By topic name.

    """
    rows = {(t.name, t.msgtype): Row(t.name, t.msgtype) for t in source.topics}
    names = {t.name for t in source.topics}
    for head in progress(source.heads(names)):
        row = rows[head.topic, head.msgtype]
        row.see(stamp_of(head.msgtype, head.start) if row.stamped else head.time)
        row.recorded = head.time if row.recorded is None else min(row.recorded, head.time)
        if row.tried < TRIED:
            _try_to_describe(row, source, source.read(head.file, head.place))
    return list(rows.values())


def _try_to_describe(row: Row, source: Source, data: bytes) -> None:
    """Fill in what a message tells, unless it is damaged."""
    row.tried += 1
    try:
        _describe(row, source.decode(data, row.msgtype))
        row.tried = TRIED
    except BadMessage:          # damaged, or of a type that is not known here
        return


def _describe(row: Row, msg: Any) -> None:
    """Fill in what the first message tells."""
    row.encoding = getattr(msg, 'encoding', '') or getattr(msg, 'format', '') or \
        getattr(msg, 'distortion_model', '')
    if row.msgtype == DISPARITY:
        row.encoding, row.size = msg.image.encoding, f'{msg.image.width}x{msg.image.height}'
    elif hasattr(msg, 'width') and hasattr(msg, 'height'):
        row.size = f'{msg.width}x{msg.height}'
    elif row.msgtype == COMPRESSED:
        row.size = _compressed_size(msg)
    if hasattr(msg, 'header'):
        row.frame = msg.header.frame_id
        row.frame += f' -> {msg.child_frame_id}' if getattr(msg, 'child_frame_id', '') else ''
    elif row.msgtype == TF and msg.transforms:
        first = msg.transforms[0]
        row.frame = f'{first.header.frame_id} -> {first.child_frame_id}'


def _compressed_size(msg: Any) -> str:
    """Return the size of a compressed image, '' where it cannot be decoded."""
    read = image_messages.depth if 'compressedDepth' in msg.format else image_messages.color
    try:
        height, width = read(msg).shape[:2]
    except BadMessage:
        return ''
    return f'{width}x{height}'
