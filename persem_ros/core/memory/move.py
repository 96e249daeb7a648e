"""
Poses were corrected, and histories move with them (spec section 10, *Corrected trajectories*).

A dump goes in and another comes out: the memory that is mapped into is not touched meanwhile.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.displace import displace, leaving
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import SIDE
from persem_ros.core.memory.regroup import group, meet, recount
from persem_ros.core.memory.voxel_order import number, ordered, voxels_of
from persem_ros.core.trajectory import Correction, correction, Trajectory
from persem_ros.core.transforms import inverses
from persem_ros.errors import PersemError

BUCKETS = 16        # bits of a key that observations are first distributed by, at most
DIGIT = 11          # bits of the others that one pass looks at, at most
TOO_FAR = 'a corrected pose takes observations too far away for voxels of {} m'


@dataclass(frozen=True, eq=False)
class Regrouped:
    """
    Observations by voxel: voxels by block, then by cell; observations by frame.

    Attributes
    ----------
    leaves : ndarray, shape (F,), uint8
        Which frames moved.
    voxels : ndarray, shape (V, 3), int32
    keys : ndarray, shape (V,), int64
        Ascending; the lowest nine bits are the cell, the others differ from block to block.
    start : ndarray, shape (V + 1,), int64
        Where the observations of each begin.
    old : ndarray, shape (V,), int64
        The row of the voxel that it was, where nothing came and nothing left; else -1.
    gone : ndarray, shape (V,), uint8
        Whether all that was observed there had gone.
    labels, confidences, frames, offsets : ndarray
        As MemoryDump has them.

    """

    leaves: NDArray[np.uint8]
    voxels: NDArray[np.int32]
    keys: NDArray[np.int64]
    start: NDArray[np.int64]
    old: NDArray[np.int64]
    gone: NDArray[np.uint8]
    labels: NDArray[np.uint16]
    confidences: NDArray[np.float32]
    frames: NDArray[np.int32]
    offsets: NDArray[np.uint8]


def correction_of(frames: FrameTable, session: int, trajectory: Trajectory,
                  origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Correction:
    """
    Return what a trajectory corrects of a session's frames.

    Raises
    ------
    PersemError
        Where the trajectory is of another time.

    """
    rows = np.flatnonzero(frames.session == session)
    stamps, first = np.unique(frames.stamp[rows], return_index=True)
    rows = rows[first]
    mounts = frames.sessions[session].mounts
    mount = np.stack([mounts.get(name, np.eye(4)) for name in frames.sensors])
    body = frames.placed[rows] @ inverses(mount)[frames.sensor[rows]]
    return correction(trajectory, stamps, body, f'session {session}', origin)


def corrected(frames: FrameTable, session: int, K: Correction) -> NDArray[np.float64]:
    """Return the best poses of all frames, (F, 4, 4): those of a session by a correction."""
    best, rows = frames.best.copy(), np.flatnonzero(frames.session == session)
    best[rows] = K.at(frames.stamp[rows]) @ frames.placed[rows]
    return best


def moved(saved: MemoryDump, best: NDArray[np.float64], rows: NDArray[np.bool_]) -> MemoryDump:
    """
    Return the map whose frames have other poses.

    Labels are those of before where nothing came and nothing left, elsewhere the majority's:
    everything is to be refined.

    Parameters
    ----------
    saved : MemoryDump
        Its histories hold all that was observed.
    best : ndarray, shape (F, 4, 4), float64
        The best poses of all frames.
    rows : ndarray, shape (F,), bool
        The frames that move.

    Raises
    ------
    PersemError
        Where a pose is too far away.

    """
    frames, counts = saved.frames.copy(), np.diff(saved.history_start)
    new = regrouped(
        saved.voxels().astype(np.int32), counts, saved.gone,
        saved.history_label, saved.history_confidence, saved.history_frame, saved.history_offset,
        turns_of(frames.placed, best, saved.origin), rows, saved.voxel_size)
    placed, known = frames.placed.copy(), frames.best.copy()
    known[rows] = best[rows]
    went = new.leaves > 0
    placed[went] = best[went]
    frames.replace_poses(placed, known)
    return replace(saved, **_columns(saved, new), frames=frames)


def turns_of(placed: NDArray[np.float64], best: NDArray[np.float64],
             origin: tuple[float, ...]) -> NDArray[np.float64]:
    """Return K = best * placed^-1 about the origin, (F, 12): rotation by rows, then the shift."""
    placed, best = placed.copy(), best.copy()
    for poses in (placed, best):
        poses[:, :3, 3] -= origin
    K = best @ inverses(placed)
    return np.concatenate([K[:, :3, :3].reshape(-1, 9), K[:, :3, 3]], axis=1)


def regrouped(voxels: NDArray[np.int32], counts: NDArray[np.int64], gone: NDArray[np.uint8],
              labels: NDArray[np.uint16], confidences: NDArray[np.float32],
              frames: NDArray[np.int32], offsets: NDArray[np.uint8], turns: NDArray[np.float64],
              moves: NDArray[np.bool_], size: float) -> Regrouped:
    """
    Move observations and gather them by voxel again.

    Parameters
    ----------
    voxels : ndarray, shape (V, 3), int32
        Their indices.
    counts : ndarray, shape (V,), int64
        How many observations each has; those of a voxel follow each other.
    gone : ndarray, shape (V,), uint8
        Whether a voxel had gone.
    labels, confidences, frames, offsets : ndarray
        The observations, as MemoryDump has them.
    turns : ndarray, shape (F, 12), float64
        See turns_of().
    moves : ndarray, shape (F,), bool
        Which frames may move.
    size : float
        Metres.

    """
    owner = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    n, leaves = len(owner), np.zeros(len(moves), np.uint8)
    voxels, gone, labels, confidences, frames, offsets, moves = (
        np.require(column, kind, ('C', 'W')) for column, kind in (
            (voxels, np.int32), (gone, np.uint8), (labels, np.uint16), (confidences, np.float32),
            (frames, np.int32), (offsets, np.uint8), (moves, np.uint8)))
    leaving(voxels, owner, frames, offsets, turns, moves, size, leaves)
    out, places = np.empty((n, 3), np.int32), np.empty((n, 3), np.uint16)
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    if not displace(voxels, owner, frames, offsets, turns, leaves, size, out, places, low, high):
        raise PersemError(TOO_FAR.format(size))
    span = _span(low, high)
    keys = np.empty(n, np.int64)
    number(out, low, span, keys)
    bits = int(span[0] * span[1] * span[2] * 512 - 1).bit_length()
    shift = max(0, bits - min(BUCKETS, (n // 16).bit_length()))
    digit = -(-shift // max(1, -(-shift // DIGIT)))
    # numpy's arrays of this size lie in huge pages, those that kernels make do not. Those of out
    # are of use once more.
    keys, order = ordered(keys, 1 << bits - shift, shift, max(1, digit), np.empty(n, np.uint32),
                          np.empty(n, np.uint32), out.reshape(-1)[:2 * n].view(np.int64),
                          np.empty(n, np.int64))
    first, kept_frames = np.empty(n + 1, np.uint32), np.empty(n, np.int32)
    start, where = np.zeros(n + 1, np.int64), np.empty(n, np.int64)
    old, all_gone = np.empty(n, np.int64), np.empty(n, np.uint8)
    v = group(keys, order, frames, owner, counts, gone, bool(gone.any()), leaves, first,
              kept_frames, start, where, old, all_gone)
    start, where = start[:v + 1].copy(), where[:v].copy()
    n, found = int(start[v]), np.empty((v, 3), np.int32)
    kept = np.empty(n, np.uint16), np.empty(n, np.float32), np.empty((n, 3), np.uint8)
    meet(first[:n + 1], order, owner, voxels, labels, confidences, places, *kept)
    voxels_of(where, low, span, found)
    return Regrouped(leaves, found, where, start, old[:v].copy(), all_gone[:v].copy(), kept[0],
                     kept[1], kept_frames[:n], kept[2])


def _span(low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many blocks there are along each axis; refuse more than keys can number."""
    span = np.maximum(high - low + 1, 1)
    if float(span[0]) * float(span[1]) * float(span[2]) >= 2.0 ** 54:
        raise PersemError('the corrected map is too wide: its ends are '
                          f'{" x ".join(str(s * SIDE) for s in span.tolist())} voxels apart')
    return span


