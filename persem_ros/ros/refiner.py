"""Refinements beside the mapping: begun and finished by the worker, computed on a thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Any, TYPE_CHECKING

from persem_ros.core.refine.job import abandon, finish
from persem_ros.core.refine.rules import at_rest, pressing, swept
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.warmup import warm_up
from persem_ros.errors import PersemError
from persem_ros.ros.priority import stand_back

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.core.refine.job import Job
    from persem_ros.ros.counters import Statistics
    from persem_ros.settings.config import Refine

Labels = tuple[Any, ...]        # what Job.compute gives and core.refine.job.finish takes


class Refiner:
    """
    One refinement at a time.

    All methods but the computing itself run on the worker's thread.

    Parameters
    ----------
    statistics : Statistics
        Learns how long refinements take.
    wake : callable
        Called from the computing thread when it is done.

    """

    def __init__(self, statistics: Statistics, wake: Callable[[], None]) -> None:
        """Start without a refinement."""
        self._statistics, self._wake = statistics, wake
        self._thread = ThreadPoolExecutor(1, 'refine', stand_back)
        self._job: Job | None = None
        self._result: Future[Labels] | None = None
        self._began = time.monotonic()
        # Of those who want a full refinement from here on, and of those for whom one is under
        # way, slice by slice.
        self._asked: list[Future[tuple[int, float]]] = []
        self._served: list[Future[tuple[int, float]]] = []
        self._asked_at = 0.0    # when that one began
        self.held = False       # whether none may begin

    @property
    def busy(self) -> bool:
        """Return whether a refinement is under way."""
        return self._job is not None

    def begin(self, memory: VoxelMemory, settings: Refine, stale: bool = True) -> bool:
        """
        Begin a refinement where one is due and none under way.

        Without anything new in the map (*stale* false) only that which was asked for is due.
        Returns whether one has begun after which there is nothing left to refine.

        """
        if self._job is not None or self.held:
            return False
        if memory.n_voxels:
            due = stale and time.monotonic() - self._began >= settings.period
            wanted = self._asked or self._served or due or pressing(memory)
            return self._begin(memory, settings) if wanted else False
        for future in self._asked + self._served:
            future.set_exception(PersemError('the map is empty, there is nothing to refine'))
        self._asked, self._served = [], []
        return False

    def finish(self, memory: VoxelMemory) -> bool:
        """Enter what has been computed; return whether labels may have changed."""
        if self._job is None or self._result is None or not self._result.done():
            return False
        job, result = self._job, self._result
        self._job = self._result = None
        if job.memory is not memory:        # the map was replaced meanwhile
            abandon(job)
            self._asked, self._served = self._asked + self._served, []
            return False
        error = result.exception()
        if error is not None:
            abandon(job)
            for future in self._served:
                future.set_exception(error)
            self._served = []
            raise error
        visited = finish(job, *result.result())
        self._statistics.refinements += 1
        self._statistics.refined_in = time.monotonic() - self._began
        self._statistics.visited = visited
        if swept(memory, job.settings):
            for future in self._served:
                future.set_result((memory.n_voxels, time.monotonic() - self._asked_at))
            self._served = []
        return visited > 0

    def ask(self) -> Future[tuple[int, float]]:
        """Ask for a full refinement begun from now on: (voxels visited, seconds)."""
        future: Future[tuple[int, float]] = Future()
        self._asked.append(future)
        return future

    def close(self) -> None:
        """Wait for what is being computed and forget it."""
        self._thread.shutdown()
        for future in self._asked + self._served:
            future.set_exception(PersemError('the node is shutting down'))

    def _begin(self, memory: VoxelMemory, settings: Refine) -> bool:
        self._began = time.monotonic()
        fresh = bool(self._asked) and not self._served
        if fresh:
            self._served, self._asked = self._asked, []
            self._asked_at = self._began
        self._job = begin_next(memory, settings, fresh)
        self._result = self._thread.submit(self._compute, self._job, settings)
        return at_rest(memory, settings)

    def _compute(self, job: Job, settings: Refine) -> Labels:
        try:
            if settings.method == 'geometry':       # chosen while the node was running
                warm_up(True)
            return job.compute()
        finally:
            self._wake()
