"""Frames from messages as they arrive, in any order, also when time goes back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import logging
import time
from typing import NamedTuple, TYPE_CHECKING

from persem_ros.inputs.decode import messages, px4
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.intake import Intake, LEGEND, POSE, Station
from persem_ros.inputs.sync.backlog import Backlog
from persem_ros.inputs.sync.clocks import ANOTHER_CLOCK, Clocks
from persem_ros.inputs.sync.match import DEPTH, LABELS
from persem_ros.inputs.sync.pairing import KEEP, NO_DEPTH, QUEUE_FULL, WENT_BACK
from persem_ros.inputs.sync.partners import Partners
from persem_ros.inputs.sync.timeline import BACK, ODD, Timeline
from persem_ros.inputs.sync.track import Lookup

if TYPE_CHECKING:
    from collections import Counter

    from persem_ros.inputs.assemble import Assembler
    from persem_ros.inputs.intake import Decode, Taker
    from persem_ros.inputs.sync.match import Match
    from persem_ros.inputs.sync.poses import PoseBuffer
    from persem_ros.settings.config import Config, Sync

log = logging.getLogger(__name__)
STALE = 'from before time went back'
BEHIND = 'mapping is behind'
TIES = 2_000_000_000    # ns, twice as long as labels wait for what ties them to the depth
TIMED = (LABELS, DEPTH, POSE)       # whose stamps tell what time it is


Key = tuple[str, int]       # a role, and the id() of whose messages these are


class _Jump(NamedTuple):
    """When time went back, by the clock of arrival, and the stamp between old and new, ns."""

    at: int
    middle: int
    renewed: set[Key]   # topics that have shown new stamps; of others old ones may still come


class LiveIntake(Intake):
    """
    The way in of a node.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
    decode : callable
        See Intake.
    dropped : collections.Counter
        Where reasons are counted.
    on_jump : callable
        Called when time went back, after everything held was forgotten.
    clock : callable
        clock() gives the node's time, ns; stamps are compared with it, nothing waits for it.
    steady : callable
        steady() gives the ns of a clock that does not go back, that of take().

    Attributes
    ----------
    jumps : int
        How often time went back.
    behind : bool
        Whether a frame was dropped because frames come faster than they are mapped: what waits
        behind it is old, too (see `skip`).

    """

    def __init__(self, config: Config, decode: Decode, dropped: Counter[str],
                 on_jump: Callable[[], None], clock: Callable[[], int] = time.time_ns,
                 steady: Callable[[], int] = time.monotonic_ns) -> None:
        """Start without cameras."""
        super().__init__(config, decode, dropped)
        self.jumps = 0
        self._clock, self._steady = clock, steady
        self._backlog = Backlog()
        self._said = ''     # how names and the given legend differ
        self.behind = False
        # When two frames were asked for first.
        self._untied: dict[tuple[str, str], int] = {}
        self._began = 0         # when frames began to be taken, by steady()
        self._partners: dict[Station, Partners] = {}
        self._clocks: dict[Assembler, Clocks] = {}
        self._on_jump = on_jump
        self.configure(config)
        # By id of a station: the largest stamp of a label image, and when it came.
        self._heard: dict[int, tuple[int, int]] = {}
        self._timelines: dict[Key, Timeline] = {}
        # Arguments of take(), to be taken or dropped.
        self._odd: dict[Key, tuple[str, Taker, str, int, bytes]] = {}
        self._jump: _Jump | None = None

    @property
    def lateness(self) -> int:
        """Return the ns that depth images take where that is seconds, 0 where it is not."""
        return max((clocks.late for clocks in self._clocks.values()), default=0)

    def add_camera(
            self, name: str, poses: PoseBuffer, companions: Sequence[str] = (),
            needed: Sequence[str] = (DEPTH,)
    ) -> Station:
        """Add a camera, as in Intake."""
        station = super().add_camera(name, poses, companions, needed)
        self._partners[station] = Partners(KEEP)
        self._clocks[station.assembler] = Clocks(self.config.pose.max_ahead)
        station.sync.on_drop = partial(self._explain_drop, station)
        station.sync.configure(self.config.sync, self.config.sync.queue_bytes)
        return station

    def take(self, role: str, taker: Taker, kind: str, now: int, data: bytes) -> None:
        """Take one message, as in Intake; notices when time goes back."""
        if role not in TIMED:
            super().take(role, taker, kind, now, data)
            if role == LEGEND and self.names.difference() not in ('', self._said):
                self._said = self.names.difference()
                log.warning('%s', self._said)
            return
        try:
            stamp = _stamp(kind, data)
        except BadMessage as fault:
            self._drop(role, fault)
            return
        key = role, id(taker)
        timeline = self._timelines.setdefault(key, Timeline(self._wait))
        if self._is_stale(key, stamp, now):
            self._drop_reason(role, STALE)
            return
        before, verdict = timeline.now, timeline.judge(stamp)
        odd = self._odd.pop(key, None)
        if odd and verdict != BACK:
            self._drop_reason(role, WENT_BACK)
        if verdict == ODD:
            self._odd[key] = role, taker, kind, now, data
            return
        if verdict == BACK:
            assert odd is not None and before is not None       # it is the second in a row
            self._go_back(now, (before + stamp) // 2, key)
            self._take_now(*odd)
        self._take_now(role, taker, kind, now, data)

    def begin(self) -> None:
        """Count as backlog only what frames wait from now on."""
        self._began = self._steady()

    def may_leave(self, stamp: int, number: int, match: Match, now: int) -> bool:
        """Whether the other cameras have nothing earlier, or were waited for long enough."""
        assert match.complete is not None       # or it would not be ready
        waited = now - match.complete >= self._hold
        for other, station in enumerate(self.stations):
            if other == number:
                continue
            pending = station.sync.first_pending
            if pending is not None and (pending, other) < (stamp, number):
                return False
            latest, came = self._heard.get(id(station), (stamp, 0))
            if latest < stamp and not waited and now - came < self._wait:
                return False
        return True

    def wanted(self, match: Match, number: int) -> bool:
        """Whether a match is young enough to become a frame."""
        now = self._steady()
        assert match.ready is not None          # leaving() has just said when
        age = now - max(match.ready, self._began)
        if self._backlog.late(age, now, round(self.config.sync.queue * 1e9)):
            self.dropped[BEHIND] += 1
            self.behind = True
            return False
        return True

    def skip(self, stamp: int, count: int) -> None:
        """
        Go on with label images from *stamp* on, where mapping is behind.

        *count* label images before it were left out before they came here.

        """
        self.behind = False
        self.dropped[BEHIND] += count
        for station in self.stations:
            station.sync.drop_before(stamp, BEHIND)

    def few_depths(self) -> tuple[int, int] | None:
        """Return (depth images, label images) of a camera that gets too few depth images."""
        return next((few for few in (p.lost() for p in self._partners.values()) if few), None)

    def configure(self, config: Config) -> None:
        """Go on with other settings sync.* and pose.*."""
        self.config = self.placing.config = config
        self._wait = round(config.sync.max_wait * 1e9)
        self._hold = round(config.sync.hold * 1e9)
        for station in self.stations:
            station.sync.configure(config.sync, config.sync.queue_bytes)
            station.poses.configure(config.pose)
            self._clocks[station.assembler].configure(config.pose.max_ahead)

    def clear(self) -> None:
        """Forget everything that was held and heard; static transforms and infos stay."""
        super().clear()
        self._heard.clear()
        self._timelines.clear()
        self._odd.clear()
        for partners in self._partners.values():
            partners.clear()
        for clocks in self._clocks.values():
            clocks.clear()
        for buffer in {id(s.poses): s.poses for s in self.stations}.values():
            buffer.clear()

    def _take_now(self, role: str, taker: Taker, kind: str, now: int, data: bytes) -> None:
        if role == LABELS:
            assert isinstance(taker, Station)
            stamp = messages.header(data)[0] + self.offset
            latest, _ = self._heard.get(id(taker), (stamp, 0))
            self._heard[id(taker)] = max(stamp, latest), now
            self._partners[taker].labels(stamp, now)
        elif role == DEPTH:
            assert isinstance(taker, Station)
            stamp, frame_id = messages.header(data)
            self._partners[taker].depth(stamp, now, self.config.sync.tolerance)
            came = self._clock() - (self._steady() - now)
            self._clocks[taker.assembler].image(stamp, taker.poses.newest(frame_id), came, now)
        super().take(role, taker, kind, now, data)

    def _is_stale(self, key: Key, stamp: int, now: int) -> bool:
        """Whether a message was sent before time went back, as another topic has shown."""
        jump = self._jump
        if jump is None or key in jump.renewed or now - jump.at > self._wait:
            return False
        if stamp <= jump.middle:
            jump.renewed.add(key)
        return stamp > jump.middle

    def _go_back(self, now: int, middle: int, key: Key) -> None:
        self._jump = _Jump(now, middle, {key})
        self.jumps += 1
        self.clear()
        self._on_jump()

    def _lookup(self, poses: PoseBuffer, assembler: Assembler, match: Match) -> Lookup:
        """Return the pose of a match, as in Intake; none of another clock."""
        clocks = self._clocks[assembler]
        if clocks.ahead:
            self.examples[ANOTHER_CLOCK] = clocks.sentence()
            return Lookup(None, True, ANOTHER_CLOCK)
        return super()._lookup(poses, assembler, match)

    def untied(self, frame_id: str, other: str) -> bool:
        """Give transforms that tie two frames some time to come, once."""
        since = self._untied.setdefault((frame_id, other), self._steady())
        return self._steady() - since >= min(self._wait, TIES) // 2

    def _explain_drop(self, station: Station, match: Match, reason: str) -> None:
        """Write to `examples` why a label image was dropped, where that takes a look around."""
        partners, sync = self._partners[station], self.config.sync
        if reason == NO_DEPTH:
            partners.give_up(match.stamp, match.arrival, sync.tolerance)
            self.examples[reason] = partners.explain(match.stamp, match.arrival, sync)
        elif reason == QUEUE_FULL:
            self.examples[reason] = full_sentence(sync)

    def explain(self) -> None:
        """Write to `examples` why frames and images were dropped."""
        super().explain()
        self.examples[f'{DEPTH}: {QUEUE_FULL}'] = full_sentence(self.config.sync)

    def _drop_reason(self, role: str, reason: str) -> None:
        self.dropped[reason if role == LABELS else f'{role}: {reason}'] += 1


def _stamp(kind: str, data: bytes) -> int:
    """Return the stamp of a serialized image or pose, ns; BadMessage where it has none."""
    if kind != px4.TYPE:
        return messages.header(data)[0]
    stamp = px4.stamp_of(data)
    if stamp is None:
        raise BadMessage('damaged message', f'a {kind} ends before its stamp')
    return stamp


def full_sentence(sync: Sync) -> str:
    """Return what to do where images that wait for their partners fill the queue."""
    return ('depth images wait for their labels and fill the queue; sync.queue_bytes is '
            f'{sync.queue_bytes}: --set sync.queue_bytes={2 * sync.queue_bytes}')
