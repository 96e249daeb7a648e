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
from persem_ros.core.geometry.parameters import estimate, Parameters, Sums, TERM
from persem_ros.core.geometry.softmax import MAGIC, MAGIC_BITS, softmax
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.pools import SIDE

WIDE = SIDE + 2     # a block with a cell more on every side
MOST = 64           # classes; more have few candidates a voxel (core.geometry.sparse)
WORK = np.dtype([('Q', 'f8', MOST), ('scratch', 'f8', MOST), ('mean', 'f8', MOST)])
FAINT = 1e-4        # a Q of this and less adds nothing to sums, but for pi's


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
    return Tables(np.log(parameters.pi), np.log(parameters.theta + 1e-6).T.reshape(-1),
                  fine, coarse, shifted, parameters.rho, settings.weight)


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
        return 16 * len(self.votes.classes)

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
        where, last, _ = self._rounds(parameters, wanted)
        split(decide, len(wanted[-1]), wanted[-1], where, last, best, confidence)

    def posterior(self, parameters: Parameters, wanted: list[NDArray[np.int64]],
                  around: NDArray[np.int64]) -> tuple[NDArray[np.float64], Any]:
        """Return Q (K,) of the one row of the last round, and the mean of its neighbours'."""
        where, last, before = self._rounds(parameters, wanted)
        return (last[where[wanted[-1][0]]].copy(),
                before[where[around]].mean(axis=0) if len(around) and len(wanted) > 1 else None)

    def _rounds(self, parameters: Parameters, wanted: list[NDArray[np.int64]]) -> tuple[
            NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return places of rows, and their Q after the last round and after the one before."""
        votes, groups, taken = self.votes, self.groups, self.taken
        tables = tables_of(parameters, self.settings)
        where = np.full(len(taken.number), -1, np.int32)
        where[wanted[0]] = np.arange(len(wanted[0]))
        before, after = (np.empty((len(wanted[0]) + 1) * len(votes.classes)) for _ in range(2))
        for Q in (before, after):       # the last row is nobody's: score() adds it for padding
            Q[-len(votes.classes):] = 0.0
        for number, rows in enumerate(wanted):
            split(_working(score), len(rows), rows, votes.start, votes.count, votes.place,
                  votes.share, votes.total, groups.fine, groups.coarse, groups.shifted, *tables,
                  self.blocks, taken.block, taken.cell, taken.row, where, before,
                  float(self.settings.smoothing) if number else 0.0, after)
            before, after = after, before
        last, one_before = (Q.reshape(-1, len(votes.classes))[:-1] for Q in (before, after))
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


@inlined
def say(a, b, n, place, share, log_pi, log_theta, log_fine, one, log_coarse, two, log_shifted,
        three, weight, Q):
    """
    Write what votes a .. b and the groups of a voxel say of each class, unnormalised logs.

    Tables are flat, one, two and three where its groups' rows begin: a view of a row would cost
    two atomic operations, as arrays do that are not a record's and change from call to call.
    Unsigned places need no look at their sign, so that loops become vectors.

    """
    K, u1, u2, u3 = len(log_pi), np.uint64(one), np.uint64(two), np.uint64(three)
    for z in range(K):
        Q[z] = 0.0
    for e in range(a, b):
        if place[e] < 0:        # a class that the parameters do not know
            continue
        p, of = share[e], np.uint64(place[e]) * np.uint64(K)
        for z in range(K):
            Q[z] += p * log_theta[of + np.uint64(z)]
    for z in range(K):
        u = np.uint64(z)
        Q[z] = log_pi[z] + n * Q[z] + weight * (
            log_fine[u1 + u] + log_coarse[u2 + u] + log_shifted[u3 + u])


@kernel
def score(begin, end, work, wanted, start, count, place, share, total, fine, coarse, shifted,
          log_pi, log_theta, log_fine, log_coarse, log_shifted, rho, weight, blocks, block, cell,
          row, where, before, smoothing, after):
    """
    Write Q of the rows wanted[begin:end] to *after*, at where[row]; tables and Q are flat.

    row is the snapshot's row + 1 of a voxel number; *before* ends with a row of zeros. With a
    smoothing of 0 no neighbour is looked at, otherwise their Q are read from *before*.

    """
    K = len(log_pi)
    Q, scratch, mean = work[0].Q, work[0].scratch, work[0].mean
    bits = scratch.view(np.int64)
    near, here = np.zeros((WIDE, WIDE, WIDE), np.int32), np.int64(-1)
    listed, nobody = np.empty(28 + 4, np.uint64), np.uint64(len(before) - K)
    for w in range(begin, end):
        r = wanted[w]
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        say(start[r], start[r] + count[r], n, place, share, log_pi, log_theta, log_fine,
            fine[r] * K, log_coarse, coarse[r] * K, log_shifted, shifted[r] * K, weight, Q)
        if smoothing != 0.0:
            if block[r] != here:
                here = block[r]
                places_around(blocks, here, row, where, near)
            x, y, z = cell[r] >> 6, cell[r] >> 3 & 7, cell[r] & 7
            around = 0
            for dx in range(3):
                for dy in range(3):
                    for dz in range(3):
                        place_of = near[x + dx, y + dy, z + dz]
                        listed[around] = np.uint64(place_of - 1) * np.uint64(K)
                        around += place_of != 0 and not (dx == 1 and dy == 1 and dz == 1)
            for c in range(K):
                mean[c] = 0.0
            for k in range(around, around + 3):
                listed[k] = nobody
            for k in range(0, around, 4):       # four a pass, in the order of one a pass
                one, two, three, four = listed[k], listed[k + 1], listed[k + 2], listed[k + 3]
                for c in range(K):
                    u = np.uint64(c)
                    mean[c] = (((mean[c] + before[one + u]) + before[two + u])
                               + before[three + u]) + before[four + u]
            if around > 0:
                for c in range(K):
                    Q[c] += smoothing * (mean[c] / around)
        softmax(K, Q, scratch, bits)
        mine = np.uint64(where[r]) * np.uint64(K)
        for c in range(K):
            after[mine + np.uint64(c)] = Q[c]


@inlined
def places_around(blocks, b, row, where, near):
    """Write where[row] + 1 of a block's voxels and of those around it; 0: none."""
    for x in range(WIDE):
        for y in range(WIDE):
            column = (((x + 7) >> 3) * 3 + ((y + 7) >> 3)) * 3
            at = (((x + 7) & 7) * SIDE + ((y + 7) & 7)) * SIDE
            for part in range(3):
                first, last = (0, 1) if part == 0 else (1, 9) if part == 1 else (9, 10)
                other = np.int64(blocks[b].near[column + part])
                if other == 0:
                    for z in range(first, last):
                        near[x, y, z] = 0
                    continue
                cells = blocks[other - 1].cells
                for z in range(first, last):
                    v = np.int64(cells[at + ((z + 7) & 7)])
                    found = np.int64(0)
                    if 0 < v <= len(row) and row[v - 1] > 0:
                        found = np.int64(where[np.int64(row[v - 1]) - 1]) + 1
                    near[x, y, z] = found


@kernel
def decide(begin, end, wanted, where, posterior, best, confidence):
    """Write the most probable class and its probability; a tie goes to the smaller id."""
    for w in range(begin, end):
        r = wanted[w]
        Q = posterior[where[r]]
        most = Q[0]
        for z in range(1, len(Q)):
            most = max(most, Q[z])
        z = 0
        while most - Q[z] > 1e-9:
            z += 1
        best[r] = z
        confidence[r] = Q[z]
