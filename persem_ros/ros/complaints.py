"""Warnings of what was dropped: which topic, why, what to do; once in a while for each reason."""

from __future__ import annotations

from collections import Counter
import logging
import time
from typing import TYPE_CHECKING

from persem_ros.inputs.live import BEHIND
from persem_ros.inputs.sync.match import DEPTH
from persem_ros.inputs.sync.pairing import NO_DEPTH, QUEUE_FULL
from persem_ros.ros.losses import remedy

if TYPE_CHECKING:
    from persem_ros.inputs.live import LiveIntake
    from persem_ros.ros.counters import Statistics
    from persem_ros.ros.inbox import Item
    from persem_ros.ros.topic import Input

log = logging.getLogger(__name__)
THROTTLE = 5.0          # s between two warnings for one reason
NOT_READY = 'came before the node was ready'


class Complaints:
    """
    Warns, on the worker's thread, of what it and the intake have dropped.

    Parameters
    ----------
    statistics : Statistics
        What was dropped, by reason.
    intake : LiveIntake
        Has examples of reasons.
    inputs : list of Input
        The topics, for warnings that name them.

    """

    def __init__(self, statistics: Statistics, intake: LiveIntake, inputs: list[Input]) -> None:
        """Nothing is dropped yet."""
        self._statistics, self._intake, self._inputs = statistics, intake, inputs
        self._warned: dict[str, float] = {}         # by reason: when
        self._reported: Counter[str] = Counter()    # drops that were warned of

    def say(self, reason: str, sentence: str) -> None:
        """Log a warning, once in a while for each reason."""
        self._statistics.error = sentence
        now = time.monotonic()
        if now - self._warned.get(reason, -THROTTLE) >= THROTTLE:
            self._warned[reason] = now
            log.warning('%s (%d so far)', sentence, self._statistics.dropped[reason])

    def drop(self, reason: str, sentence: str) -> None:
        """Count what was dropped for a reason that no intake counts, and say so."""
        self._statistics.dropped[reason] += 1
        self.say(reason, sentence)

    def lost(self, item: Item, ready: bool) -> None:
        """Count a message that the inbox had no room for; *ready*: kernels were compiled."""
        if not ready:
            self.drop(NOT_READY, f'{item.input.listened}: images came while kernels were '
                      'compiled or loaded, the oldest are dropped')
            return
        reason = QUEUE_FULL if item.input.role == 'labels' else f'{item.input.role}: {QUEUE_FULL}'
        self.drop(reason, f'{item.input.listened}: images come faster than they are mapped, '
                  'the oldest are dropped; a larger memory.stride or memory.voxel_size is '
                  'faster')

    def report(self, item: Item | None) -> None:
        """Warn of what was dropped since the last time; *item* came last."""
        dropped = self._statistics.losses()
        if dropped.total() == self._reported.total():
            return
        self._intake.explain()
        for reason in dropped - self._reported:
            if not reason.startswith('internal') and reason != 'frame refused':
                self._warn(reason, item)
        self._reported = dropped

    def _warn(self, reason: str, item: Item | None) -> None:
        """Warn of messages dropped for a reason; *item* came last."""
        role = reason.partition(':')[0] if ':' in reason else 'labels'
        names = [one.listened for one in self._inputs if one.role == role] or [role]
        stamp = item.input.stamp_of(item.data) if item is not None else None
        at = '' if stamp is None else f' near {stamp / 1e9:.3f} s'
        example = self._overloaded() if reason == BEHIND else \
            self._intake.examples.get(reason, '')
        if reason == NO_DEPTH:
            example += self._lost_depth()
        self.say(reason, f'{names[0]}{at}: dropped, {reason}'
                 + (f'; {example}' if example and example != reason else ''))

    def _overloaded(self) -> str:
        """Return what to do where frames come faster than they are mapped."""
        return (f'frames come faster than they are mapped ({self._statistics.frame_rate():.1f} Hz '
                'now), those that waited for long are left out so that images and map stay '
                'young; --set memory.stride=2 or a larger memory.voxel_size makes a frame cheaper')

    def _lost_depth(self) -> str:
        """Return what the numbers of label and depth images say, '' where they are equal."""
        few = self._intake.few_depths()
        depth = next((one for one in self._inputs if one.role == DEPTH and one.subscriptions),
                     None)
        if few is None or depth is None:
            return ''
        return (f'; {few[0]} depth images came for {few[1]} label images, the others were lost '
                f'on the way: {remedy(depth)}')
