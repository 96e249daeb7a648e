"""What dumps are made of, voxel by voxel: evidence, histories, looks through, parameters."""

from __future__ import annotations

from typing import Any, Optional, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.evidence import count_classes, read_evidence
from persem_ros.core.memory.history import link_of
from persem_ros.core.memory.pools import CHUNK

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory


def evidence_of_voxels(
        memory: VoxelMemory, number: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.float64]]:
    """Return start (n + 1,), classes and sums of the evidence of voxels, by their numbers."""
    pools, start = memory.m, np.zeros(len(number) + 1, np.int64)
    _class_counts(pools.voxels, pools.spills, number, start[1:])
    np.cumsum(start, out=start)
    classes, sums = np.empty(start[-1], np.uint16), np.empty(start[-1])
    _read_evidence(pools.voxels, pools.spills, number, start, classes, sums)
    return start, classes, sums


def looks_through(memory: VoxelMemory, number: NDArray[np.int64], n: NDArray[np.uint32],
                  ) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
    """Return passed and passed_at of voxels with *n* observations, by their numbers."""
    if not memory.some_passed:
        return np.zeros(len(number), np.uint32), np.zeros(len(number), np.int64)
    found = memory.store.passed[number]
    found[found['n'] != n] = 0
    return found['count'], found['second']


def read_histories(memory: VoxelMemory, records: NDArray[np.void]) -> tuple[
        NDArray[np.int64], NDArray[np.uint16], NDArray[np.float32], NDArray[np.int32],
        NDArray[np.uint8]]:
    """
    Return the histories of voxels as their (copied) records have them.

    Any thread may do so while the map grows: links are only ever filled further.

    Returns
    -------
    start : ndarray, shape (n + 1,), int64
    labels, confidences, frames, offsets : ndarray
        As MemoryDump has them.

    """
    stored = records['n'].astype(np.int64) - records['first']
    if memory.kept_history:
        stored = np.minimum(stored, memory.kept_history)
    start = np.zeros(len(records) + 1, np.int64)
    np.cumsum(stored, out=start[1:])
    labels, confidences = np.empty(start[-1], np.uint16), np.empty(start[-1], np.float32)
    frames, where = np.empty(start[-1], np.int32), np.empty((start[-1], 3), np.uint8)
    _read_histories(memory.m.links, memory.m.offsets, records, start, labels, confidences, frames,
                    where)
    return start, labels, confidences, frames, where


def habits_of(
        memory: VoxelMemory) -> tuple[dict[str, NDArray[Any]], Optional[tuple[Any, ...]]]:
    """Return the dump's habits and fitted_by."""
    if memory.geometry is None:
        return memory.habits, memory.fitted_by if memory.habits else None
    ids = {name: np.flatnonzero(some).astype(np.uint16) for name, some in (
        ('known', memory.known_ids), ('voted', memory.voted_ids))}
    return {**memory.geometry.arrays(), **ids}, memory.fitted_by


@kernel
def _class_counts(voxels, spills, number, counts):
    """Write how many classes each voxel has seen."""
    for r in range(len(number)):
        counts[r] = count_classes(voxels[number[r]], spills)


@kernel
def _read_evidence(voxels, spills, number, start, classes, sums):
    """Copy the evidence of the voxels to the columns."""
    for r in range(len(number)):
        read_evidence(voxels[number[r]], spills, classes, sums, start[r])


@kernel
def _read_histories(links, offsets, records, start, labels, confidences, frames, where):
    """Copy the histories of the records to the columns."""
    for r in range(len(records)):
        voxel = records[r]
        n, out = np.int64(voxel.n), start[r]
        begin = n - (start[r + 1] - start[r])
        link = link_of(links, voxel.head, voxel.first, begin)
        for i in range(begin, n):
            if i > begin and i % CHUNK == 0:
                link = np.int64(links[link - 1].next)
            record = links[link - 1]
            labels[out] = record.c[i % CHUNK]
            confidences[out] = record.s[i % CHUNK]
            frames[out] = record.f[i % CHUNK]
            xyz = offsets[link - 1].xyz
            for axis in range(3):
                where[out, axis] = xyz[i % CHUNK * 3 + axis]
            out += 1
