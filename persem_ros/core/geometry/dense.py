"""
The posterior of a voxel from its votes, its shape and its neighbours, for up to 64 classes.

Logarithms are taken once a round (Tables); what is left per voxel are products, sums and
exponentials, all in the order that section 12 gives.

"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.groups import Cells, counts, Groups, KINDS, SHAPES
from persem_ros.core.geometry.hints import hints
from persem_ros.core.geometry.neighbours import AROUND, list_neighbours
from persem_ros.core.geometry.parameters import estimate, Parameters, Sums, TERM
from persem_ros.core.geometry.posteriors import say, smooth, state, WORK
from persem_ros.core.geometry.softmax import MAGIC, MAGIC_BITS, softmax
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import kernel, split

FAINT = 1e-4        # a Q of this and less adds nothing to sums, but for pi's
ROOM = 1 << 26      # bytes for labelling, however small the map is
NO_PLACES, NO_SHARES = np.empty(0, np.int64), np.empty(0, np.float32)


class Tables(NamedTuple):
    """
    Logarithms of the parameters, flat.

    pi (K,), theta (K * K) with rows c, and P_k / pi (groups * K).

    """

    pi: NDArray[np.float64]
    theta: NDArray[np.float64]
    fine: NDArray[np.float64]
    coarse: NDArray[np.float64]
    shifted: NDArray[np.float64]
    rho: float
    weight: float


@lru_cache(maxsize=1)       # refinements that follow each other go by the same: 1 of 50 ms
def tables_of(parameters: Parameters, settings: Any) -> Tables:
    """Return the Tables of parameters; settings are those of refine.geometry."""
    fine, coarse, shifted = (
        (np.log(parameters.shares(k, settings.prior) / parameters.pi)
         if counts(settings.groups, k) else np.zeros_like(parameters.groups[k])).reshape(-1)
        for k in range(3))
    known = np.log(hints(settings.heights, parameters.classes)).reshape(-1)
    return Tables(np.log(parameters.pi), np.log(parameters.theta + 1e-6).T.reshape(-1),
                  fine + known, coarse, shifted, parameters.rho, settings.weight)


class Dense:
    """
    A map's votes and groups, ready for rounds.

    Parameters
    ----------
    blocks : ndarray, core.memory.pools.BLOCK
        The map's blocks.
    taken : core.refine.snapshot.Snapshot
    votes, groups : Votes, Groups
        Of its rows.
    cells : pair of core.geometry.groups.Cells
        What the coarse groups count in.
    settings : persem_ros.settings.config.Geometry

    """

    def __init__(self, blocks: Any, taken: Any, votes: Votes, groups: Groups,
                 cells: tuple[Cells, Cells], settings: Any) -> None:
        self.blocks, self.taken, self.votes = blocks, taken, votes
        self.groups, self.cells, self.settings = groups, cells, settings
        self._sizes = [SHAPES, *(known.number * KINDS + 1 for known in cells)]

    @property
    def row_bytes(self) -> int:
        """Return the bytes that a voxel takes while it is labelled."""
        return 24 * len(self.votes.classes) + 4 * AROUND + 1

    @property
    def room(self) -> int:
        """Return the bytes that labelling may take in all: 16 a class and voxel of the map."""
        return max(ROOM, 16 * len(self.votes.classes) * len(self.taken.row))

    def start(self, rho: float) -> Sums:
        """Return the sums where Q is p."""
        votes, groups = self.votes, self.groups
        return _summed(split(
            count_shares, len(votes.count), votes.start, votes.count, votes.place, votes.share,
            votes.total, rho, groups.fine, groups.coarse, groups.shifted, len(votes.classes),
            *self._sizes))

    def round(self, parameters: Parameters,    # noqa: A003
              rows: Optional[int] = None) -> Sums:
        """Return the sums of a round without neighbours over all rows, or so many of the first."""
        votes, groups = self.votes, self.groups
        return _summed(split(
            _working(count_posteriors), len(votes.count) if rows is None else rows, votes.start,
            votes.count, votes.place,
            votes.share, votes.total, votes.agreement, groups.fine, groups.coarse,
            groups.shifted, *tables_of(parameters, self.settings), *self._sizes))

    def estimate(self, sums: Sums, rho: float) -> Parameters:
        """Return the parameters that follow from sums."""
        return estimate(sums, len(self.votes.count), self.votes.classes, self.cells, rho,
                        self.settings.shrink)

    def label(self, parameters: Parameters, wanted: list[NDArray[np.int64]],
              best: NDArray[np.int64], confidence: NDArray[np.float32]) -> None:
        """
        Label rows in rounds.

        Parameters
        ----------
        parameters : Parameters
            What to go by.
        wanted : list of ndarray, int64
            The rows of each round; the first holds all of them, the last those to be labelled.
        best, confidence : ndarray, shape (n,)
            Receive the place of the class and its probability.

        """
        self._rounds(parameters, wanted, best, confidence)

    def posterior(self, parameters: Parameters, wanted: list[NDArray[np.int64]],
                  around: NDArray[np.int64]) -> tuple[NDArray[np.float64], Any]:
        """Return Q (K,) of the one row of the last round, and the mean of its neighbours'."""
        where, last, before = self._rounds(parameters, wanted)
        return (last[where[wanted[-1][0]]].copy(),
                before[where[around]].mean(axis=0) if len(around) and len(wanted) > 1 else None)

    def _rounds(self, parameters: Parameters, wanted: list[NDArray[np.int64]],
                best: NDArray[np.int64] = NO_PLACES,
                confidence: NDArray[np.float32] = NO_SHARES) -> tuple[
            NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """
        Return places of rows, and their Q after the last round and after the one before.

        What votes and groups say, and who is beside whom, is found once for all rounds. With
        *best* and *confidence* the last round writes these and not Q.

        """
        votes, groups, taken = self.votes, self.groups, self.taken
        K, n, rest = len(votes.classes), len(wanted[0]), wanted[1:]
        where = np.full(len(taken.number), -1, np.int32)
        where[wanted[0]] = np.arange(n)
        said, before, after = (np.empty((n + 1) * K) for _ in range(3))
        for Q in (before, after):       # the last row is nobody's: smooth() adds it for padding
            Q[-K:] = 0.0
        split(_working(state), n, wanted[0], votes.start, votes.count, votes.place, votes.share,
              votes.total, groups.fine, groups.coarse, groups.shifted,
              *tables_of(parameters, self.settings), said, after)
        listed, beside = np.empty((n, AROUND), np.int32), np.zeros(n, np.uint8)
        if rest:
            split(list_neighbours, len(rest[0]), rest[0], self.blocks, taken.block, taken.cell,
                  taken.row, where, listed, beside)
        elif len(best):
            rest = wanted       # nobody is beside anyone
        for number, rows in enumerate(rest):
            before, after = after, before
            answer = (best, confidence) if number == len(rest) - 1 else (NO_PLACES, NO_SHARES)
            split(_working(smooth), len(rows), rows, where, said, K, listed, beside, before,
                  float(self.settings.smoothing), after, *answer)
        last, one_before = (Q.reshape(-1, K)[:-1] for Q in (after, before))
        return where, last, one_before


def _working(function: Any) -> Any:
    """Return a kernel with room of its own for each slice of the work."""
    return lambda begin, end, *arguments: function(begin, end, np.zeros(1, WORK), *arguments)


def looks(total: float, rho: float) -> float:
    """Return n_v, the effective number of independent looks."""
    return total / (1.0 + rho * max(total - 1.0, 0.0))


def _summed(parts: list[Any]) -> Sums:
    """Return the sum of the slices' sums."""
    total = None
    for confusion, mass, fine, coarse, shifted, share, agreement in parts:
        part = Sums(confusion, mass, [fine, coarse, shifted], share, int(agreement))
        if total is None:
            total = part
        else:
            total.add(part)
    assert total is not None
    return total


@kernel
def count_shares(begin, end, start, count, place, share, total, rho, fine, coarse, shifted, K,
                 n_fine, n_coarse, n_shifted):
    """Return the sums over voxels begin .. end where Q is p."""
    C, mass = np.zeros((K, K), np.int64), np.zeros(K, np.int64)
    R1, R2, R3 = np.zeros((n_fine, K), np.int64), np.zeros((n_coarse, K), np.int64), \
        np.zeros((n_shifted, K), np.int64)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        for e in range(start[r], start[r] + count[r]):
            z, q = place[e], share[e]
            for d in range(start[r], start[r] + count[r]):
                C[z, place[d]] += np.int64(np.rint(q * n * share[d] * TERM))
            whole = np.int64(np.rint(q * TERM))
            mass[z] += whole
            R1[fine[r], z] += whole
            R2[coarse[r], z] += whole
            R3[shifted[r], z] += whole
    return C, mass, R1, R2, R3, np.zeros(K, np.int64), np.int64(0)


@kernel
def count_posteriors(begin, end, work, start, count, place, share, total, agreement, fine, coarse,
                     shifted, log_pi, log_theta, log_fine, log_coarse, log_shifted, rho, weight,
                     n_fine, n_coarse, n_shifted):
    """Return the sums over voxels begin .. end of a round without neighbours; tables are flat."""
    K = len(log_pi)
    C, mass = np.zeros((K, K), np.int64), np.zeros(K, np.int64)
    R1, R2, R3 = np.zeros(n_fine * K, np.int64), np.zeros(n_coarse * K, np.int64), \
        np.zeros(n_shifted * K, np.int64)
    alike, agreed = np.zeros(K, np.int64), np.int64(0)
    Q, scratch = work[0].Q, work[0].scratch
    bits = scratch.view(np.int64)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        a, b = start[r], start[r] + count[r]
        one, two, three = fine[r] * K, coarse[r] * K, shifted[r] * K
        say(a, b, n, place, share, log_pi, log_theta, log_fine, one, log_coarse, two,
            log_shifted, three, weight, Q)
        softmax(K, Q, scratch, bits)
        for z in range(K):
            scratch[z] = Q[z] * TERM + MAGIC
        for z in range(K):
            mass[z] += bits[z] - MAGIC_BITS
        for z in range(K):
            q = Q[z]
            if q <= FAINT:
                continue
            for e in range(a, b):
                if place[e] >= 0:
                    C[z, place[e]] += np.int64(np.rint(q * n * share[e] * TERM))
            term = bits[z] - MAGIC_BITS
            R1[one + z] += term
            R2[two + z] += term
            R3[three + z] += term
            if agreement[r] >= 0.0:
                alike[z] += term
                agreed += np.int64(np.rint(q * agreement[r] * TERM))
    return C, mass, R1.reshape(n_fine, K), R2.reshape(n_coarse, K), R3.reshape(n_shifted, K), \
        alike, agreed
