"""What changed in a memory since the last time, on its way to the store (spec section 9)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from persem_ros.core.memory.capture import Capture
from persem_ros.core.memory.frame_pages import pages_of

if TYPE_CHECKING:
    from persem_ros.core.memory.paging import Pager


class Checkpoint:
    """
    What changed since the last checkpoint.

    The owner of the map calls capture.step() until it is True; any thread then calls write(), and
    the owner end().

    """

    def __init__(self, pager: Pager) -> None:
        self._pager = pager
        self.capture = Capture(pager.memory, pager.moment)
        self.written = False

    def write(self) -> None:
        """Write what was captured; whatever the store raises passes."""
        changed = self.capture.dump()
        self._pager.backing.write(changed)
        self._stored = changed.block_index, pages_of(changed), len(changed.frames)
        self.written = True

    def end(self) -> bool:
        """Note what the store holds now; return whether it was written."""
        self.capture.close()
        if self.written:
            self._pager.moment = max(self._pager.moment, self.capture.moment)
            self._pager.note_stored(*self._stored)
        return self.written
