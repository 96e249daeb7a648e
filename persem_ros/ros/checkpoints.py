"""Checkpoints of an attached map: copied between frames, written beside them (spec section 9)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import logging
import time
from typing import TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.ros.priority import stand_back

if TYPE_CHECKING:
    from persem_ros.core.memory.checkpoint import Checkpoint
    from persem_ros.core.memory.paging import Pager

log = logging.getLogger(__name__)
AGAIN = 2.0         # s after which a checkpoint that failed is tried again
THROTTLE = 60.0     # s between two warnings
CANNOT = 'map file cannot be written'


class Checkpoints:
    """
    One checkpoint at a time; all methods but the writing run on the worker's thread.

    Parameters
    ----------
    wake : callable
        Called from the writing thread when it is done.

    Attributes
    ----------
    failing : bool
        Whether the last one could not be written.

    """

    def __init__(self, wake: Callable[[], None]) -> None:
        """Begin with none."""
        self._wake = wake
        self._thread = ThreadPoolExecutor(1, 'checkpoint', stand_back)
        self._current: Checkpoint | None = None
        self._result: Future[None] | None = None
        self._asked: list[Future[None]] = []
        self._served: list[Future[None]] = []
        self.failing = False
        self._tried = self._written = time.monotonic()
        self._warned = -THROTTLE

    def ask(self) -> Future[None]:
        """Ask for a checkpoint begun from now on."""
        future: Future[None] = Future()
        self._asked.append(future)
        return future

    def step(self, pager: Pager, period: float, max_voxels: int) -> None:
        """Go on with the checkpoint under way, or begin one that is due."""
        if self._current is None:
            if self._due(pager, period, max_voxels):
                self._current, self._tried = pager.checkpoint(), time.monotonic()
                self._served, self._asked = self._asked, []
        elif self._result is None:
            if self._current.capture.step():
                self._result = self._thread.submit(self._write, self._current)
        elif self._result.done():
            self._end(self._current, self._result)

    def settle(self) -> None:
        """Wait for the checkpoint under way and end it, whatever has become of it."""
        if self._current is not None and self._result is not None:
            self._result.exception()
            self._end(self._current, self._result)
        elif self._current is not None:
            self._current.end()
            self._current, self._asked = None, self._served + self._asked

    def close(self) -> None:
        """Begin no more of them."""
        self.settle()
        self._thread.shutdown()
        for future in self._asked:
            future.set_exception(PersemError('the node is shutting down'))

    def _due(self, pager: Pager, period: float, max_voxels: int) -> bool:
        """Return whether one should begin now."""
        if self._asked:
            return True
        since = time.monotonic() - self._tried
        if since < min(AGAIN, period):
            return False
        crowded = 0 < max_voxels < pager.memory.n_voxels
        if not crowded and since < period:
            return False
        dirty = pager.dirty_voxels
        return dirty > 0 and (since >= period or pager.memory.n_voxels - dirty < max_voxels // 10)

    def _write(self, checkpoint: Checkpoint) -> None:
        try:
            checkpoint.write()
        finally:
            self._wake()

    def _end(self, current: Checkpoint, result: Future[None]) -> None:
        """Say how it went to those who asked, or once a minute where it went wrong."""
        error, served = result.exception(), self._served
        self._current, self._result, self._served = None, None, []
        current.end()
        now = time.monotonic()
        self.failing = error is not None
        for future in served:
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)
        if error is None:
            self._written = now
        elif now - self._warned >= THROTTLE:
            self._warned = now
            log.warning('%s; mapping goes on, what is in the file is %.0f s old', error,
                        now - self._written)
