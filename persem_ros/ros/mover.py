"""Corrected trajectories of a node: the map moves beside the mapping (spec section 10)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
import logging
import time
from typing import Any

import numpy as np
from persem_ros.core.frame.moved import moved as moved_frame
from persem_ros.core.frame.observe import Observations
from persem_ros.core.frame.sessions import nothing_forgotten
from persem_ros.core.memory.capture import Capture
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.move import corrected, correction_of, moved
from persem_ros.core.memory.voxel_memory import stored_observations, VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.trajectory import from_path, PATH
from persem_ros.ros.priority import stand_back
from persem_ros.settings.config import Config

log = logging.getLogger(__name__)
AT_ONCE = 1         # frames that the mapping thread adds to a moved map
FINER = 256         # of a voxel's edge, by which the map's frames must move for a move to begin
KEPT = 3.0          # s that a map that was replaced is kept, for what still reads it


class Mover:
    """
    One move at a time; all but the computing runs on the worker's thread.

    A path is read, the map captured in slices between frames, moved and made anew on a thread;
    frames that are mapped meanwhile are kept as observations, moved and added behind. Then the
    worker goes on with the moved map, which the thread has brought up to date but for a frame or
    two.

    Parameters
    ----------
    decode : callable
        decode(data, typename) gives a message.
    wake : callable
        Called from the thread when it is done.

    Attributes
    ----------
    moves : int
        How often the map was moved.
    took : float
        Seconds from the beginning of the last move to its end.

    """

    def __init__(self, decode: Callable[..., Any], wake: Callable[[], None]) -> None:
        """Begin with nothing to do."""
        self._decode, self._wake = decode, wake
        self._thread = ThreadPoolExecutor(1, 'move', stand_back)
        self._data = b''            # the newest path that was not looked at
        self._move: _Move | None = None
        self._result: Future[Any] | None = None
        self._ended = time.monotonic()      # or the beginning: a path has little to say then
        self._said: set[str] = set()
        self.moves, self.took = 0, 0.0

    @property
    def busy(self) -> bool:
        """Return whether a move is under way."""
        return self._move is not None

    def take(self, data: bytes) -> None:
        """Take a serialized nav_msgs/Path; of several the newest counts."""
        self._data = data

    def note(self, observations: Observations) -> None:
        """Keep what a frame observed, which was just added to the map."""
        if self._move is not None and self._move.captured:
            self._move.since.append(observations)

    def step(self, memory: VoxelMemory, config: Config) -> VoxelMemory | None:
        """Go on with the move under way, or begin one; return the moved memory at its end."""
        if self._move is None:
            if self._data and memory.session in memory.frames.sessions and \
                    time.monotonic() - self._ended >= config.trajectory.period:
                self._move, self._data = _Move(memory, config, self._data), b''
                self._submit(self._move.read, self._decode)
            return None
        move = self._move
        if memory is not move.memory or memory.session != move.session:
            self._abandon()
            return None
        if self._result is None:
            assert move.capture is not None
            if move.capture.step():
                move.captured = True
                self._submit(move.compute)
            return None
        return self._after(move) if self._result.done() else None

    def close(self) -> None:
        """Wait for what is being computed and forget it."""
        if self._move is not None:
            self._abandon()
        self._thread.shutdown()

    def _after(self, move: _Move) -> VoxelMemory | None:
        """Go on after what the thread has done; return the moved memory when it is there."""
        assert self._result is not None
        try:
            found, self._result = self._result.result(), None
        except PersemError as error:
            self._end()
            self._warn(str(error))
            return None
        except BaseException:
            self._end()
            raise
        if not move.captured:
            if found:
                move.capture = Capture(move.memory, evidence=False)
            else:
                self._end()         # nothing that would move
            return None
        if len(move.since) > AT_ONCE:
            self._submit(move.catch_up)
            return None
        move.catch_up()
        self.moves += 1
        self.took = time.monotonic() - move.began
        self._end()
        self._thread.submit(_keep, move.memory)
        log.info('the map moved with %s: %s, in %.2f s', move.trajectory.name, move.said,
                 self.took)
        return move.moved

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> None:
        def work() -> Any:
            try:
                return function(*arguments)
            finally:
                self._wake()
        self._result = self._thread.submit(work)

    def _abandon(self) -> None:
        """Forget the move: the map is another one, or time went back."""
        log.warning('a corrected trajectory was left out: the session it is of has ended')
        self._end()

    def _end(self) -> None:
        if self._move is not None and self._move.capture is not None:
            self._move.capture.close()
        self._move = self._result = None
        self._ended = time.monotonic()

    def _warn(self, sentence: str) -> None:
        """Log a warning, once for each kind."""
        kind = ''.join(c for c in sentence if not c.isdigit())
        if kind not in self._said:
            self._said.add(kind)
            log.warning('%s; the map stays as it is', sentence)


class _Move:
    """A move under way; read(), compute() and, but for its end, catch_up() run on the thread."""

    def __init__(self, memory: VoxelMemory, config: Config, data: bytes) -> None:
        self.memory, self.config, self._data = memory, config, data
        self.session, self._frames = memory.session, memory.frames.copy()
        self.began = time.monotonic()
        self.capture: Capture | None = None
        self.captured = False
        self.since: deque[Observations] = deque()
        self.said = ''

    def read(self, decode: Callable[..., Any]) -> bool:
        """Read the path; return whether anything would move by it."""
        topic = self.config.topics.trajectory
        try:
            msg = decode(self._data, PATH)
        except BadMessage as fault:
            raise PersemError(f'{topic}: {fault}') from None
        self.trajectory = from_path(msg, self.config.frames.map, topic)
        self._correct(self._frames)
        own = self._frames.session == self.session
        best = corrected(self._frames, self.session, self.K)[own]
        # Where a point would be by now and by the path, at the camera and as far as it sees.
        change = best - self._frames.best[own]
        least = self.config.memory.voxel_size / FINER
        return bool((np.abs(change[:, :3, 3]) > least).any() or (
            np.abs(change[:, :3, :3]) * self.config.memory.max_depth > least).any())

    def compute(self) -> None:
        """Make the moved map of what was captured."""
        assert self.capture is not None
        saved = self.capture.dump()
        if not nothing_forgotten(saved):
            raise PersemError(f'{self.config.topics.trajectory}: the map has let go of '
                              'observations (memory.max_voxels, memory.keep_radius, or a file '
                              'with memory.max_history), and what is left cannot be moved; replay '
                              'a recording of the flight with --trajectory')
        self._correct(saved.frames)
        new = moved(saved, corrected(saved.frames, self.session, self.K),
                    saved.frames.session == self.session)
        went = (new.frames.placed != saved.frames.placed).any(axis=(1, 2))
        far = np.linalg.norm((new.frames.placed - saved.frames.placed)[:, :3, 3], axis=1)
        self.said = f'{np.count_nonzero(went)} frames, by up to {far.max(initial=0.0):.3g} m'
        self.moved = load(replace(new, rho=None))       # to be taken anew, and all refined
        self.moved.max_history = self.memory.max_history
        self.moved.keeps_all = self.memory.keeps_all
        self.catch_up()

    def catch_up(self) -> None:
        """Add what was observed meanwhile."""
        memory = self.moved
        while self.since:
            seen = self.since.popleft()
            best = self.K.pose(seen.T_map_sensor, seen.stamp)
            memory.add(moved_frame(seen, best, memory.voxel_size, memory.origin))
            memory.frames.note_best(best)

    def _correct(self, frames: FrameTable) -> None:
        """Take the correction of what is placed now."""
        self.K = correction_of(frames, self.session, self.trajectory, self.memory.origin)


def _keep(memory: VoxelMemory) -> None:
    """Hold a map that was replaced until nothing reads it any more; it is freed on this thread."""
    time.sleep(KEPT)


def check_moves(config: Config, memory: VoxelMemory | None) -> None:
    """
    Say at the start what would keep corrected trajectories from moving the map.

    *memory* is that of a file, None where an empty map begins.

    Raises
    ------
    PersemError
        For settings that contradict each other.

    """
    if not config.topics.trajectory:
        return
    if config.map.attached:
        raise PersemError('topics.trajectory needs the whole map in memory, map.attached keeps it '
                          'in a file; choose map.load=true and map.save=true in place of '
                          'map.attached, or move the file afterwards with persem map move')
    if memory is not None and stored_observations(memory) < memory.n_observations:
        log.warning('topics.trajectory: %s has let go of observations (memory.max_history), so '
                    'that the map cannot be moved; map its recording anew, or begin an empty one',
                    config.map.path)
    if config.memory.max_voxels or config.memory.keep_radius:
        log.warning('topics.trajectory: once memory.max_voxels or memory.keep_radius has let go '
                    'of voxels, the map cannot be moved any more')
