"""One warning when no complete set of messages comes: which topic, and why."""

import logging
import time

from persem_ros.ros.inputs import TF_STATIC

log = logging.getLogger(__name__)
PATIENCE = 5.0      # s


class Watchdog:
    """
    Looks after the inputs; its clock is the machine's, so that a paused /clock cannot stop it.

    Parameters
    ----------
    inputs : persem_ros.ros.inputs.Inputs
    statistics : persem_ros.ros.counters.Statistics

    Attributes
    ----------
    warned : bool
        No complete set has come for a while, and the warning is out.

    """

    def __init__(self, inputs, statistics):
        """Begin to wait."""
        self._inputs, self._statistics = inputs, statistics
        self._since = time.monotonic()
        self.warned = False

    def look(self):
        """Warn once when nothing has come for 5 s; say once that it comes again."""
        last = max(self._since, self._statistics.last_frame or 0.0)
        silent = time.monotonic() - last >= PATIENCE
        if silent and not self.warned:
            log.warning('no complete set of messages for %.0f s: %s', PATIENCE, self.describe())
        elif self.warned and not silent:
            log.info('complete sets of messages come again')
        self.warned = silent

    def describe(self):
        """Return what is known of each topic, in one sentence."""
        parts = []
        for one in self._inputs.all:
            if one.role == TF_STATIC or not (one.subscriptions or one.role == 'pose'):
                continue
            stamp = one.stamp
            last = 'no stamp' if stamp is None else f'last stamp {stamp / 1e9:.3f}'
            publishers = len(self._inputs.publishers(one))
            verdict = self._inputs.verdict(one)
            name = one.choices[one.chosen or 0][0]
            parts.append(f'{name} ({one.role}): {one.count} messages, {last}, {publishers} '
                         f'publishers, {verdict or "QoS fits"}')
        drops = ', '.join(f'{reason} ({n})' for reason, n in
                          sorted(dict(self._statistics.dropped).items()))
        return '; '.join(parts) + (f'; dropped: {drops}' if drops else '')
