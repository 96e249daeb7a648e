"""The services: each answers what happened, where the file is, how many voxels."""

from concurrent.futures import ThreadPoolExecutor
import logging
from pathlib import Path

from persem_ros.core.memory.dump import dump
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

log = logging.getLogger(__name__)


class Services:
    """
    ~/refine, ~/save_map, ~/load_map, ~/reset, ~/pause and ~/resume.

    What takes time happens on a thread; meanwhile the executor goes on taking messages (see
    `_Waiting`).

    Parameters
    ----------
    node : rclpy.node.Node
    worker : persem_ros.ros.worker.Worker
    legend : callable
        legend() gives the persem_ros.settings.legend.Legend in force.

    """

    def __init__(self, node, worker, legend):
        """Advertise the services."""
        self._worker, self._legend = worker, legend
        self._threads = ThreadPoolExecutor(4, 'service')
        self._done = node.create_guard_condition(lambda: None)
        # A group of its own: a service that waits would keep everything else of its group waiting.
        group = ReentrantCallbackGroup()
        for name in ('refine', 'save_map', 'load_map', 'reset', 'pause', 'resume'):
            node.create_service(Trigger, f'~/{name}', self._service(getattr(self, name)),
                                callback_group=group)

    def refine(self):
        """Refine the whole map with a fresh volatility; what came before it is part of it."""
        visited, took = self._worker.call(self._worker.refiner.ask).result().result()
        return f'refined {visited} voxels in {took:.3f} s'

    def save_map(self):
        """Save to map.path; only copying the map keeps the worker from mapping."""
        path = self._path()
        saved = self._worker.call(lambda: dump(self._worker.memory)).result()
        store.save(path, saved, self._worker.config, self._legend())
        return f'saved {len(saved.cell)} voxels to {path}'

    def load_map(self):
        """Load map.path in place of the map."""
        path = self._path()
        memory = store.load(path).memory(self._worker.config)
        memory.new_session()
        self._worker.call(self._worker.replace, memory).result()
        return f'loaded {memory.n_voxels} voxels from {path}'

    def reset(self):
        """Forget the map."""
        return f'forgot {self._worker.call(self._worker.reset).result()} voxels'

    def pause(self):
        """Integrate no more frames; they are still rendered from the map as it is."""
        return self._pause(True, 'paused')

    def resume(self):
        """Integrate frames again."""
        return self._pause(False, 'mapping')

    def close(self):
        """Wait for what is under way."""
        self._threads.shutdown()

    def _pause(self, paused, word):
        def change():
            before, self._worker.paused = self._worker.paused, paused
            return before
        before = self._worker.call(change).result()
        again = ' already' if before == paused else ''
        return f'{word}{again}, {self._worker.memory.n_voxels} voxels'

    def _path(self):
        """Return the absolute path of map.path; refuse an empty one."""
        path = self._worker.config.map.path
        if not path:
            raise PersemError('map.path is empty; name a file: ros2 param set <node> map.path '
                              '/absolute/path/map.persem')
        return Path(path).expanduser().absolute()

    def _service(self, work):
        async def serve(request, response):
            future = self._threads.submit(work)
            future.add_done_callback(lambda _: self._done.trigger())
            await _Waiting(future)
            try:
                response.success, response.message = True, future.result()
                log.info('%s', response.message)
            except PersemError as error:
                response.success, response.message = False, str(error)
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

    def __init__(self, future):
        self._future = future

    def __await__(self):
        """Yield to the executor until the future is done."""
        while not self._future.done():
            yield
