"""
The grid out: ~/grid with costs and ~/grid_labels with classes, for vehicles on the ground.

What the worker pays is a copy of the records that changed. A grid goes out whole, latched, when
its rectangle grows or somebody new listens; between, ~/grid_updates carries the part that changed.

"""

from __future__ import annotations

from array import array
from concurrent.futures import Future, ThreadPoolExecutor
import logging
from typing import Any

from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.changes import Changes
from persem_ros.errors import PersemError
from persem_ros.outputs.grid.layers import Layers, TooLarge
from persem_ros.outputs.grid.rule import rule_of
from persem_ros.ros.map import LATCHED
from persem_ros.ros.messages import header
from persem_ros.ros.priority import stand_back
from persem_ros.ros.wording import as_ros
from rclpy.clock import Clock, ClockType
try:
    from map_msgs.msg import OccupancyGridUpdate
except ImportError:         # then grids go out whole
    OccupancyGridUpdate = None

log = logging.getLogger(__name__)
SLICE = 100_000         # voxels that are taken in at once
LOOK = 0.1              # s between two looks at who listens
MOST_ID = 127           # of a class in an int8; larger ones are unknown in ~/grid_labels
NAMES = {'grid': 'cost', 'grid_labels': 'label'}     # topic: layer


class GridOutputs:
    """
    Publishers of the grid.

    Parameters
    ----------
    node : rclpy.node.Node
        Has the worker, the settings and the legend in force (colors()).

    """

    def __init__(self, node: Any) -> None:
        """Advertise the topics; nothing is computed before somebody listens."""
        self._node, self._alive = node, node.context.ok
        self._out = {name: node.create_publisher(OccupancyGrid, f'~/{name}', LATCHED)
                     for name in NAMES}
        self._updates = {} if OccupancyGridUpdate is None else {
            name: node.create_publisher(OccupancyGridUpdate, f'~/{name}_updates', 10)
            for name in NAMES}
        self._changes = Changes()
        self._layers: Layers | None = None
        self._key: Any = None
        self._listeners = dict.fromkeys(NAMES, 0)
        self._whole: set[str] = set()       # topics that must go out whole
        self._complaint = ''
        self._last = 0
        self._thread = ThreadPoolExecutor(1, 'grid', stand_back)
        self._job: Future[None] | None = None
        self._asked: Future[None] | None = None
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(LOOK, self._look, clock=self._clock)

    def close(self) -> None:
        """Wait for what is being published."""
        self._thread.shutdown()

    def _look(self) -> None:
        """Have the worker hand over what changed, when somebody listens and it is time."""
        rate, now = self._node.worker.config.grid.rate, self._clock.now().nanoseconds
        if not rate or any(one is not None and not one.done() for one in (self._job, self._asked)):
            return
        listeners = {name: out.get_subscription_count() for name, out in self._out.items()}
        self._whole |= {name for name, n in listeners.items() if n > self._listeners[name]}
        self._listeners = listeners
        if now - self._last >= 1e9 / rate and self._node.worker.ready.is_set():
            self._last = now
            self._asked = self._node.worker.call(self._take, any(listeners.values()))

    def _take(self, wanted: bool) -> None:
        """Take what changed, on the worker's thread, and have it published."""
        memory, config, legend = (self._node.worker.memory, self._node.worker.config,
                                  self._node.colors())
        if not wanted:
            self._changes.close()
            self._layers = self._key = None
            return
        if not memory.n_voxels and self._layers is None:
            return
        key = config.grid, config.refine.up, legend
        if self._layers is None or self._key != key:
            self._changes.close()
            self._key = key
            try:
                self._layers = Layers(rule_of(config, legend, memory.voxel_size),
                                      memory.voxel_size, config.grid.resolution, config.grid.tie)
            except PersemError as error:
                self._layers = None
                self._complain(f'no {self._out["grid"].topic_name}: {error}')
                return
            self._whole |= set(NAMES)
        frames = memory.frames
        centre = frames.here('placed')[-1, :3, 3] if len(frames) else np.array(memory.origin)
        stamp = int(frames.here('stamp')[-1]) if len(frames) else 0
        changed = self._changes.take(memory, centre, SLICE)
        self._job = self._thread.submit(self._publish, self._layers, changed, stamp,
                                        config.frames.map)

    def _publish(self, layers: Layers, changed: Any, stamp: int, frame: str) -> None:
        """Compute and publish, beside the mapping."""
        try:
            box, grown = layers.update(changed)
            if grown:
                self._whole = set(NAMES)
            if not layers.cells.cost.size:
                return
            for name, layer in NAMES.items():
                if not self._listeners[name]:
                    continue
                values = getattr(layers.cells, layer)
                if name in self._whole or box is not None and not self._updates:
                    self._out[name].publish(whole(values, layers.cells, stamp, frame))
                elif box is not None:
                    self._updates[name].publish(part(values, box, stamp, frame))
                self._whole.discard(name)
        except TooLarge as error:
            self._complain(f'no {self._out["grid"].topic_name}: {error} are too many for one '
                           'grid; a larger grid.resolution or a memory.keep_radius makes it '
                           'smaller')
        except Exception:       # noqa: B902  whatever it is, mapping goes on
            if self._alive():
                log.exception('the grid could not be published')

    def _complain(self, sentence: str) -> None:
        """Warn, once of the same."""
        if sentence != self._complaint:
            self._complaint = sentence
            log.warning('%s', as_ros(sentence))


def shown(values: NDArray[Any]) -> NDArray[np.int8]:
    """Return costs as they are, class ids as int8: -1 for none and those above 127."""
    if values.dtype == np.int8:
        return values
    return np.where(values <= MOST_ID, values, 255).astype(np.uint8).view(np.int8)


def whole(values: NDArray[Any], cells: Any, stamp: int, frame: str) -> Any:
    """Return an OccupancyGrid of costs or class ids; map.origin is taken off, as in ~/map."""
    grid = OccupancyGrid(header=header(stamp, frame), data=_data(shown(values)))
    grid.info.map_load_time = grid.header.stamp
    grid.info.resolution = float(cells.size)
    grid.info.height, grid.info.width = values.shape
    grid.info.origin.position.x, grid.info.origin.position.y = (
        float(c * cells.size) for c in cells.corner)
    grid.info.origin.orientation.w = 1.0
    return grid


def part(values: NDArray[Any], box: tuple[int, int, int, int], stamp: int, frame: str) -> Any:
    """Return the OccupancyGridUpdate of a box of cells, x0 y0 x1 y1."""
    x0, y0, x1, y1 = box
    return OccupancyGridUpdate(header=header(stamp, frame), x=x0, y=y0, width=x1 - x0,
                               height=y1 - y0, data=_data(shown(values[y0:y1, x0:x1])))


def _data(values: NDArray[np.int8]) -> array[int]:
    """Return cells as array.array, which a message takes without looking at each."""
    data = array('b')
    data.frombytes(np.ascontiguousarray(values).tobytes())
    return data
