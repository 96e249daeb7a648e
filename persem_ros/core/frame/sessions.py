"""The sessions of a map as what was seen, frame by frame: a memory can be made to see it again."""

from __future__ import annotations

from collections.abc import Iterator
import hashlib

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.observe import Observations
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.session import Session
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError

FARTHEST = 2 ** 31 - 16         # so that a voxel's neighbours are int32, too


def whole(saved: MemoryDump) -> bool:
    """Return whether the histories of a dump's voxels hold all that was observed."""
    return bool((np.diff(saved.history_start) == saved.observations).all())


def nothing_forgotten(saved: MemoryDump) -> bool:
    """Return whether no voxel that was observed is missing either: its pairs would be counted."""
    return whole(saved) and int(saved.starts.sum()) == \
        int(saved.observations.sum(dtype=np.int64)) - len(saved.cell)


def observations_of(saved: MemoryDump, session: int, ids: NDArray[np.uint16],
                    shift: NDArray[np.int64]) -> Iterator[Observations]:
    """
    Yield what each frame of a session observed, in order.

    Parameters
    ----------
    saved : MemoryDump
        Its histories hold everything (whole()).
    session : int
        Its number.
    ids : ndarray, shape (65536,), uint16
        What each id becomes.
    shift : ndarray, shape (3,), int64
        Added to the voxels' indices.

    """
    table = saved.frames
    voxels = saved.voxels() + shift
    owner = np.repeat(np.arange(len(voxels)), np.diff(saved.history_start))
    order = np.argsort(saved.history_frame, kind='stable')
    edges = np.searchsorted(saved.history_frame[order], np.arange(len(table) + 1))
    mounts = table.sessions[session].mounts
    for f in np.flatnonzero(table.session == session):
        rows = order[edges[f]:edges[f + 1]]
        seen = voxels[owner[rows]]
        if (np.diff(owner[rows]) == 0).any() or (np.abs(seen) > FARTHEST).any():
            raise PersemError('a map sees a voxel twice in one frame, or voxels that would lie '
                              'out of range: it is damaged, restore it from a copy')
        sensor = table.sensors[table.sensor[f]]
        labels = ids[saved.history_label[rows]]
        yield Observations(
            seen.astype(np.int32), labels, saved.history_confidence[rows],
            np.empty(0, np.int32), np.unique(labels), int(table.stamp[f]), table.placed[f].copy(),
            sensor, saved.history_offset[rows], mounts.get(sensor))


def add_session(memory: VoxelMemory, saved: MemoryDump, session: int, ids: NDArray[np.uint16],
                shift: NDArray[np.int64]) -> None:
    """Have a memory see a session of a dump again, as a new session of its own."""
    memory.new_session()
    best = saved.frames.best[saved.frames.session == session]
    for seen, T in zip(observations_of(saved, session, ids, shift), best):
        memory.add(seen)
        if not np.array_equal(seen.T_map_sensor, T):
            memory.frames.note_best(T)
    there = saved.frames.sessions[session]
    memory.frames.sessions[memory.session] = Session(there.uuid, dict(there.mounts))


def keep_looks(memory: VoxelMemory, saved: MemoryDump, shift: NDArray[np.int64]) -> None:
    """Have a memory that has just seen a dump's sessions go on with its looks through voxels."""
    rows = np.flatnonzero((saved.passed > 0) | (saved.gone > 0))
    number = memory.find((saved.voxels()[rows] + shift).astype(np.int32))
    rows, number = rows[number >= 0], number[number >= 0]
    for name, column in (('count', saved.passed), ('second', saved.passed_at)):
        memory.store.passed[name][number] = column[rows]
    memory.store.passed['n'][number] = memory.m.voxels['n'][number]
    memory.m.voxels['gone'][number] = saved.gone[rows]
    memory.some_passed |= len(number) > 0
    memory.n_gone += int(np.count_nonzero(saved.gone[rows]))


def fingerprint(saved: MemoryDump, session: int) -> str:
    """Return a digest of all that a session saw, whatever its number."""
    digest, every = hashlib.sha256(), np.arange(65536).astype(np.uint16)
    for seen in observations_of(saved, session, every, np.zeros(3, np.int64)):
        digest.update(repr((seen.stamp, seen.sensor, seen.T_map_sensor.tolist())).encode())
        for column in (seen.voxels, seen.labels, seen.confidences, seen.offsets):
            digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()
