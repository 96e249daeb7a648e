"""One warning when no complete set of messages comes: which topic, and why."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from persem_ros.inputs.sync.match import LABELS

if TYPE_CHECKING:
    from persem_ros.ros.counters import Statistics
    from persem_ros.ros.inputs import Inputs
    from persem_ros.ros.topic import Input

log = logging.getLogger(__name__)
PATIENCE = 5.0      # s
SILENCE = 2.0       # s that poses are away for at the end, which may run on after the last image
MISSING = 'no complete frame'


class Watchdog:
    """
    Looks after the inputs; its clock is the machine's, so that a paused /clock cannot stop it.

    Parameters
    ----------
    inputs : persem_ros.ros.inputs.Inputs
    statistics : persem_ros.ros.counters.Statistics

    Attributes
    ----------
    state : str
        '' while complete sets come, 'no complete frame' where something is missing, 'nothing
        comes any more' where all is quiet after frames had come.

    """

    def __init__(self, inputs: Inputs, statistics: Statistics) -> None:
        """Begin to wait with the first look."""
        self._inputs, self._statistics = inputs, statistics
        self._since: float | None = None
        self._told: list[str] = []      # what stood in the way of each topic at the last warning
        self._found = self._told, 0.0
        self.state = ''

    def look(self) -> None:
        """
        Warn when no frame was complete for 5 s, again when that has another reason.

        A driver that starts later may bring a topic that does not fit. Says once that frames come
        again.

        """
        if self._since is None:
            self._since = time.monotonic()
        last = max(self._since, self._statistics.last_frame or 0.0)
        before, self.state = self.state, ''
        if time.monotonic() - last >= PATIENCE:
            self.state = 'nothing comes any more' if self._ended() else MISSING
        if self.state == before and not (self.state == MISSING and self._differs()):
            return
        if self.state == 'nothing comes any more':
            log.warning('nothing comes any more: %d frames were mapped, for %.0f s no topic has '
                        'brought anything (has the recording ended?)', self._statistics.frames,
                        self._silence())
        elif self.state:
            self._told = self._obstacles()
            log.warning('no complete set of messages for %.0f s: %s', PATIENCE, self.describe())
        elif before:
            log.info('complete sets of messages come again')

    def describe(self) -> str:
        """Return what is known of each topic, in one sentence."""
        parts = [self._describe(one) for one in self._inputs.needed]
        drops = ', '.join(f'{reason} ({n})' for reason, n in
                          sorted(self._statistics.losses().items()))
        return '; '.join(parts) + (f'; dropped: {drops}' if drops else '')

    def _describe(self, one: Input) -> str:
        stamp = one.stamp
        last = 'no stamp' if stamp is None else f'last stamp {stamp / 1e9:.3f}'
        if one.came is not None and time.monotonic() - one.came >= PATIENCE:
            last += f', {time.monotonic() - one.came:.0f} s ago'
        lost = f', {one.lost} lost on the way' if one.lost else ''
        publishers = len(self._inputs.publishers(one))
        verdict = self._inputs.verdict(one) or f'QoS fits ({one.reliability})'
        return (f'{one.listened} ({one.role}): {one.count} messages{lost}, {last}, {publishers} '
                f'publishers, {verdict}')

    def _obstacles(self) -> list[str]:
        return [self._inputs.verdict(one) if one.count == 0 else '' for one in self._inputs.needed]

    def _differs(self) -> bool:
        """Whether what stands in the way is another than was told, and has been for a while."""
        found, now = self._obstacles(), time.monotonic()
        if found != self._found[0]:
            self._found = found, now
        return found != self._told and now - self._found[1] >= PATIENCE

    def _ended(self) -> bool:
        """
        Whether frames had come and no topic brings anything any more.

        Where every label image that came is mapped nothing is missing: then a shorter silence of
        the other topics will do.

        """
        mapped = self._statistics.last_frame
        waiting = [one for one in self._inputs.needed if one.role == LABELS
                   and one.came is not None and mapped is not None and one.came > mapped]
        return self._statistics.frames > 0 \
            and self._silence() >= (PATIENCE if waiting else SILENCE)

    def _silence(self) -> float:
        """Return the seconds since any topic has brought anything, 0 where none has yet."""
        came = [one.came for one in self._inputs.needed if one.came is not None]
        return time.monotonic() - max(came) if came else 0.0
