"""What a map file must satisfy before a kernel may rely on it, whoever wrote its checksums."""

from collections.abc import Mapping
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import CELLS, SIDE
from persem_ros.frames import MAX_ID
from persem_ros.outputs.map.cloud import SOURCES

# What the table 'about' holds.
ABOUT = {'settings': str, 'map_frame': str, 'legend': str, 'origin': bytes, 'voxel_size': float,
         'max_history': int, 'session': int, 'refined': int, 'blocks': int, 'voxels': int,
         'observations': int}
FARTHEST_BLOCK = (1 << 31) // SIDE - 2      # so that every voxel and its neighbours are int32
LEAST_EVIDENCE = 1e-46      # below the smallest confidence: shares of it do not underflow
ROUNDING = 1e-6
UUID = re.compile(r'[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}')
LARGEST = 1e15              # metres: origins and positions of frames
# What examine() may find, in its order.
FAULTS = ('', 'a class twice in the evidence of a voxel', 'evidence', 'majority', 'label',
          'first or last label', 'confidences', 'frames of a history',
          'a history without its evidence', 'evidence that its history does not give', 'switches')
(WHOLE, TWICE, EVIDENCE, MAJORITY, LABEL, LAST, CONFIDENCE, TIME, UNSEEN, SUMS,
 SWITCHES) = range(len(FAULTS))


def check_about(about: Mapping[str, Any]) -> None:
    """Refuse (ValueError) a table 'about' with values of other types or out of range."""
    for name, kind in ABOUT.items():
        if type(about.get(name)) is not kind:
            raise ValueError(f'{name} in the table about')
    _all_or_damaged({
        'voxel size': 1e-6 <= about['voxel_size'] <= 1e6,
        'origin': len(about['origin']) == 24 and
        bool((np.abs(np.frombuffer(about['origin'], '<f8')) < LARGEST).all()),
        'max_history': 0 <= about['max_history'] < 1 << 31,
        'session': 0 <= about['session'] < 1 << 31,
        'refined': about['refined'] in (0, 1),
        'map frame': '\0' not in about['map_frame']})


def check_dump(saved: MemoryDump, about: Mapping[str, Any] | None) -> None:
    """
    Refuse (ValueError) a map whose columns, counters and frames do not fit together.

    Of a part of a map's blocks (*about* None) the counts are not looked at.

    """
    _check_frames(saved.frames, saved.session)
    _check_counters(saved, *check_blocks(saved, saved.frames.t, saved.seen_ids, about))


def check_head(saved: MemoryDump) -> None:
    """Refuse (ValueError) counters and frames that no mapping writes; blocks are not looked at."""
    _check_frames(saved.frames, saved.session)
    nothing = np.zeros(MAX_ID + 2, np.int64)
    _check_counters(saved, nothing, nothing)


