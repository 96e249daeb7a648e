"""One reading of an input: messages in, frames out, in the order of header stamps."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
import sys
from typing import TYPE_CHECKING

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.inputs import names
from persem_ros.inputs.intake import INFO, Intake, LABELS_INFO, LEGEND, ORDER, POSE, TF
from persem_ros.inputs.sync.match import COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS, TRUTH
from persem_ros.inputs.sync.no_pose import explain
from persem_ros.inputs.sync.pairing import NO_DEPTH
from persem_ros.inputs.sync.poses import PoseBuffer

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.inputs.intake import Station, Taker
    from persem_ros.inputs.recording.recording import Recording
    from persem_ros.inputs.recording.source import TopicInfo
    from persem_ros.inputs.sync.match import Match, Raw
    from persem_ros.settings.config import Config

AHEAD = 30.0            # s that poses are read before the images: what one needs is there
POSES_KEPT = 300.0      # s
ROUNDED = 5_000_000     # ns by which whole periods may miss
FIRST = {INFO, LABELS_INFO, POSE, TF, LEGEND}       # read whatever the bounds of the images are
RANKS = {**dict.fromkeys(FIRST, -1), **ORDER}


class Reading(Intake):
    """
    One pass over an input.

    Messages come sorted by their stamps, so a partner that is not there when its time has passed
    will not come: whatever waits live is decided here within sync.tolerance, which bounds memory.

    Parameters
    ----------
    recording : persem_ros.inputs.recording.recording.Recording
        Whose counters this fills.
    truth, color : bool
        Whether those topics are read.
    first, last : int, optional
        Stamps of label images that are read, ns.
    every : int
        Every how many of each camera's complete frames is used.

    """

    def __init__(self, recording: Recording, truth: bool = False, color: bool = False,
                 first: int | None = None, last: int | None = None, every: int = 1) -> None:
        """Set up the queues."""
        config = recording.config
        self._tolerance = round(config.sync.tolerance * 1e9)
        wait = (self._tolerance + 1) / 1e9
        super().__init__(replace(config, sync=replace(config.sync, max_wait=wait)),
                         recording.source.decode, recording.dropped, True, 0.0, wait,
                         examples=recording.examples)
        self._recording = recording
        self._bounds, self._every = (first, last), every
        self._complete: Counter[int] = Counter()                # frames by camera
        self._roles: dict[str, list[tuple[str, Taker]]] = {}    # by topic
        self._buffers: dict[str, PoseBuffer] = {}               # by pose topic
        self._depth: dict[Station, list[int]] = {}              # stamps, ascending
        self._misses: list[int] = []    # ns by which labels without depth are behind the nearest
        self._front = -sys.maxsize      # stamp of what was read last
        companions = [kind for kind, wanted in ((TRUTH, truth), (COLOR, color)) if wanted]
        for name, chosen in recording.topics.items():
            self._add_camera(name, chosen, [k for k in companions if k in chosen])
        self._add_names(config)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; the recording's counters follow."""
        for topic, kind, stamp, data in self._messages():
            self._front = stamp
            for role, taker in self._roles[topic]:
                self.take(role, taker, kind, stamp, data)
            yield from self.leaving(stamp)
        self._front = sys.maxsize
        yield from self.leaving(self._front, True)
        self._conclude()

    def may_leave(self, stamp: int, number: int, match: Match, now: int) -> bool:
        """Whether the other cameras have only later images."""
        return len(self.stations) == 1 or stamp < self.oldest_pending(sys.maxsize)

    def wanted(self, match: Match, number: int) -> bool:
        """Whether it is the turn of a match, of camera *number*, to become a frame."""
        self._complete[number] += 1
        return (self._complete[number] - 1) % self._every == 0

    def left(self, station: Station, stamp: int) -> None:
        """Forget the poses that only earlier frames would ask for."""
        station.poses.forget(min(stamp, self.oldest_pending(stamp)))

    def oldest_pending(self, default: int) -> int:
        """Return the earliest stamp that may still come."""
        pending = super().oldest_pending(default)
        return pending if len(self.stations) == 1 else min(pending, self._front)

    def no_mount(self, reason: str, sentence: str) -> None:
        """Refuse poses that never lead to the camera."""
        raise PersemError(f'{self._recording.path}: {sentence}')

    def _messages(self) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield (topic, type, stamp, data) in the order of stamps, poses ahead of the images."""
        kinds = {topic: {role for role, _ in takers} for topic, takers in self._roles.items()}
        ahead = round(AHEAD * 1e9)
        shifts = {topic: -ahead if roles & {POSE, TF} else 0 for topic, roles in kinds.items()}
        for topic, roles in kinds.items():
            if roles & {LABELS, LEGEND}:
                shifts[topic] += self.offset
        ranks = {topic: max(RANKS[role] for role in roles) for topic, roles in kinds.items()}
        first, last = self._bounds
        images = [topic for topic, roles in kinds.items() if not roles & FIRST]
        return self._recording.index.ordered(
            shifts, ranks, None if first is None else first - self._tolerance,
            None if last is None else last + self._tolerance, images)

    def push_image(self, station: Station, role: str, stamp: int, raw: Raw, now: int) -> None:
        """Hand an image to its synchroniser, a label image only from between the bounds."""
        first, last = self._bounds
        if role == LABELS and (first is not None and stamp < first
                               or last is not None and stamp > last):
            return
        if role == DEPTH:
            self._depth.setdefault(station, []).append(stamp)
        super().push_image(station, role, stamp, raw, now)

    def _add_camera(self, name: str, chosen: dict[str, TopicInfo], companions: list[str]) -> None:
        needed = [kind for kind in (DEPTH, CONFIDENCE, DEPTH_CONFIDENCE) if kind in chosen]
        station = self.add_camera(name, self._pose_buffer(name, chosen), companions,
                                  needed)
        station.sync.on_drop = partial(self._note_miss, station)
        if INFO in chosen:
            station.assembler.add_info(self._recording.infos[chosen[INFO].name])
        infos = [kind for kind in (INFO, LABELS_INFO) if kind in chosen]
        for kind in (LABELS, *needed, *companions, *infos):
            self._roles.setdefault(chosen[kind].name, []).append((kind, station))

    def _add_names(self, config: Config) -> None:
        """Know what the recording says of its classes: with stamps, or by the order of arrival."""
        given = self._recording.given_legend
        tables = self._recording.tables
        arriving = [table for table in tables if table.stamp is None]
        self.names = names.filled(config, given, [
            *(table for table in tables if table.stamp is not None), *arriving[:1]],
            self._recording.strict)
        if len(arriving) > 1:
            for topic in self._recording.choice.legends:
                self._roles.setdefault(topic.name, []).append((LEGEND, None))

    def _pose_buffer(self, camera: str, chosen: dict[str, TopicInfo]) -> PoseBuffer:
        """Return the buffer of a camera's poses; cameras with one pose topic share it."""
        choice = self._recording.choice
        tf = choice.tf_of(camera)
        name = chosen[POSE].name if POSE in chosen else TF + '+'.join(t.name for t in tf)
        if name not in self._buffers:
            buffer = self._buffers[name] = PoseBuffer(
                self._recording.config, POSES_KEPT, self._recording.knows_map(camera))
            buffer.correction = self._recording.corrections.get(camera)
            for transform in self._recording.statics_of(camera):
                buffer.add_static(*transform)
            if POSE in chosen:
                self._roles[name] = [(POSE, buffer)]
        if POSE not in chosen or self._recording.needs_tf(camera):
            for topic in tf:
                takers = self._roles.setdefault(topic.name, [])
                if (TF, self._buffers[name]) not in takers:
                    takers.append((TF, self._buffers[name]))
        return self._buffers[name]

    def _note_miss(self, station: Station, match: Match, reason: str) -> None:
        """Keep why a label image was dropped, as long as what tells it is there."""
        if reason in self.placing.missed:
            poses, stamp, frame_id = self.placing.missed.pop(reason)
            if reason not in self.examples:
                self.examples[reason] = explain(poses, stamp, frame_id)
        depth = self._depth.get(station)
        if reason == NO_DEPTH and depth:
            i = bisect_left(depth, match.stamp)
            self._misses.append(min((match.stamp - stamp for stamp in depth[max(i - 1, 0):i + 1]),
                                    key=abs))

    def _explain_misses(self) -> None:
        """Write to `examples` how far labels were from depth."""
        if self._misses:
            low, middle, high = np.percentile(np.array(self._misses) / 1e6, (5, 50, 95))
            far = f'{abs(middle):.0f} ms {"before" if middle > 0 else "after"} them' \
                if high - low < 1 else f'{abs(middle):.0f} ms away (median; behind it by ' \
                                       f'{low:.0f} to {high:.0f} ms)'
            advice = 'it was lost when it was recorded: docs/transports.md' if _lost(
                self._misses) else ('--set sync.tolerance=…, or sync.offset_labels where labels '
                                    'are always late by the same')
            self.examples[NO_DEPTH] = (f'the nearest depth image was {far}, sync.tolerance is '
                                       f'{self._tolerance / 1e6:g} ms: {advice}')
        elif self.dropped[NO_DEPTH]:
            self.examples[NO_DEPTH] = 'no depth image was there at all'

    def _conclude(self) -> None:
        """Tell the recording what only the end of a reading knows."""
        for buffer in self._buffers.values():
            for key, text in buffer.notes.items():
                self._recording.note(key, text)
        for station in self.stations:
            if station.assembler.reader.note:
                self._recording.note('labels', station.assembler.reader.note)
        self.explain()
        self._explain_misses()


def _lost(misses: list[int]) -> bool:
    """Return whether distances (ns) to the nearest depth image are whole periods, not alike."""
    off = np.array(misses, float)
    period = np.abs(off).min()
    return bool(np.ptp(off) >= period and
                np.abs(off - period * np.rint(off / period)).max() <= ROUNDED)
