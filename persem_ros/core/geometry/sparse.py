"""
The method for more than 64 classes: a voxel has few candidates, tables hold what occurs.

Candidates are the classes that the voxel or a neighbour was seen as, and those that voxels of its
shape are most often. Every other class has Q = 0.

"""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.candidates import LIKELY, list_candidates, near_classes
from persem_ros.core.geometry.groups import Cells, Groups, SHAPES
from persem_ros.core.geometry.labelling import BUFFER
from persem_ros.core.geometry.sparse_kernels import (
    count_posteriors, count_shares, decide, score)
from persem_ros.core.geometry.sparse_parameters import (
    estimate_sparse, likely_of, SparseParameters, SparseSums, summed, tables_of)
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import split


class Sparse:
    """
    A map's votes and groups, ready for rounds.

    Parameters
    ----------
    blocks, taken, votes, groups, cells, settings
        As core.geometry.dense.Dense takes them.
    near : pair of ndarray, optional
        What candidates.near_classes gives, where it is known.

    """

    def __init__(self, blocks: Any, taken: Any, votes: Votes, groups: Groups,
                 cells: tuple[Cells, Cells], settings: Any,
                 near: Optional[tuple[NDArray[np.int64], NDArray[np.int32]]] = None) -> None:
        self.blocks, self.taken, self.votes = blocks, taken, votes
        self.groups, self.cells, self.settings = groups, cells, settings
        self.near = near_classes(blocks, taken, votes) if near is None else near

    @property
    def row_bytes(self) -> int:
        """Return the bytes that a voxel takes while it is labelled, about."""
        return 20 * (LIKELY + 1 + len(self.near[1]) // max(1, len(self.votes.count)))

    @property
    def room(self) -> int:
        """Return the bytes that labelling may take in all."""
        return BUFFER

    def start(self, rho: float) -> SparseSums:
        """Return the sums where Q is p."""
        votes, groups = self.votes, self.groups
        return summed(split(
            count_shares, len(votes.count), votes.start, votes.count, votes.place, votes.share,
            votes.total, rho, groups.fine, groups.coarse, groups.shifted, len(votes.classes),
            SHAPES))

    def round(self, parameters: SparseParameters,    # noqa: A003
              rows: Optional[int] = None) -> SparseSums:
        """Return the sums of a round without neighbours over all rows, or so many of the first."""
        votes, groups = self.votes, self.groups
        return summed(split(
            count_posteriors, len(votes.count) if rows is None else rows, votes.start,
            votes.count, votes.place,
            votes.share, votes.total, votes.agreement, groups.fine, groups.coarse,
            groups.shifted, *self.near, likely_of(parameters, self.settings),
            *tables_of(parameters, self.settings)))

    def estimate(self, sums: SparseSums, rho: float) -> SparseParameters:
        """Return the parameters that follow from sums."""
        return estimate_sparse(sums, len(self.votes.count), self.votes.classes, self.cells, rho,
                               self.settings.shrink)

    def label(self, parameters: SparseParameters, wanted: list[NDArray[np.int64]],
              best: NDArray[np.int64], confidence: NDArray[np.float32]) -> None:
        """Label rows in rounds, as core.geometry.dense.Dense.label does."""
        where, start, listed, last, _ = self._rounds(parameters, wanted)
        split(decide, len(wanted[-1]), wanted[-1], where, start, listed, last, best, confidence)

    def posterior(self, parameters: SparseParameters, wanted: list[NDArray[np.int64]],
                  around: NDArray[np.int64]) -> tuple[NDArray[np.float64], Any]:
        """Return Q (K,) of the one row of the last round, and the mean of its neighbours'."""
        where, start, listed, last, before = self._rounds(parameters, wanted)

        def full(row: int, values: NDArray[np.float64]) -> NDArray[np.float64]:
            Q = np.zeros(len(self.votes.classes))
            own = slice(start[where[row]], start[where[row] + 1])
            Q[listed[own]] = values[own]
            return Q

        theirs = [full(row, before) for row in around] if len(wanted) > 1 else []
        return full(wanted[-1][0], last), np.mean(theirs, axis=0) if theirs else None

    def _rounds(self, parameters: SparseParameters, wanted: list[NDArray[np.int64]]) -> Any:
        """Return where, start and list of candidates, Q after the last round and before it."""
        votes, groups, taken, rows = self.votes, self.groups, self.taken, wanted[0]
        tables, likely = tables_of(parameters, self.settings), likely_of(parameters, self.settings)
        where = np.full(len(taken.number), -1, np.int64)
        where[rows] = np.arange(len(rows))
        start = np.zeros(len(rows) + 1, np.int64)
        split(list_candidates, len(rows), rows, *self.near, groups.fine, likely, False, start[1:],
              start, np.empty(0, np.int32))
        np.cumsum(start, out=start)
        listed = np.empty(start[-1], np.int32)
        split(list_candidates, len(rows), rows, *self.near, groups.fine, likely, True, start[1:],
              start, listed)
        before, after = np.zeros(len(listed)), np.zeros(len(listed))
        for number, part in enumerate(wanted):
            split(score, len(part), part, votes.start, votes.count, votes.place, votes.share,
                  votes.total, groups.fine, groups.coarse, groups.shifted, *tables, self.blocks,
                  taken.block, taken.cell, taken.row, where, start, listed, before,
                  float(self.settings.smoothing) if number else 0.0, after)
            before, after = after, before
        return where, start, listed, before, after
