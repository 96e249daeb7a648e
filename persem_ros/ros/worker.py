"""The one thread that owns the map: takes messages, integrates, renders, publishes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
import ctypes
import logging
import queue
import threading
import time
from typing import Any, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.render import render_map
from persem_ros.core.jit import Announcement
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.warmup import warm_up
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.intake import LEGEND, TF, TRAJECTORY
from persem_ros.inputs.live import BEHIND
from persem_ros.inputs.sync.pairing import DEPTH, NO_DEPTH, QUEUE_FULL
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.pipeline import Pipeline
from persem_ros.ros.checkpoints import CANNOT, Checkpoints
from persem_ros.ros.images import NO_SOURCE
from persem_ros.ros.losses import remedy
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

Answer = TypeVar('Answer')
Call = tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]

log = logging.getLogger(__name__)
TICK = 0.05             # s between two looks at frames that wait for what does not come
TRIM = 0.5              # s between two looks at what is too far away
AT_ONCE = 20_000        # voxels that are forgotten between two frames
THROTTLE = 5.0          # s between two warnings for one reason
NOT_READY = 'came before the node was ready'
LOOK = 0.1              # s between two looks at who listens to the map
JUMP = 0.3              # m that a localisation goes at once where it jumps, or voxels if larger
CHANGES = 1.0           # s after which changes are told however busy the node is


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
        self._watch_jumps = not config.topics.trajectory
        # Gives the memory of an empty map, None: any.
        self.renew: Callable[[], VoxelMemory | None] = lambda: None
        self._calls: queue.SimpleQueue[Call] = queue.SimpleQueue()
        self._ending = False
        self._mapped = self._trimmed = self._looked = self._changed = time.monotonic()
        # What the map's topics have not shown yet: 'map', 'changes'.
        self._stale: set[str] = set()
        self._unrefined = memory is not None    # whether a full refinement would find anything
        self._shown = False         # an empty map is shown only after one that was not
        self._stamp = 0             # of the last frame
        self._warned: dict[str, float] = {}         # by reason: when
        self._reported: Counter[str] = Counter()    # drops that were warned of

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
        future: Future[Answer] = Future()
        if self._ending:
            future.set_exception(PersemError('the node is shutting down'))
        else:
            self._calls.put((future, function, arguments))
            self._wake()
        return future

    def stop(self) -> None:
        """End the thread after the frame that it is at."""
        self._ending = True
        self._wake()
        while self.is_alive() and not self.ready.is_set():      # compiling takes a minute
            assert self.ident is not None       # it is alive
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident),
                                                       ctypes.py_object(_Stopped))
            self.join(0.1)
        if self.ident is not None:
            self.join()
        while not self._calls.empty():
            self._calls.get()[0].set_exception(PersemError('the node is shutting down'))
        self.refiner.close()
        self.checkpoints.close()
        self.mover.close()
        self.first_look.close()
        self.map.close()

    def run(self) -> None:
        """Work until stopped; whatever goes wrong is logged and counted."""
        try:
            geometry = self.config.refine.method == 'geometry'
            with Announcement(*['geometry'] if geometry else []):
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
        self._stale = {'map', 'changes'}
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
        self._stale |= {'map', 'changes'}

    def jumped(self) -> None:
        """Time went back: a new session begins, or a new map."""
        if self.config.map.on_time_jump == 'reset':
            self._begin_anew()
        else:
            self.memory.new_session()
        log.warning('time went back (a recording that loops, or a clock that was set): queues '
                    'and poses are cleared, the map is %s (map.on_time_jump)',
                    'reset' if self.config.map.on_time_jump == 'reset' else 'kept')

    def complain(self, reason: str, sentence: str) -> None:
        """Log a warning, once in a while for each reason."""
        self.statistics.error = sentence
        now = time.monotonic()
        if now - self._warned.get(reason, -THROTTLE) >= THROTTLE:
            self._warned[reason] = now
            log.warning('%s (%d so far)', sentence, self.statistics.dropped[reason])

    def lost(self, item: Item) -> None:
        """Count a message that the inbox had no room for; from any thread."""
        self.call(self._lost, item, self.ready.is_set())

    def _lost(self, item: Item, ready: bool) -> None:
        if not ready:
            self.statistics.dropped[NOT_READY] += 1
            self.complain(NOT_READY, f'{item.input.listened}: images came while kernels were '
                          'compiled or loaded, the oldest are dropped')
            return
        reason = QUEUE_FULL if item.input.role == 'labels' else f'{item.input.role}: {QUEUE_FULL}'
        self.statistics.dropped[reason] += 1
        self.complain(reason, f'{item.input.listened}: images come faster than they are mapped, '
                      'the oldest are dropped; a larger memory.stride or memory.voxel_size is '
                      'faster')

    @property
    def _position(self) -> NDArray[np.float64]:
        """Return where the camera was last, metres in the map frame."""
        frames = self.memory.frames
        return frames[-1].T_map_sensor[:3, 3] if frames else np.array(self.memory.origin)

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
            self.statistics.dropped[reason] += 1
            self.complain(reason, f'{reason}: {error}')
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
        self._report(item)
        while not self._calls.empty():
            self._answer(*self._calls.get())
        if self.refiner.finish(self.memory):
            self._stale |= {'map', 'changes'}
        self._move()
        self._forget_far()
        if self.memory.pager is not None:
            self.checkpoints.step(self.memory.pager, self.config.map.checkpoint,
                                  self.config.memory.max_voxels)
        if self.refiner.begin(self.memory, self.config.refine, self._unrefined):
            self._unrefined = False
        self._publish_map()

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
            self._stale, self._unrefined = {'map', 'changes'}, True

    def _keep_all(self) -> None:
        """Drop no observation where a corrected trajectory may have to move it."""
        if self.config.topics.trajectory:
            self.memory.keeps_all = True        # max_history bounds what a refinement reads

    def _look_for_jumps(self, item: Item) -> None:
        """Say once that a localisation has corrected itself, and what to do."""
        least = max(JUMP, self.config.memory.voxel_size)
        for buffer in item.input.takers:
            assert isinstance(buffer, PoseBuffer)       # it listens to /tf
            said = buffer.jumped(least)
            if said and self._watch_jumps:
                self._watch_jumps = False
                log.warning('%s; topics.trajectory takes the corrected path (nav_msgs/Path) and '
                            'moves the map, persem map move does so afterwards', said)

    def _take(self, item: Item) -> None:
        if item.input.role == TRAJECTORY:
            self.mover.take(item.data)
            return
        for taker in item.input.takers:
            self.intake.take(item.input.role, taker, item.kind, item.arrival, item.data)
        if item.input.role == LEGEND:
            self._hint()
            self.map.publish_legend()
        elif item.input.role == TF and self._watch_jumps:
            self._look_for_jumps(item)
        self.first_look.take(item)

    def _frame(self, frame: Frame, now: int) -> None:
        """Integrate one frame, publish what is wanted of it."""
        if self._overfull():
            self.statistics.dropped[CANNOT] += 1
            return
        try:
            observations = None if self.paused else self.pipeline.add(frame)
        except PersemError as error:
            self.statistics.dropped['frame refused'] += 1
            self.complain('frame refused', f'a frame was dropped: {error}')
            return
        outputs = self.images[frame.sensor]
        wanted = outputs.wanted()
        if wanted:
            labels = self.pipeline.render(frame, observations)
            outputs.publish(wanted, frame, labels, lambda: self._sources(frame, observations))
        if observations is not None:
            self.mover.note(observations)
            self._stale.add('map')
            self._unrefined = True
        self.statistics.frame((time.monotonic_ns() - now) / 1e9)

    def _overfull(self) -> bool:
        """Return whether memory has no room for what the map's file does not take."""
        bound = self.config.memory.max_voxels
        return self.memory.pager is not None and self.checkpoints.failing and \
            0 < 2 * bound < self.memory.n_voxels

    def _forget_far(self) -> None:
        """Keep the map within memory.keep_radius and memory.max_voxels, between refinements."""
        bounds = self.config.memory
        # What ~/refine visits in an attached map is far away, and leaves when it was visited.
        if self.refiner.busy or self.refiner.held or not self.memory.frames or \
                not (bounds.max_voxels or bounds.keep_radius) or \
                time.monotonic() - self._trimmed < TRIM:
            return
        if self.memory.pager is not None:
            self._trimmed = time.monotonic() - TRIM * (0 < self.memory.pager.let_go(
                self._position, bounds.max_voxels, bounds.keep_radius, AT_ONCE))
            return
        x, y, z = self._position.tolist()
        gone = keep_near(self.memory, (x, y, z), bounds.keep_radius, bounds.max_voxels,
                         AT_ONCE)
        if not gone:
            self._trimmed = time.monotonic()
        else:
            self.statistics.forgotten += gone
            self._stale |= {'map', 'changes'}

    def _sources(self, frame: Frame, observations: Observations | None) -> NDArray[np.uint8]:
        """Return which step decided each pixel of the depth grid."""
        voxels = self.pipeline.voxel_image(frame, observations)
        image = render_map(self.memory, voxels, source=True)
        return np.where(voxels < 0, NO_SOURCE, image).astype(np.uint8)

    def _answer(self, future: Future[Any], function: Callable[..., Any],
                arguments: tuple[Any, ...]) -> None:
        try:
            future.set_result(function(*arguments))
        except Exception as error:      # noqa: B902  for whoever asked
            future.set_exception(error)

    def _report(self, item: Item | None) -> None:
        """Warn of what was dropped since the last time."""
        dropped = self.statistics.losses()
        if dropped.total() == self._reported.total():
            return
        self.intake.explain()
        for reason in dropped - self._reported:
            if not reason.startswith('internal') and reason != 'frame refused':
                self._warn(reason, item)
        self._reported = dropped

    def _warn(self, reason: str, item: Item | None) -> None:
        """Warn of messages dropped for a reason; *item* came last."""
        role = reason.partition(':')[0] if ':' in reason else 'labels'
        names = [one.listened for one in self.inputs if one.role == role] or [role]
        stamp = item.input.stamp_of(item.data) if item is not None else None
        at = '' if stamp is None else f' near {stamp / 1e9:.3f} s'
        example = self._overloaded() if reason == BEHIND else \
            self.intake.examples.get(reason, '')
        if reason == NO_DEPTH:
            example += self._lost_depth()
        self.complain(reason, f'{names[0]}{at}: dropped, {reason}'
                      + (f'; {example}' if example and example != reason else ''))

    def _overloaded(self) -> str:
        """Return what to do where frames come faster than they are mapped."""
        return (f'frames come faster than they are mapped ({self.statistics.frame_rate():.1f} Hz '
                'now), those that waited for long are left out so that images and map stay '
                'young; --set memory.stride=2 or a larger memory.voxel_size makes a frame cheaper')

    def _lost_depth(self) -> str:
        """Return what the numbers of label and depth images say, '' where they are equal."""
        few = self.intake.few_depths()
        depth = next((one for one in self.inputs if one.role == DEPTH and one.subscriptions), None)
        if few is None or depth is None:
            return ''
        return (f'; {few[0]} depth images came for {few[1]} label images, the others were lost '
                f'on the way: {remedy(depth)}')

    def _publish_map(self) -> None:
        """Hand the map to its publishers when somebody listens and it is time."""
        now = time.monotonic()
        if self.map.busy or now - self._looked < LOOK:
            return
        self._looked = now
        wanted, new = self.map.wanted()
        if not wanted:
            self.map.forget()
            return
        self._stale |= new
        if self.map.waiting:
            self._stale.add('changes')
        due = wanted & self._stale
        rate = self.config.map.rate
        if not rate or now - self._mapped < 1.0 / rate:
            due.discard('map')
        if self.inbox.bytes and now - self._changed < CHANGES:      # nothing is late for them
            due.discard('changes')
        if not due and self.map.whole or not self.memory.n_voxels and not self._shown:
            return
        if self.memory.frames:
            self._stamp = self.memory.frames[-1].stamp
        due = self.map.publish(due, 'changes' in new, self.memory, self._stamp, self._position,
                               self.config.map)
        if 'map' in due:
            self._mapped = now
        if 'changes' in due:
            self._changed = now
        self._shown = True
        if self.map.caught_up:
            self._stale -= due
        if not self.map.whole:
            self._stale.add('changes')
