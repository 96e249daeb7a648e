"""Labels from parameters: a round without neighbours and two with, on as many voxels as wanted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import step

SMOOTHED = 2                # rounds with neighbours
BUFFER = 1 << 28            # bytes of posteriors at a time; larger maps are labelled in slices
SLICE = 4096                # voxels in a slice at least


def label_rows(model: Any, parameters: Any, buffer: int = BUFFER,
               ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """
    Return the most probable class of each refined row of a snapshot, and its probability.

    Parameters
    ----------
    model : core.geometry.dense.Dense or core.geometry.sparse.Sparse
        Its snapshot holds the refined rows first, and two rings of neighbours around them.
    parameters : Parameters or SparseParameters
        What to go by.
    buffer : int
        Bytes that posteriors may take at a time.

    Returns
    -------
    best : ndarray, shape (refined,), int64
        Places in votes.classes.
    confidence : ndarray, shape (refined,), float32

    """
    taken = model.taken
    n, refined = len(taken.number), taken.refined
    best, confidence = np.zeros(n, np.int64), np.zeros(n, np.float32)
    rows = max(SLICE, min(buffer, model.room) // model.row_bytes)
    # The rings are there, and no more.
    if taken.relief is not None and refined < n <= rows:
        rounds = [np.arange(n)] * (SMOOTHED if model.settings.smoothing else 0)
        model.label(parameters, [*rounds, np.arange(refined)], best, confidence)
        return best[:refined], confidence[:refined]
    slices = 1 if n <= rows else -(-refined * 2 // rows)        # a ring or two come on top
    for part in range(slices):
        wanted = [np.arange(refined * part // slices, refined * (part + 1) // slices)]
        if model.settings.smoothing:
            for _ in range(SMOOTHED):
                wanted.insert(0, with_ring(model.blocks, taken, wanted[0]))
        model.label(parameters, wanted, best, confidence)
    return best[:refined], confidence[:refined]


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
