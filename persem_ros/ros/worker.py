"""The one thread that owns the map: takes messages, integrates, renders, publishes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
import ctypes
import logging
import threading
import time
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.render import render_map
from persem_ros.core.jit import Compiling
from persem_ros.core.warmup import warm_up
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.intake import LEGEND, TF, TRAJECTORY
from persem_ros.pipeline import Pipeline
from persem_ros.ros.calls import Answer, Calls
from persem_ros.ros.checkpoints import CANNOT, Checkpoints
from persem_ros.ros.complaints import Complaints
from persem_ros.ros.forgetting import Forgetting
from persem_ros.ros.images import NO_SOURCE
from persem_ros.ros.jumps import Jumps
from persem_ros.ros.map_schedule import ALL, MapSchedule
from persem_ros.ros.mover import Mover
from persem_ros.ros.refiner import Refiner
from persem_ros.settings.heights import hinted

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Frame
    from persem_ros.inputs.live import LiveIntake
    from persem_ros.ros.counters import Statistics
    from persem_ros.ros.first_look import FirstLook
    from persem_ros.ros.images import ImageOutputs
    from persem_ros.ros.inbox import Inbox, Item
    from persem_ros.ros.map import MapOutputs
    from persem_ros.ros.topic import Input
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)
TICK = 0.05             # s between two looks at frames that wait for what does not come


class _Stopped(BaseException):
    """Ends the thread while kernels are compiled; nothing catches it on its way."""


class Worker(threading.Thread):
    """
    Owns the pipeline and its memory; everybody else asks it through `call`.

    Parameters
    ----------
    config : Config
    statistics : Statistics
    memory : VoxelMemory, optional
        A map to go on with.

    Attributes
    ----------
    pipeline : Pipeline
    paused : bool
        True: frames are rendered and not integrated.
    ready : threading.Event
        Set when the kernels are compiled.

    """

    def __init__(self, config: Config, statistics: Statistics,
                 memory: VoxelMemory | None = None) -> None:
        """Make an empty map, or go on with *memory*."""
        super().__init__(name='worker', daemon=True)
        self.pipeline, self._given = Pipeline(config, memory), config
        self._keep_all()
        self.statistics = statistics
        self.paused = False
        self.ready = threading.Event()
        self.refiner = Refiner(statistics, self._wake)
        self.checkpoints = Checkpoints(self._wake)
        self.mover = Mover(Decoder(), self._wake)
        # Told that the map goes on in another memory.
        self.replaced: Callable[[VoxelMemory, VoxelMemory], None] = lambda old, new: None
        self._jumps = Jumps(config)
        # Gives the memory of an empty map, None: any.
        self.renew: Callable[[], VoxelMemory | None] = lambda: None
        self._calls, self._forgetting = Calls(self._wake), Forgetting()
        self._ending = False
        self._unrefined = memory is not None    # whether a full refinement would find anything

    def connect(self, inbox: Inbox, intake: LiveIntake, images: dict[str, ImageOutputs],
                maps: MapOutputs, inputs: list[Input], first_look: FirstLook) -> None:
        """
        Say where messages come from and results go, before the start.

        Parameters
        ----------
        inbox : Inbox
            Messages.
        intake : LiveIntake
            Messages to frames.
        images : dict
            Refined images, by camera.
        maps : MapOutputs
            The map.
        inputs : list
            The topics, for warnings that name them.
        first_look : FirstLook
            Checks what comes first.

        """
        self.inbox, self.intake, self.images, self.map = inbox, intake, images, maps
        self.inputs, self.first_look = inputs, first_look
        self._complaints = Complaints(self.statistics, intake, inputs)
        self._schedule = MapSchedule(maps)
        self._hint()

    @property
    def config(self) -> Config:
        """Return the settings in force."""
        return self.pipeline.config

    @property
    def memory(self) -> VoxelMemory:
        """Return the map."""
        return self.pipeline.memory

    def call(self, function: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        """Have the worker call function(*arguments) between two frames."""
        return self._calls.ask(function, *arguments)

    def stop(self) -> None:
        """End the thread after the frame that it is at."""
        self._ending = self._calls.closed = True
        self._wake()
        while self.is_alive() and not self.ready.is_set():      # compiling takes a minute
            assert self.ident is not None       # it is alive
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident),
                                                       ctypes.py_object(_Stopped))
            self.join(0.1)
        if self.ident is not None:
            self.join()
        self._calls.refuse()
        self.refiner.close()
        self.checkpoints.close()
        self.mover.close()
        self.first_look.close()
        self.map.close()

    def run(self) -> None:
        """Work until stopped; whatever goes wrong is logged and counted."""
        try:
            geometry = self.config.refine.method == 'geometry'
            with Compiling(*['geometry'] if geometry else []):
                self._guarded(warm_up, geometry)
            self.intake.begin()
            self.ready.set()
            log.info('ready')
            while not self._ending:
                item = self.inbox.get(TICK)
                self._guarded(self._step, item)
        except _Stopped:
            pass

    def configure(self, config: Config) -> None:
        """Go on with other settings, between two frames."""
        self._given = config
        self._hint()
        self.intake.configure(config)
        self.inbox.configure(config.sync)

    def _hint(self) -> None:
        """Go by the settings that were given, and by the heights that the legend tells."""
        config = hinted(self._given, self.intake.names.legend)
        self._unrefined |= config.refine != self.config.refine
        self.pipeline.config = config

    def replace(self, memory: VoxelMemory | None, legend: Legend | None = None) -> None:
        """Go on with another map and its classes; None: an empty one, the classes as they are."""
        if legend is not None and not self.config.labels.legend:
            self.intake.names = self.intake.names.under(self.config, legend)
            self._hint()
            self.map.publish_legend()
        self.pipeline = Pipeline(self.config, memory)
        self._keep_all()
        self._schedule.stale |= ALL
        self._unrefined = memory is not None

    def reset(self) -> int:
        """Forget the map and whatever waits; return how many voxels there were."""
        count = self.memory.n_voxels
        self._begin_anew()
        self.intake.clear()
        return count

    def _begin_anew(self) -> None:
        """Go on with an empty map; a file that is attached is moved aside."""
        self.checkpoints.settle()
        self.replace(self.renew())

    def refined(self) -> None:
        """Show the map anew: labels have changed."""
        self._schedule.stale |= ALL

    def jumped(self) -> None:
        """Time went back: a new session begins, or a new map."""
        if self.config.map.on_time_jump == 'reset':
            self._begin_anew()
        else:
            self.memory.new_session()
        log.warning('time went back (a recording that loops, or a clock that was set): queues '
                    'and poses are cleared, the map is %s (map.on_time_jump)',
                    'reset' if self.config.map.on_time_jump == 'reset' else 'kept')

    def lost(self, item: Item) -> None:
        """Count a message that the inbox had no room for; from any thread."""
        self.call(self._complaints.lost, item, self.ready.is_set())

    def _wake(self) -> None:
        self.inbox.wake()

    def _guarded(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function; the node outlives whatever it raises."""
        try:
            function(*arguments)
        except Exception as error:      # noqa: B902
            if self._ending:
                return
            reason = f'internal error: {type(error).__name__}'
            self._complaints.drop(reason, f'{reason}: {error}')
            log.debug('traceback', exc_info=True)

    def _step(self, item: Item | None) -> None:
        """Take one message, or look at what waits; then whatever else is due."""
        now = time.monotonic_ns() if item is None else item.arrival
        if item is not None:
            self._take(item)
        self.first_look.step(self.config, self.inputs)
        for frame in self.intake.leaving(now):
            self._frame(frame, now)
        if self.intake.behind:
            self._skip()
        self._complaints.report(item)
        self._calls.answer()
        if self.refiner.finish(self.memory):
            self._schedule.stale |= ALL
        self._move()
        self._forget_far()
        if self.memory.pager is not None:
            self.checkpoints.step(self.memory.pager, self.config.map.checkpoint,
                                  self.config.memory.max_voxels)
        if self.refiner.begin(self.memory, self.config.refine, self._unrefined):
            self._unrefined = False
        self._schedule.step(self.memory, self.config.map, self.inbox.bytes > 0)

    def _skip(self) -> None:
        """Go on with the newest label image that waits: those before it are old."""
        found = self.inbox.skip(self.intake.offset, round(self.config.sync.tolerance * 1e9))
        self.intake.skip(*found or (0, 0))

    def _move(self) -> None:
        """Go on in a map that has moved, when it is there."""
        moved = self.mover.step(self.memory, self.config)
        if moved is not None:
            self.replaced(self.memory, moved)
            self.pipeline = Pipeline(self.config, moved)
            self._schedule.stale |= ALL
            self._unrefined = True

    def _keep_all(self) -> None:
        """Drop no observation where a corrected trajectory may have to move it."""
        if self.config.topics.trajectory:
            self.memory.keeps_all = True        # max_history bounds what a refinement reads

    def _take(self, item: Item) -> None:
        if item.input.role == TRAJECTORY:
            self.mover.take(item.data)
            return
        for taker in item.input.takers:
            self.intake.take(item.input.role, taker, item.kind, item.arrival, item.data)
        if item.input.role == LEGEND:
            self._hint()
            self.map.publish_legend()
        elif item.input.role == TF:
            self._jumps.look(item.input.takers, self.config)
        self.first_look.take(item)

    def _frame(self, frame: Frame, now: int) -> None:
        """Integrate one frame, publish what is wanted of it."""
        if self._overfull():
            self.statistics.dropped[CANNOT] += 1
            return
        try:
            observations = None if self.paused else self.pipeline.add(frame)
        except PersemError as error:
            self._complaints.drop('frame refused', f'a frame was dropped: {error}')
            return
        outputs = self.images[frame.sensor]
        wanted = outputs.wanted()
        if wanted:
            labels = self.pipeline.render(frame, observations)
            outputs.publish(wanted, frame, labels, lambda: self._sources(frame, observations))
        if observations is not None:
            self.mover.note(observations)
            self._schedule.stale.add('map')
            self._unrefined = True
        self.statistics.frame((time.monotonic_ns() - now) / 1e9)

    def _overfull(self) -> bool:
        """Return whether memory has no room for what the map's file does not take."""
        bound = self.config.memory.max_voxels
        return self.memory.pager is not None and self.checkpoints.failing and \
            0 < 2 * bound < self.memory.n_voxels

    def _forget_far(self) -> None:
        """Keep the map within its bounds, between refinements."""
        # What ~/refine visits in an attached map is far away, and leaves when it was visited.
        if self.refiner.busy or self.refiner.held:
            return
        gone = self._forgetting.step(self.memory, self.config.memory)
        if gone:
            self.statistics.forgotten += gone
            self._schedule.stale |= ALL

    def _sources(self, frame: Frame, observations: Observations | None) -> NDArray[np.uint8]:
        """Return which step decided each pixel of the depth grid."""
        voxels = self.pipeline.voxel_image(frame, observations)
        image = render_map(self.memory, voxels, source=True)
        return np.where(voxels < 0, NO_SOURCE, image).astype(np.uint8)
