"""
Pairs label and depth images and gives each pair its pose: no ROS, no clock, no randomness.

Time comes in as *now*, integer nanoseconds of any clock that does not go back: the node passes
its own, a replay the recording's. Stamps never serve as a clock, so that one stamp that is hours
off cannot time out everybody else.

"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from persem_ros.inputs.sync.match import DEPTH, LABELS, Match
from persem_ros.inputs.sync.waiting import Waiting, WaitingImages

if TYPE_CHECKING:
    from persem_ros.inputs.sync.match import Raw
    from persem_ros.inputs.sync.track import Lookup
    from persem_ros.settings.config import Sync

NO_DEPTH = 'no depth within tolerance'
REPEATED = 'stamp repeated'
ZERO = 'stamp is 0'         # repeated, too: whoever publishes that fills in no stamps
WENT_BACK = 'stamp went back'
QUEUE_FULL = 'queue full'
UNUSED = 'depth: no labels'
KEEP = 2.0      # s, for a segmenter that takes its time


class Synchronizer:
    """
    Matches the images of one camera, spec section 7.

    A depth image with the stamp of a label image belongs to it; otherwise the nearest within the
    tolerance does, once a later one has come or the wait is over. Matches leave in the order
    of their stamps, so a label image holds back those behind it until it is complete, has its
    pose or is dropped.

    Parameters
    ----------
    sync : persem_ros.settings.config.Sync
        Tolerance and longest wait.
    lookup : callable, optional
        lookup(match) gives a persem_ros.inputs.sync.track.Lookup; None: no poses are asked for.
    companions : tuple of str
        Kinds of images that join a match where there are any: `TRUTH`, `COLOR`.
    patient : bool
        True: a match waits for its companions as for its depth (a replay, where they must not
        depend on the order of arrival). False: it takes those that are there.
    pose_wait : float, optional
        Seconds that a match waits for its pose; None: sync.max_wait.
    keep : float
        Seconds that a depth image waits for its labels at least.
    max_bytes : int
        Bound of everything held.
    dropped : collections.Counter, optional
        Where reasons are counted. A reason without a colon counts label images; others start
        with their kind ('depth: ').
    needed : tuple of str
        Kinds without which there is no match.

    Attributes
    ----------
    needed : frozenset of str
        The same and `LABELS`.
    on_drop : callable
        on_drop(match, reason) hears of each label image that is dropped after it has waited.

    """

    def __init__(self, sync: Sync, lookup: Callable[[Match], Lookup] | None = None,
                 companions: Sequence[str] = (), patient: bool = False,
                 pose_wait: float | None = None,
                 keep: float = KEEP, max_bytes: int = 256 << 20,
                 dropped: Counter[str] | None = None, needed: Sequence[str] = (DEPTH,)) -> None:
        """Start empty."""
        self.dropped: Counter[str] = Counter() if dropped is None else dropped
        self._keep_for, self._wait_for_pose = keep, pose_wait
        self.configure(sync)
        self._lookup = lookup
        self.needed = frozenset((LABELS, *needed))
        self._partners = (*needed, *companions)
        self._patient = patient
        self._max_bytes = max_bytes
        self.on_drop: Callable[[Match, str], None] = lambda match, reason: None
        self.clear()

    def configure(self, sync: Sync, max_bytes: int | None = None) -> None:
        """Go on with other settings and bound in bytes."""
        if max_bytes is not None:
            self._max_bytes = max_bytes
        self._tolerance = round(sync.tolerance * 1e9)
        self._wait = round(sync.max_wait * 1e9)
        self._keep = max(self._wait, round(self._keep_for * 1e9))
        self._pose_wait = self._wait if self._wait_for_pose is None \
            else round(self._wait_for_pose * 1e9)

    def clear(self) -> None:
        """Forget everything held and every stamp seen (the clock went back)."""
        self._matches: list[Match] = []                     # in stamp order
        self._queues = {kind: WaitingImages() for kind in self._partners}
        self._left: int | None = None                       # stamp of the last match that left
        self.bytes = 0

    @property
    def first_pending(self) -> int | None:
        """Stamp of the earliest label image held, None where none is."""
        return self._matches[0].stamp if self._matches else None

    def push(self, kind: str, stamp: int, item: Raw, size: int, now: int) -> None:
        """
        Take one image; call `advance` afterwards.

        Parameters
        ----------
        kind : str
            `LABELS`, `DEPTH` or a companion.
        stamp : int
            Header stamp, nanoseconds.
        item : object
            Whatever the match shall carry.
        size : int
            Bytes that the item holds.
        now : int
            Time, nanoseconds.

        """
        taken = self._push_label(stamp, item, size, now) if kind == LABELS \
            else self._push_partner(kind, stamp, item, size, now)
        if taken:
            self.bytes += size
            while self.bytes > self._max_bytes:
                self._drop_oldest()

    def advance(self, now: float) -> list[Match]:
        """Return the matches that can leave at time *now*, in stamp order."""
        self._settle(now)
        leaving: list[Match] = []
        while self._matches and self._head_leaves(now, leaving):
            pass
        self._prune(now)
        return leaving

    def drop_before(self, stamp: int, reason: str) -> None:
        """Drop the label images before *stamp*; what still comes of them has come too late."""
        while self._matches and self._matches[0].stamp < stamp:
            self._drop_head(reason)
        self._left = stamp - 1 if self._left is None else max(self._left, stamp - 1)

    def flush(self) -> list[Match]:
        """Return what can still leave when nothing more will come; drop the rest."""
        return self.advance(float('inf'))

    def _push_label(self, stamp: int, item: Raw, size: int, now: int) -> bool:
        if self._left is not None and stamp <= self._left:
            self.dropped[repeated(stamp) if stamp == self._left else WENT_BACK] += 1
            return False
        i = bisect_left(self._matches, stamp, key=_stamp)
        if i < len(self._matches) and self._matches[i].stamp == stamp:
            self.dropped[repeated(stamp)] += 1
            return False
        match = Match(stamp, {LABELS: item}, None, now, None, size, set(self._partners))
        if len(self.needed) == 1:
            match.complete = now
        self._matches.insert(i, match)
        for kind in self._partners:
            image = self._queues[kind].take(stamp)
            if image is not None:
                self._join(match, kind, image, now)
        return True

    def _push_partner(self, kind: str, stamp: int, item: Raw, size: int, now: int) -> bool:
        image, queue = Waiting(stamp, item, size, now), self._queues[kind]
        queue.latest = stamp
        i = bisect_left(self._matches, stamp, key=_stamp)
        if i < len(self._matches) and self._matches[i].stamp == stamp:
            if kind in self._matches[i].missing:
                self._join(self._matches[i], kind, image, now)
                return True
        elif queue.add(image):
            return True
        self.dropped[f'{kind}: {repeated(stamp)}'] += 1
        return False

    def _join(self, match: Match, kind: str, image: Waiting, now: float) -> None:
        match.items[kind] = image.item
        match.size += image.size
        match.missing.discard(kind)
        if kind in self.needed and not self.needed & match.missing:
            match.complete = now

    def _settle(self, now: float) -> None:
        """Give label images without an exact partner the nearest one, where that is decided."""
        for match in self._matches:
            waited = now - match.arrival >= self._wait
            for kind in [k for k in self._partners if k in match.missing]:
                queue = self._queues[kind]
                passed = queue.latest is not None and queue.latest > match.stamp
                hurried = kind not in self.needed and not self._patient \
                    and not self.needed & match.missing
                if not (passed or waited or hurried):
                    continue
                nearest = queue.take_nearest(match.stamp, self._tolerance)
                if nearest is not None:
                    self._join(match, kind, nearest, now)
                elif kind not in self.needed and self._patient and (passed or waited):
                    match.missing.discard(kind)

    def _head_leaves(self, now: float, leaving: list[Match]) -> bool:
        """Let the earliest label image leave or drop; return False where it has to wait."""
        match = self._matches[0]
        if self.needed & match.missing:
            # A later depth image does not end the wait: this one's own may be on its way.
            if now - match.arrival < self._wait:
                return False
            lacking = min(self.needed & match.missing, key=lambda kind: kind != DEPTH)
            self._drop_head(f'no {lacking} within tolerance')
            return True
        if self._patient and match.missing and now - match.arrival < self._wait:
            return False
        if self._lookup is not None:
            found = self._lookup(match)
            if found.T is None:
                assert match.complete is not None       # nothing that it needs is missing
                if not found.final and now - match.complete < self._pose_wait:
                    return False
                self._drop_head(found.reason)
                return True
            match.T_map_camera, match.T_body_camera = found.T, found.mount
        del self._matches[0]
        self.bytes -= match.size
        self._left = match.stamp
        leaving.append(match)
        return True

    def _drop_head(self, reason: str) -> None:
        match = self._matches.pop(0)
        self.bytes -= match.size
        self.dropped[reason] += 1
        self.on_drop(match, reason)

    def _prune(self, now: float) -> None:
        """Drop images that waited for long and that no label image held could take."""
        for kind, queue in self._queues.items():
            while (oldest := queue.oldest) is not None:
                passed = self._left is not None and oldest.stamp + self._tolerance < self._left
                if not passed and now - oldest.arrival < self._keep or self._wanted(oldest.stamp):
                    break
                self._drop_partner(kind)

    def _wanted(self, stamp: int) -> bool:
        """Return whether a label image is held within the tolerance of *stamp*."""
        i = bisect_left(self._matches, stamp - self._tolerance, key=_stamp)
        return i < len(self._matches) and self._matches[i].stamp <= stamp + self._tolerance

    def _drop_partner(self, kind: str, reason: str = '') -> None:
        self.bytes -= self._queues[kind].drop_oldest().size
        if kind == DEPTH or reason:
            self.dropped[f'{kind}: {reason}' if reason else UNUSED] += 1

    def _drop_oldest(self) -> None:
        """Make room: what arrived first goes."""
        heads = [(oldest.arrival, kind) for kind, queue in self._queues.items()
                 if (oldest := queue.oldest) is not None]
        first = min(heads, default=(float('inf'), ''))
        if self._matches and self._matches[0].arrival <= first[0]:
            self._drop_head(self._why_full(self._matches[0]))
        else:
            self._drop_partner(first[1], QUEUE_FULL)

    def _why_full(self, match: Match) -> str:
        """Return what the earliest label image waits for, if that is why the queue is full."""
        if self.needed & match.missing or self._lookup is None:
            return QUEUE_FULL
        return self._lookup(match).reason or QUEUE_FULL


def repeated(stamp: int) -> str:
    """Return the reason for a stamp that was there before."""
    return REPEATED if stamp else ZERO


def _stamp(match: Match) -> int:
    return match.stamp
