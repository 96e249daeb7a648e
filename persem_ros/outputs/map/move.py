"""Map files whose poses were corrected (spec section 10): which session, and what moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.sessions import nothing_forgotten
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.move import corrected, correction_of, moved
from persem_ros.core.trajectory import Trajectory
from persem_ros.errors import PersemError
from persem_ros.outputs.map.stored import StoredMap


def session_of(stored: StoredMap, trajectory: Trajectory, wanted: int | None = None) -> int:
    """
    Return the session that a trajectory is of: *wanted*, else the only one at its time.

    Raises
    ------
    PersemError
        Where there is none, or more than one.

    """
    frames = stored.saved.frames
    there = sorted(frames.sessions)
    if wanted is not None:
        if wanted not in there:
            raise PersemError(f'{stored.path} has no session {wanted}; it has '
                              f'{", ".join(map(str, there)) or "none"}')
        return wanted
    first, last = int(trajectory.stamps[0]), int(trajectory.stamps[-1])
    found = [n for n in there if frames.stamp[frames.session == n].min() <= last
             and frames.stamp[frames.session == n].max() >= first]
    if len(found) == 1:
        return found[0]
    if not found:
        spans = ', '.join(f'{n}: {frames.stamp[frames.session == n].min() / 1e9:.3f} to '
                          f'{frames.stamp[frames.session == n].max() / 1e9:.3f} s'
                          for n in there)
        raise PersemError(f'{trajectory.name} runs from {first / 1e9:.3f} to {last / 1e9:.3f} s, '
                          f'when no session of {stored.path} was flown ({spans or "it has none"})')
    raise PersemError(f'{trajectory.name} is of the time of the sessions '
                      f'{", ".join(map(str, found))} of {stored.path}; choose one with --session')


def move_session(stored: StoredMap, session: int, trajectory: Trajectory) -> MemoryDump:
    """
    Return the map in which a session lies where a trajectory says, not yet refined.

    Raises
    ------
    PersemError
        Where observations are missing or the trajectory is of another time.

    """
    saved = _whole(stored)
    K = correction_of(saved.frames, session, trajectory, saved.origin)
    return moved(saved, corrected(saved.frames, session, K), saved.frames.session == session)


def transformed(stored: StoredMap, T: NDArray[np.float64]) -> StoredMap:
    """Return a map all of whose frames were taken from T times their pose, not yet refined."""
    saved = _whole(stored)
    new = moved(saved, T @ saved.frames.best, np.ones(len(saved.frames), bool))
    return replace(stored, saved=new)


def _whole(stored: StoredMap) -> MemoryDump:
    """Return a map's dump; refuse one that has let go of observations."""
    if not nothing_forgotten(stored.saved):
        raise PersemError(f'{stored.path} has let go of observations (memory.max_history, '
                          'memory.max_voxels or memory.keep_radius), and what is left cannot be '
                          'moved; map its recording anew, from the corrected poses')
    return stored.saved
