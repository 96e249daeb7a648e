"""Labels from parameters: a round without neighbours and two with, on as many voxels as wanted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.groups import Groups
from persem_ros.core.geometry.score import decide, score, Tables
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import step

SMOOTHED = 2                # rounds with neighbours
BUFFER = 1 << 28            # bytes of posteriors at a time; larger maps are labelled in slices
SLICE = 4096                # voxels in a slice at least


def label_rows(blocks: NDArray[np.void], taken: Any, votes: Votes, groups: Groups,
               tables: Tables, smoothing: float, buffer: int = BUFFER,
               ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """
    Return the most probable class of each refined row of a snapshot, and its probability.

    Parameters
    ----------
    blocks : ndarray, core.memory.pools.BLOCK
        The map's blocks.
    taken : core.refine.snapshot.Snapshot
        It holds the refined rows first, and two rings of neighbours around them.
    votes, groups : Votes, Groups
        Of all rows.
    tables : core.geometry.score.Tables
        Of the parameters.
    smoothing : float
        Weight of the neighbours (lambda).
    buffer : int
        Bytes that posteriors may take at a time.

    Returns
    -------
    best : ndarray, shape (refined,), int64
        Places in votes.classes.
    confidence : ndarray, shape (refined,), float32

    """
    n, refined = len(taken.number), taken.refined
    best, confidence = np.zeros(n, np.int64), np.zeros(n, np.float32)
    rows = max(SLICE, buffer // (16 * len(votes.classes)))
    slices = 1 if n <= rows else -(-refined * 2 // rows)        # a ring or two come on top
    for part in range(slices):
        core = np.arange(refined * part // slices, refined * (part + 1) // slices)
        _label_slice(blocks, taken, votes, groups, tables, smoothing, core, best, confidence)
    return best[:refined], confidence[:refined]


def _label_slice(blocks: NDArray[np.void], taken: Any, votes: Votes, groups: Groups,
                 tables: Tables, smoothing: float, core: NDArray[np.int64],
                 best: NDArray[np.int64], confidence: NDArray[np.float32]) -> None:
    """Label the rows *core* of a snapshot."""
    wanted = [core]
    if smoothing:
        for _ in range(SMOOTHED):
            wanted.insert(0, with_ring(blocks, taken, wanted[0]))
    where = np.full(len(taken.number), -1, np.int32)
    where[wanted[0]] = np.arange(len(wanted[0]))
    before, after = (np.zeros((len(wanted[0]), len(votes.classes))) for _ in range(2))
    for number, rows in enumerate(wanted):
        split(score, len(rows), rows, votes.start, votes.count, votes.place, votes.share,
              votes.total, groups.fine, groups.coarse, groups.shifted, *tables, blocks,
              taken.block, taken.cell, taken.row, where, before,
              float(smoothing) if number else 0.0, after)
        before, after = after, before
    split(decide, len(core), core, where, before, best, confidence)


def with_ring(blocks: NDArray[np.void], taken: Any, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return rows of a snapshot and those of all their neighbours in it, sorted."""
    if len(rows) == len(taken.number):
        return rows
    marked = np.zeros(len(taken.number), np.uint8)
    marked[rows] = 1
    split(mark_ring, len(rows), rows, blocks, taken.block, taken.cell, taken.row, marked)
    return np.flatnonzero(marked)


@kernel
def mark_ring(begin, end, rows, blocks, block, cell, row, marked):
    """Mark the neighbours of rows[begin:end]."""
    for w in range(begin, end):
        r = rows[w]
        here = blocks[block[r]]
        for d in range(27):
            other, at = step(here, cell[r], d)
            if other == 0:
                continue
            v = np.int64(blocks[other - 1].cells[at])
            if v > 0 and v <= len(row) and row[v - 1] > 0:
                marked[np.int64(row[v - 1]) - 1] = 1