def check_blocks(saved: Blocks, frame_t: NDArray[np.int32],
                 seen_ids: NDArray[np.uint8], about: Mapping[str, Any] | None = None,
                 ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """
    Refuse (ValueError) blocks that do not fit frames, ids and, where given, the counts in about.

    Returns
    -------
    starts, changes : ndarray, shape (65536,), int64
        The pairs of consecutive observations in them, by class.

    """
    about = about or {'blocks': len(saved.block_index), 'voxels': len(saved.cell),
                      'observations': saved.observations.sum(dtype=np.int64)}
    _check_lengths(saved, about)
    _check_blocks(saved)
    history = np.diff(saved.history_start)
    _all_or_damaged({
        'observations': bool((history > 0).all() and (history <= saved.observations).all()) and
        saved.observations.max(initial=0) <= len(frame_t) and
        saved.observations.sum(dtype=np.int64) == about['observations'],
        'labels': max(int(column.max(initial=0)) for column in (
            saved.label, saved.majority, saved.last, saved.first_label, saved.history_label,
            saved.evidence_class)) <= MAX_ID and saved.source.max(initial=0) < len(SOURCES) and
        saved.dirty.max(initial=0) <= 1 and saved.gone.max(initial=0) <= 1,
        'looks through voxels': bool(((saved.passed > 0) | (saved.passed_at == 0)).all()),
        'posteriors': bool(((saved.posterior >= 0) & (saved.posterior <= 1)).all()),
        'evidence': bool((np.diff(saved.evidence_start) > 0).all())})
    starts, changes = np.zeros(MAX_ID + 2, np.int64), np.zeros(MAX_ID + 2, np.int64)
    fault = examine(
        saved.observations, saved.switches, saved.label, saved.majority, saved.last,
        saved.first_label, saved.evidence_start, saved.evidence_class, saved.evidence_sum,
        saved.history_start, saved.history_label, saved.history_confidence, saved.history_frame,
        frame_t, seen_ids, starts, changes)
    if fault:
        raise ValueError(FAULTS[fault])
    return starts, changes


def _check_lengths(saved: Blocks, about: Mapping[str, Any]) -> None:
    """Refuse columns of other lengths than the counts say."""
    n, rows = len(saved.cell), np.diff(saved.block_start)
    evidence, history = len(saved.evidence_sum), len(saved.history_frame)
    lengths = {'observations': n, 'switches': n, 'label': n, 'majority': n, 'last': n,
               'first_label': n, 'source': n, 'dirty': n, 'gone': n, 'posterior': n,
               'passed': n, 'passed_at': n,
               'evidence_class': evidence,
               'history_label': history,
               'history_confidence': history, 'history_offset': history}
    _all_or_damaged({
        'number of blocks': len(rows) == len(saved.block_index) == about['blocks'] and
        bool(((rows > 0) & (rows <= CELLS)).all()),
        'number of voxels': n == about['voxels'] == saved.block_start[-1],
        'length of a column': len(saved.evidence_start) == len(saved.history_start) == n + 1 and
        saved.evidence_start[-1] == evidence and saved.history_start[-1] == history and
        all(len(getattr(saved, name)) == length for name, length in lengths.items())})


def _check_blocks(saved: Blocks) -> None:
    """Refuse blocks that are not unique and in order, and cells that are not within them."""
    index = saved.block_index.astype(np.int64)
    step = np.diff(index, axis=0)
    first = (step != 0).argmax(axis=1)
    last = np.zeros(len(saved.cell), bool)
    last[saved.block_start[1:] - 1] = True
    _all_or_damaged({
        'a block twice': bool((step[np.arange(len(step)), first] > 0).all()),
        'place of a block': bool((np.abs(index) <= FARTHEST_BLOCK).all()),
        'cells': bool((saved.cell < CELLS).all() and
                      ((np.diff(saved.cell.astype(np.int64)) > 0) | last[:-1]).all())})


def _check_frames(frames: FrameTable, session: int) -> None:
    """Refuse rows of the frame table that no mapping writes."""
    sessions = frames.sessions
    mounts = [mount for one in sessions.values() for mount in one.mounts.values()]
    poses = np.concatenate([frames.placed, frames.best, np.reshape(mounts, (-1, 4, 4))])
    _all_or_damaged({
        'frames': bool((frames.t >= 0).all() and (frames.session >= 0).all() and
                       (frames.session <= session).all()) and
        not any('\0' in name for name in frames.sensors),
        'sessions': set(np.unique(frames.session).tolist()) == set(sessions) and
        all(UUID.fullmatch(one.uuid) for one in sessions.values()),
        # NaN is not less than anything
        'poses of the frames': bool((np.abs(poses) < LARGEST).all() and
                                    (poses[:, 3] == (0, 0, 0, 1)).all())})


def _check_counters(saved: MemoryDump, starts: NDArray[np.int64],
                    changes: NDArray[np.int64]) -> None:
    """
    Refuse counters that are smaller than what the stored histories give.

    They may be larger: blocks that were let go are counted on.

    """
    fits: dict[str, bool] = {'class counters': bool(
        (saved.starts >= starts).all() and (saved.changes >= changes).all() and
        (saved.changes <= saved.starts).all() and (saved.starts < 1 << 62).all() and
        (saved.seen_ids <= 1).all())}
    if saved.rho is not None:
        rho = np.asarray(saved.rho)
        fits['class volatility'] = bool(((rho >= 0) & (rho <= 1)).all())
    _all_or_damaged(fits)


@kernel
def examine(observations, switches, label, majority, last, first_label, evidence_start, classes,
            sums, history_start, labels, confidences, frames, frame_t, seen_ids, starts, changes):
    """
    Look at every voxel's record once; return the number of the first fault, 0 for none.

    Every start and length was checked before. starts and changes (65536,) int64 receive the
    pairs of consecutive observations that are stored, for the class counters.

    """
    seen, rest = np.zeros(65536, np.int64), np.zeros(65536)
    for v in range(len(observations)):
        n, a, b = np.int64(observations[v]), history_start[v], history_start[v + 1]
        most = 0.0
        for e in range(evidence_start[v], evidence_start[v + 1]):
            c, h = np.int64(classes[e]), sums[e]
            if seen[c] == v + 1:
                return TWICE
            if not (h >= LEAST_EVIDENCE and h <= n * (1.0 + ROUNDING)):     # NaN fails, too
                return EVIDENCE
            seen[c] = v + 1
            rest[c] = h
            most = max(most, h)
        c_M = np.int64(majority[v])
        if seen[c_M] != v + 1 or most - rest[c_M] > TIE + ROUNDING * most:
            return MAJORITY
        if seen_ids[label[v]] == 0:     # the anchor may come from neighbours that were let go
            return LABEL
        if last[v] != labels[b - 1] or (b - a == n and first_label[v] != labels[a]):
            return LAST
        before, turns, newest = np.int64(0), 0, np.int64(0)
        for i in range(a, b):
            c, s, f = np.int64(labels[i]), np.float64(confidences[i]), np.int64(frames[i])
            if not (s > 0.0 and s <= 1.0):
                return CONFIDENCE
            if f < 0 or f >= len(frame_t) or (i > a and f < np.int64(frames[i - 1])) \
                    or frame_t[f] < newest:
                return TIME
            newest = np.int64(frame_t[f])
            if seen[c] != v + 1 or seen_ids[c] == 0:
                return UNSEEN
            rest[c] -= s
            if i > a:
                starts[before] += 1
                if before != c:
                    changes[before] += 1
                    turns += 1
            before = c
        for e in range(evidence_start[v], evidence_start[v + 1]):
            left = rest[np.int64(classes[e])]
            slack = ROUNDING * (sums[e] + 1e-30)
            if left < -slack or (b - a == n and left > slack):
                return SUMS
        if switches[v] >= n or switches[v] < turns or (b - a == n and switches[v] != turns):
            return SWITCHES
    return WHOLE


def _all_or_damaged(fits: Mapping[str, bool]) -> None:
    """Raise ValueError with the first name whose condition does not hold."""
    for name, holds in fits.items():
        if not holds:
            raise ValueError(name)
