"""The services: each answers what happened, where the file is, how many voxels."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
import logging
import threading
import time
from typing import Any, TYPE_CHECKING

from persem_ros.core.memory.capture import Capture
from persem_ros.core.refine.whole import refine_all
from persem_ros.errors import PersemError
from persem_ros.ros.map_path import path_of
from persem_ros.ros.priority import stand_back
from persem_ros.ros.wording import as_ros
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from persem_ros.core.memory.dump import MemoryDump
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.ros.map_file import MapFile
    from persem_ros.ros.worker import Worker
    from rclpy.node import Node

log = logging.getLogger(__name__)


class Services:
    """
    ~/refine, ~/save_map, ~/load_map, ~/reset, ~/pause and ~/resume.

    What takes time happens on a thread; meanwhile the executor goes on taking messages (see
    `_Waiting`).

    Parameters
    ----------
    node : rclpy.node.Node
    worker : Worker
    map_file : MapFile
        Reads and writes map.path.

    """

    def __init__(self, node: Node, worker: Worker, map_file: MapFile) -> None:
        """Advertise the services."""
        self._worker, self._map_file = worker, map_file
        self._threads = ThreadPoolExecutor(4, 'service', stand_back)
        self._refining = threading.Lock()
        self._done = node.create_guard_condition(lambda: None)
        # A group of its own: a service that waits would keep everything else of its group waiting.
        group = ReentrantCallbackGroup()
        for name in ('refine', 'save_map', 'load_map', 'reset', 'pause', 'resume'):
            node.create_service(Trigger, f'~/{name}', self._service(getattr(self, name)),
                                callback_group=group)

    def refine(self) -> str:
        """Refine the whole map with a fresh volatility; what came before it is part of it."""
        if self._worker.memory.pager is not None:
            return self._refine_attached()
        visited, took = self._worker.call(self._worker.refiner.ask).result().result()
        return f'refined {visited} voxels in {took:.3f} s'

    def save_map(self) -> str:
        """Save to map.path; the worker copies what is needed in slices between frames."""
        if self._worker.memory.pager is not None:
            self._worker.call(self._worker.checkpoints.ask).result().result()
            return self._map_file.described()
        return self._map_file.save(self._worker.config, self._captured)

    def load_map(self) -> str:
        """Load map.path in place of the map."""
        if self._worker.memory.pager is not None:
            raise PersemError(f'{path_of(self._worker.config)} is attached, it is the map '
                              'already; start the node with another map.path')
        memory = self._map_file.load(self._worker.config)
        self._worker.call(self._worker.replace, memory, self._map_file.legend).result()
        return f'loaded {memory.n_voxels} voxels from {path_of(self._worker.config)}'

    def reset(self) -> str:
        """Forget the map."""
        return f'forgot {self._worker.call(self._worker.reset).result()} voxels'

    def pause(self) -> str:
        """Integrate no more frames; they are still rendered from the map as it is."""
        return self._pause(True, 'paused')

    def resume(self) -> str:
        """Integrate frames again."""
        return self._pause(False, 'mapping')

    def close(self) -> None:
        """Wait for what is under way."""
        self._threads.shutdown()

    def _refine_attached(self) -> str:
        """Refine what is in memory and in the file, step by step between frames."""
        worker, begun, visited = self._worker, time.monotonic(), 0
        with self._refining:
            try:
                worker.refiner.held = True
                while worker.refiner.busy:
                    time.sleep(0.01)
                steps = refine_all(worker.memory, worker.config.refine,
                                   worker.config.memory.max_voxels, saves=False)
                while (step := worker.call(next, steps, None).result()) is not None:
                    visited += step
                    self._wait_for_room()
                worker.call(worker.refined).result()
            finally:
                worker.refiner.held = False
        if not visited:
            raise PersemError('the map is empty, there is nothing to refine')
        return f'refined {visited} voxels in {time.monotonic() - begun:.3f} s'

    def _wait_for_room(self) -> None:
        """Have what was labelled written where memory is crowded, so that it can leave."""
        worker, bound = self._worker, self._worker.config.memory.max_voxels
        if 0 < 1.2 * bound < worker.memory.n_voxels and not worker.checkpoints.failing:
            worker.call(worker.checkpoints.ask).result().result()

    def _captured(self) -> tuple[MemoryDump, VoxelMemory, int]:
        """Return what MapFile.copied() does."""
        worker = self._worker

        def begin() -> tuple[Capture, VoxelMemory, int]:
            return Capture(worker.memory), worker.memory, worker.statistics.forgotten
        capture, memory, forgotten = worker.call(begin).result()
        try:
            while not worker.call(capture.step).result():
                pass
            return capture.dump(), memory, forgotten
        finally:
            capture.close()

    def _pause(self, paused: bool, word: str) -> str:
        def change() -> bool:
            before, self._worker.paused = self._worker.paused, paused
            return before
        before = self._worker.call(change).result()
        again = ' already' if before == paused else ''
        return f'{word}{again}, {self._worker.memory.n_voxels} voxels'

    def _service(self, work: Callable[[], str]) -> Callable[[Any, Any], Awaitable[Any]]:
        async def serve(request: Any, response: Any) -> Any:
            future = self._threads.submit(work)
            future.add_done_callback(lambda _: self._done.trigger())
            await _Waiting(future)
            try:
                response.success, response.message = True, future.result()
                log.info('%s', response.message)
            except PersemError as error:
                response.success, response.message = False, as_ros(str(error))
                log.warning('%s: %s', work.__name__, error)
            except Exception as error:      # noqa: B902  the node outlives a failing service
                response.success = False
                response.message = f'internal error: {type(error).__name__}: {error}'
                log.exception('%s failed', work.__name__)
            return response
        return serve


class _Waiting:
    """
    Awaits a concurrent Future on rclpy's executor.

    The executor asks an unfinished coroutine whenever anything else wakes it; it needs a guard
    condition to be woken for the coroutine's sake.

    """

    def __init__(self, future: Future[str]) -> None:
        self._future = future

    def __await__(self) -> Generator[None, None, None]:
        """Yield to the executor until the future is done."""
        while not self._future.done():
            yield
