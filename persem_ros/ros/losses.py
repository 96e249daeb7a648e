"""What to do where messages are lost between publisher and node: docs/transports.md in a line."""

import logging
import time

from persem_ros.ros.topic import Input

log = logging.getLogger(__name__)
THROTTLE = 10.0         # s between two warnings of one topic
BUFFER = 'sudo sysctl -w net.core.rmem_max=268435456 lets the system hold more of it'


def remedy(one: Input) -> str:
    """Return what helps against losses of an image topic."""
    role, queue = one.role, one.depth
    if one.reliability != 'best_effort':
        return (f'although qos.{role} is reliable: they come faster than they are taken, or the '
                f'receive buffer is too small; -p qos.queue:={2 * queue} keeps more, {BUFFER}, '
                'compressed or smaller images cost less (docs/transports.md)')
    if one.setting == 'best_effort':
        return (f'best effort loses what does not fit into the receive buffer; '
                f'-p qos.{role}:=reliable asks for it again, {BUFFER} (docs/transports.md)')
    return (f'its publisher offers best effort only, which loses what does not fit into the '
            f'receive buffer; {BUFFER}; have the driver publish reliably, then '
            f'-p qos.{role}:=reliable (or auto) asks for it again (docs/transports.md)')


class Losses:
    """
    Warns of what the middleware says it has lost.

    Parameters
    ----------
    inputs : list of Input

    """

    def __init__(self, inputs: list[Input]) -> None:
        """Nothing is lost yet."""
        self._inputs = [one for one in inputs if one.is_image]
        self._told = dict.fromkeys(self._inputs, 0)
        self._when: dict[Input, float] = {}

    def look(self) -> None:
        """Warn of topics that have lost more, each once in a while."""
        now = time.monotonic()
        for one in self._inputs:
            if one.lost > self._told[one] and now - self._when.get(one, -THROTTLE) >= THROTTLE:
                log.warning('%s (%s): %d messages came, %d were lost on the way; %s', one.listened,
                            one.role, one.count, one.lost, remedy(one))
                self._told[one], self._when[one] = one.lost, now
