"""Blocks of several recordings become those of one map: histories one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import CELLS, ranges
from persem_ros.core.memory.regroup import recount
from persem_ros.errors import PersemError

HISTORY = ('history_label', 'history_confidence', 'history_frame', 'history_offset')


def joined(parts: Sequence[Blocks], first: Sequence[int], voxel_size: float,
           origin: tuple[float, float, float], max_history: int = 0) -> MemoryDump:
    """
    Return what a memory would hold that had seen all parts in a row, without its frames.

    Evidence is added up again from the observations, in their order: sums of sums would differ
    in their last bits.

    Parameters
    ----------
    parts : sequence of Blocks
        One or more; their histories hold everything.
    first : sequence of int
        Row of the frame table of each part's row 0.
    voxel_size, origin, max_history
        As of VoxelMemory.

    """
    block, cell, key = _places(parts)
    order = np.argsort(key, kind='stable')          # a voxel's parts stay in their order
    counts = np.concatenate([np.diff(part.history_start) for part in parts])
    begins = np.cumsum(counts) - counts             # in the parts' columns, one behind the other
    rows = ranges(begins[order], counts[order])
    label, confidence, _, offset = (
        np.concatenate([getattr(part, name) for part in parts])[rows] for name in HISTORY)
    frame = np.concatenate([part.history_frame + np.int32(f)
                            for part, f in zip(parts, first)])[rows]
    new = np.append(True, np.diff(key[order]) != 0)[:len(order)]
    start = np.append((np.cumsum(counts[order]) - counts[order])[new], len(rows))
    block, cell = block[order][new], cell[order][new]
    edge = np.append(True, (np.diff(block, axis=0) != 0).any(axis=1))[:len(block)]
    counted = _counted(start, label, confidence)
    n = len(block)
    kept = np.minimum(np.diff(start), max_history) if max_history else np.diff(start)
    newest = ranges(start[1:] - kept, kept)
    zero = np.zeros(n, np.uint8)
    return MemoryDump(
        block_index=block[edge], block_start=np.append(np.flatnonzero(edge), n),
        cell=cell, observations=np.diff(start).astype(np.uint32), switches=counted['switches'],
        label=counted['majority'], majority=counted['majority'], last=label[start[1:] - 1],
        first_label=label[start[:-1]], source=zero, dirty=zero + np.uint8(1), gone=zero,
        posterior=np.zeros(n, np.float32), passed=np.zeros(n, np.uint32),
        passed_at=np.zeros(n, np.int64), evidence_start=counted['evidence_start'],
        evidence_class=counted['classes'], evidence_sum=counted['sums'],
        history_start=np.append(0, np.cumsum(kept)), history_label=label[newest],
        history_confidence=confidence[newest], history_frame=frame[newest],
        history_offset=offset[newest], voxel_size=voxel_size, origin=origin,
        max_history=max_history, session=0, starts=counted['starts'],
        changes=counted['changes'], seen_ids=np.zeros(65536, np.uint8), rho=None,
        frames=FrameTable())


def side_by_side(parts: Sequence[Blocks]) -> dict[str, Any]:
    """Return the columns of Blocks with the blocks of all parts, none of them in two."""
    columns = {name: np.concatenate([getattr(part, name) for part in parts])
               for name in Blocks.__dataclass_fields__ if not name.endswith('_start')}
    for name in ('block_start', 'evidence_start', 'history_start'):
        counts = np.concatenate([np.diff(getattr(part, name)) for part in parts])
        columns[name] = np.append(0, np.cumsum(counts))
    return columns


def _places(parts: Sequence[Blocks],
            ) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.int64]]:
    """Return the block (n, 3) and cell of all voxels, and a number by which they are sorted."""
    index = np.concatenate([part.block_index for part in parts])
    voxels = np.concatenate([np.diff(part.block_start) for part in parts])
    low = index.min(axis=0).astype(np.int64)
    span = index.max(axis=0).astype(np.int64) - low + 1
    if float(span[0]) * float(span[1]) * float(span[2]) * CELLS >= 2.0 ** 63:
        raise PersemError('a tile is too wide to be sorted; give a smaller --tile')
    x, y, z = (index - low).T
    key = np.repeat(((x * span[1] + y) * span[2] + z) * CELLS, voxels)
    cell = np.concatenate([part.cell for part in parts])
    return np.repeat(index, voxels, axis=0), cell, key + cell


def _counted(start: NDArray[np.int64], label: NDArray[np.uint16],
             confidence: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
    """Return what follows from histories: evidence, majorities and counters."""
    v, n = len(start) - 1, len(label)
    found: dict[str, NDArray[Any]] = {
        'evidence_start': np.zeros(v + 1, np.int64), 'classes': np.empty(n, np.uint16),
        'sums': np.empty(n), 'majority': np.empty(v, np.uint16),
        'switches': np.zeros(v, np.uint32), 'starts': np.zeros(65536, np.int64),
        'changes': np.zeros(65536, np.int64)}
    entries = recount(start, label, confidence, *found.values())
    return {**found, **{name: found[name][:entries].copy() for name in ('classes', 'sums')}}