def _columns(saved: MemoryDump, new: Regrouped) -> dict[str, Any]:
    """Return what of a dump is other after the move."""
    v, n = len(new.voxels), len(new.labels)
    evidence_start = np.zeros(v + 1, np.int64)
    classes, sums = np.empty(n, np.uint16), np.empty(n)
    majority, switches = np.empty(v, np.uint16), np.zeros(v, np.uint32)
    starts, changes = np.zeros(65536, np.int64), np.zeros(65536, np.int64)
    entries = recount(new.start, new.labels, new.confidences, evidence_start, classes, sums,
                      majority, switches, starts, changes)
    first = np.flatnonzero(np.diff(new.keys >> 9, prepend=-1))
    same = np.flatnonzero(new.old >= 0)
    before = new.old[same]

    def kept(column: NDArray[Any], otherwise: Any) -> NDArray[Any]:
        values = np.full(v, otherwise, column.dtype) if np.isscalar(otherwise) else \
            otherwise.astype(column.dtype)
        values[same] = column[before]
        return values

    return {
        'block_index': new.voxels[first] >> 3, 'block_start': np.append(first, v),
        'cell': (new.keys & 511).astype(np.uint16),
        'observations': np.diff(new.start).astype(np.uint32), 'switches': switches,
        'label': kept(saved.label, majority), 'majority': majority,
        'last': new.labels[new.start[1:] - 1], 'first_label': new.labels[new.start[:-1]],
        'source': kept(saved.source, 0), 'dirty': kept(saved.dirty, 1),
        'gone': new.gone, 'posterior': kept(saved.posterior, 0),
        'passed': kept(saved.passed, 0), 'passed_at': kept(saved.passed_at, 0),
        'evidence_start': evidence_start, 'evidence_class': classes[:entries].copy(),
        'evidence_sum': sums[:entries].copy(), 'history_start': new.start,
        'history_label': new.labels, 'history_confidence': new.confidences,
        'history_frame': new.frames, 'history_offset': new.offsets,
        'starts': starts, 'changes': changes}
