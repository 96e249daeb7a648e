"""Frames from messages as they arrive, in any order, also when time goes back."""

from typing import NamedTuple

from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.intake import Intake, POSE
from persem_ros.inputs.sync.pairing import DEPTH, LABELS, WENT_BACK
from persem_ros.inputs.sync.timeline import BACK, ODD, Timeline

STALE = 'from before time went back'
TIMED = (LABELS, DEPTH, POSE)       # whose stamps tell what time it is


class _Jump(NamedTuple):
    """When time went back, by the clock of arrival, and the stamp between old and new, ns."""

    at: int
    middle: int
    renewed: set        # topics that have shown new stamps; of others old ones may still come


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

    """

    def __init__(self, config, decode, dropped, on_jump):
        """Start without cameras."""
        super().__init__(config, decode, dropped)
        self.jumps = 0
        self._on_jump = on_jump
        self.configure(config)
        self._heard = {}        # camera -> (largest stamp of a label image, when it came)
        self._timelines = {}    # (role, taker) -> Timeline
        self._odd = {}          # the same -> arguments of take(), to be taken or dropped
        self._jump = None

    def take(self, role, taker, kind, now, data):
        """Take one message, as in Intake; notices when time goes back."""
        if role not in TIMED:
            super().take(role, taker, kind, now, data)
            return
        try:
            stamp, _ = messages.header(data)
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
            self._go_back(now, (before + stamp) // 2, key)
            self._take_now(*odd)
        self._take_now(role, taker, kind, now, data)

    def may_leave(self, stamp, number, match, now):
        """Whether the other cameras have nothing earlier, or were waited for long enough."""
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

    def configure(self, config):
        """Go on with other settings sync.* and pose.*."""
        self.config = config
        self._wait = round(config.sync.max_wait * 1e9)
        self._hold = round(config.sync.hold * 1e9)
        for station in self.stations:
            station.sync.configure(config.sync)
            station.poses.configure(config.pose)

    def clear(self):
        """Forget everything that was held and heard; static transforms and infos stay."""
        super().clear()
        self._heard.clear()
        self._timelines.clear()
        self._odd.clear()
        for buffer in {id(s.poses): s.poses for s in self.stations}.values():
            buffer.clear()

    def _take_now(self, role, taker, kind, now, data):
        if role == LABELS:
            stamp, _ = messages.header(data)
            latest, _ = self._heard.get(id(taker), (stamp, 0))
            self._heard[id(taker)] = max(stamp, latest), now
        super().take(role, taker, kind, now, data)

    def _is_stale(self, key, stamp, now):
        """Whether a message was sent before time went back, as another topic has shown."""
        jump = self._jump
        if jump is None or key in jump.renewed or now - jump.at > self._wait:
            return False
        if stamp <= jump.middle:
            jump.renewed.add(key)
        return stamp > jump.middle

    def _go_back(self, now, middle, key):
        self._jump = _Jump(now, middle, {key})
        self.jumps += 1
        self.clear()
        self._on_jump()

    def _drop_reason(self, role, reason):
        self.dropped[reason if role == LABELS else f'{role}: {reason}'] += 1
