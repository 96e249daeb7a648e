"""
The method for more than 64 classes: a voxel has few candidates, tables hold what occurs.

Candidates are the classes that the voxel or a neighbour was seen as, and those that voxels of its
shape are most often. Every other class has Q = 0.

"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.candidates import gather, LIKELY, list_candidates, near_classes
from persem_ros.core.geometry.dense import FAINT
from persem_ros.core.geometry.entries import (
    count_in, Entries, entries_of, FEW, FREE, listed as as_listed, merged, value_of, wider)
from persem_ros.core.geometry.groups import Cells, counts, Groups, KINDS, SHAPES
from persem_ros.core.geometry.hints import hints
from persem_ros.core.geometry.labelling import BUFFER
from persem_ros.core.geometry.parameters import common_arrays, OWN, TERM
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import step


@dataclass(eq=False)
class SparseSums:
    """
    What core.geometry.parameters.Sums holds, in units of 2^-30, with what occurs of it.

    Attributes
    ----------
    confusion, coarse, shifted : pair of ndarray, int64
        Sorted keys z * K + c or group * K + z, and sums.
    mass, share : ndarray, shape (K,), int64
    fine : ndarray, shape (96, K), int64
    agreement : int

    """

    confusion: tuple[NDArray[np.int64], NDArray[np.int64]]
    mass: NDArray[np.int64]
    fine: NDArray[np.int64]
    coarse: tuple[NDArray[np.int64], NDArray[np.int64]]
    shifted: tuple[NDArray[np.int64], NDArray[np.int64]]
    share: NDArray[np.int64]
    agreement: int

    def add(self, other: SparseSums) -> None:
        """Add the sums of another slice."""
        for name in ('confusion', 'coarse', 'shifted'):
            setattr(self, name, merged([getattr(self, name), getattr(other, name)]))
        for name in ('mass', 'fine', 'share', 'agreement'):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def rows(self) -> NDArray[np.float64]:
        """Return the sum of C(z, c) over c, (K,)."""
        keys, values = self.confusion
        return _sums(keys // len(self.mass), values / TERM, len(self.mass))

    def alike(self) -> NDArray[np.float64]:
        """Return the chance that two independent looks at each class say the same, (K,)."""
        keys, values = self.confusion
        z = keys // len(self.mass)
        return _sums(z, (values / TERM / self.rows()[z]) ** 2, len(self.mass))


@dataclass(frozen=True, eq=False)
class SparseParameters:
    """
    What core.geometry.parameters.Parameters holds, with what occurs of it.

    Attributes
    ----------
    classes, cells, pi, rho
        As there.
    confusion : Entries
        C(z, c) by z * K + c.
    rows, f : ndarray, shape (K,)
        Sums of C over c, and the share of each c.
    a : float
        Weight of theta's prior.
    fine : ndarray, shape (96, K)
        R(z, b1).
    groups : pair of Entries
        R by group * K + z, of the coarse and the shifted groups.
    totals : pair of ndarray
        Sums of R over z.

    """

    classes: NDArray[np.uint16]
    cells: tuple[Cells, Cells]
    pi: NDArray[np.float64]
    rho: float
    confusion: Entries
    rows: NDArray[np.float64]
    f: NDArray[np.float64]
    a: float
    fine: NDArray[np.float64]
    groups: tuple[Entries, Entries]
    totals: tuple[NDArray[np.float64], NDArray[np.float64]]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as plain arrays, by name; core.geometry.kept reads them."""
        found = common_arrays(self)
        for name, entries in (('confusion', self.confusion), ('coarse', self.groups[0]),
                              ('shifted', self.groups[1])):
            found[f'{name}_keys'], found[f'{name}_values'] = as_listed(entries)
        return {**found, 'rows': self.rows, 'f': self.f, 'a': np.array([self.a]),
                'fine': self.fine, 'coarse_totals': self.totals[0],
                'shifted_totals': self.totals[1]}

    def group_share(self, k: int, b: int, prior: float) -> NDArray[np.float64]:
        """Return P_k(z|b) of one group, (K,)."""
        K = len(self.pi)
        counted = self.fine[b] if k == 0 else np.array(
            [value_of(*self.groups[k - 1], b * K + z, 0.0) for z in range(K)])
        return (counted + prior * self.pi) / (counted.sum() + prior)


class SparseTables(NamedTuple):
    """Logarithms of the parameters, and what is left to compute of those that do not occur."""

    pi: NDArray[np.float64]
    fine: NDArray[np.float64]
    theta_keys: NDArray[np.int64]
    theta_values: NDArray[np.float64]
    rows: NDArray[np.float64]
    f: NDArray[np.float64]
    a: float
    coarse_keys: NDArray[np.int64]
    coarse_values: NDArray[np.float64]
    coarse_rest: NDArray[np.float64]
    shifted_keys: NDArray[np.int64]
    shifted_values: NDArray[np.float64]
    shifted_rest: NDArray[np.float64]
    rho: float
    weight: float


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
        return _summed(split(
            count_shares, len(votes.count), votes.start, votes.count, votes.place, votes.share,
            votes.total, rho, groups.fine, groups.coarse, groups.shifted, len(votes.classes),
            SHAPES))

    def round(self, parameters: SparseParameters,    # noqa: A003
              rows: Optional[int] = None) -> SparseSums:
        """Return the sums of a round without neighbours over all rows, or so many of the first."""
        votes, groups = self.votes, self.groups
        return _summed(split(
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


@lru_cache(maxsize=1)
def likely_of(parameters: SparseParameters, settings: Any) -> NDArray[np.int32]:
    """Return the classes that each shape is most often, (96, 16), ascending."""
    P = (parameters.fine + settings.prior * parameters.pi) \
        / (parameters.fine.sum(axis=1)[:, None] + settings.prior)
    P *= hints(settings.heights, parameters.classes)
    most = np.argsort(-P, axis=1, kind='stable')[:, :LIKELY]
    return np.ascontiguousarray(np.sort(most, axis=1).astype(np.int32))


@lru_cache(maxsize=1)       # refinements that follow each other go by the same
def tables_of(parameters: SparseParameters, settings: Any) -> SparseTables:
    """Return the SparseTables of parameters; settings are those of refine.geometry."""
    known, prior, pi, K = parameters, settings.prior, parameters.pi, len(parameters.pi)
    keys, values = known.confusion
    z, c = keys // K, keys % K
    theta = np.where(keys == FREE, 1.0, (
        values + known.a * (OWN * (z == c) + (1.0 - OWN) * known.f[c]))
        / (known.rows[z] + known.a))
    fine = (known.fine + prior * pi) / (known.fine.sum(axis=1)[:, None] + prior)
    logs: list[NDArray[Any]] = []
    chosen = settings.groups
    if not counts(chosen, 0):
        fine = np.tile(pi, (len(fine), 1))
    fine = fine * hints(settings.heights, parameters.classes)
    for (group_keys, R), total in zip(known.groups, known.totals):
        if not counts(chosen, 1):
            logs += [*entries_of(np.empty(0, np.int64), np.empty(0)), np.zeros(len(total))]
            continue
        z = group_keys % K
        ratio = (R + prior * pi[z]) / (total[np.maximum(group_keys, 0) // K] + prior) / pi[z]
        logs += [group_keys, np.log(np.where(group_keys == FREE, 1.0, ratio)),
                 np.log(prior / (total + prior))]
    coarse_keys, coarse_values, coarse_rest, shifted_keys, shifted_values, shifted_rest = logs
    return SparseTables(np.log(pi), np.log(fine / pi), keys, np.log(theta + 1e-6),
                        known.rows, known.f, known.a, coarse_keys, coarse_values, coarse_rest,
                        shifted_keys, shifted_values, shifted_rest, known.rho,
                        settings.weight)


def estimate_sparse(sums: SparseSums, n: int, classes: NDArray[np.uint16],
                    cells: tuple[Cells, Cells], rho: float, shrink: float) -> SparseParameters:
    """Return the SparseParameters that follow from the sums over n voxels (section 12.4)."""
    K, rows = len(sums.mass), sums.rows()
    keys, values = sums.confusion
    total = rows.sum()
    pi = sums.mass / TERM / n + 1e-9
    groups, totals = [], []
    for counted, known in zip((sums.coarse, sums.shifted), cells):
        groups.append(entries_of(counted[0], counted[1] / TERM))
        totals.append(_sums(counted[0] // K, counted[1] / TERM, known.number * KINDS + 1))
    return SparseParameters(
        classes, cells, pi / pi.sum(), rho, entries_of(keys, values / TERM), rows,
        np.bincount(keys % K, values / TERM, K) / total, shrink * total / K, sums.fine / TERM,
        (groups[0], groups[1]), (totals[0], totals[1]))


def _sums(places: NDArray[np.int64], weights: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Return the sums (n,) of weights by place."""
    sums: Any = np.bincount(places, weights, n)     # by its stubs whole numbers
    return sums


def _summed(parts: list[Any]) -> SparseSums:
    """Return the sum of the slices' sums."""
    confusion, mass, fine, coarse, shifted, share, agreement = zip(*[
        ((part[0], part[1]), part[2], part[3], (part[4], part[5]), (part[6], part[7]), part[8],
         int(part[9])) for part in parts])
    return SparseSums(merged(list(confusion)), sum(mass), sum(fine), merged(list(coarse)),
                      merged(list(shifted)), sum(share), sum(agreement))


@kernel
def count_shares(begin, end, start, count, place, share, total, rho, fine, coarse, shifted, K,
                 n_fine):
    """Return the sums over voxels begin .. end where Q is p."""
    C_keys, C = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    b_keys, b_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    s_keys, s_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    n_C, n_b, n_s = 0, 0, 0
    mass, R1 = np.zeros(K, np.int64), np.zeros((n_fine, K), np.int64)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        for e in range(start[r], start[r] + count[r]):
            z, q = np.int64(place[e]), share[e]
            for d in range(start[r], start[r] + count[r]):
                n_C += count_in(C_keys, C, z * K + place[d],
                                np.int64(np.rint(q * n * share[d] * TERM)))
                if 2 * n_C > len(C):
                    C_keys, C = wider(C_keys, C)
            whole = np.int64(np.rint(q * TERM))
            mass[z] += whole
            R1[fine[r], z] += whole
            n_b += count_in(b_keys, b_sums, np.int64(coarse[r]) * K + z, whole)
            if 2 * n_b > len(b_sums):
                b_keys, b_sums = wider(b_keys, b_sums)
            n_s += count_in(s_keys, s_sums, np.int64(shifted[r]) * K + z, whole)
            if 2 * n_s > len(s_sums):
                s_keys, s_sums = wider(s_keys, s_sums)
    return C_keys, C, mass, R1, b_keys, b_sums, s_keys, s_sums, np.zeros(K, np.int64), np.int64(0)


@kernel
def count_posteriors(begin, end, start, count, place, share, total, agreement, fine, coarse,
                     shifted, near_start, near, likely, log_pi, log_fine, theta_keys,
                     theta_values, rows, f, a, coarse_keys, coarse_values, coarse_rest,
                     shifted_keys, shifted_values, shifted_rest, rho, weight):
    """Return the sums over voxels begin .. end of a round without neighbours."""
    K = len(log_pi)
    C_keys, C = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    b_keys, b_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    s_keys, s_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    n_C, n_b, n_s = 0, 0, 0
    mass, R1 = np.zeros(K, np.int64), np.zeros((len(log_fine), K), np.int64)
    alike, agreed = np.zeros(K, np.int64), np.int64(0)
    listed, Q = np.empty(K, np.int32), np.empty(K)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        m = gather(near_start[r], near_start[r + 1], near, likely[fine[r]], listed, 0)
        most, whole = -np.inf, 0.0
        for j in range(m):
            z = np.int64(listed[j])
            likelihood = 0.0
            for e in range(start[r], start[r] + count[r]):
                c = np.int64(place[e])
                if c >= 0:
                    likelihood += share[e] * log_theta(theta_keys, theta_values, rows, f, a, K,
                                                       z, c)
            Q[j] = log_pi[z] + n * likelihood + weight * (
                log_fine[fine[r], z]
                + value_of(coarse_keys, coarse_values, np.int64(coarse[r]) * K + z,
                           coarse_rest[coarse[r]])
                + value_of(shifted_keys, shifted_values, np.int64(shifted[r]) * K + z,
                           shifted_rest[shifted[r]]))
            most = max(most, Q[j])
        for j in range(m):
            Q[j] = np.exp(Q[j] - most)
            whole += Q[j]
        for j in range(m):
            z, q = np.int64(listed[j]), Q[j] / whole
            term = np.int64(np.rint(q * TERM))
            mass[z] += term
            if q <= FAINT:
                continue
            for e in range(start[r], start[r] + count[r]):
                if place[e] < 0:
                    continue
                n_C += count_in(C_keys, C, z * K + place[e],
                                np.int64(np.rint(q * n * share[e] * TERM)))
                if 2 * n_C > len(C):
                    C_keys, C = wider(C_keys, C)
            R1[fine[r], z] += term
            n_b += count_in(b_keys, b_sums, np.int64(coarse[r]) * K + z, term)
            if 2 * n_b > len(b_sums):
                b_keys, b_sums = wider(b_keys, b_sums)
            n_s += count_in(s_keys, s_sums, np.int64(shifted[r]) * K + z, term)
            if 2 * n_s > len(s_sums):
                s_keys, s_sums = wider(s_keys, s_sums)
            if agreement[r] >= 0.0:
                alike[z] += term
                agreed += np.int64(np.rint(q * agreement[r] * TERM))
    return C_keys, C, mass, R1, b_keys, b_sums, s_keys, s_sums, alike, agreed


@kernel
def log_theta(keys, values, rows, f, a, K, z, c):
    """Return log(theta(z, c) + 1e-6), from the table or from the prior alone."""
    found = value_of(keys, values, z * K + c, np.inf)
    if found != np.inf:
        return found
    return np.log(a * (OWN * (z == c) + (1.0 - OWN) * f[c]) / (rows[z] + a) + 1e-6)


@kernel
def score(begin, end, wanted, start, count, place, share, total, fine, coarse, shifted, log_pi,
          log_fine, theta_keys, theta_values, rows, f, a, coarse_keys, coarse_values, coarse_rest,
          shifted_keys, shifted_values, shifted_rest, rho, weight, blocks, block, cell, row,
          where, own_start, listed, before, smoothing, after):
    """
    Write Q of the candidates of the rows wanted[begin:end] to *after*.

    own_start and listed are the candidates by where[row]; with a smoothing other than 0 the
    neighbours' Q are read from *before*.

    """
    K = len(log_pi)
    mean = np.zeros(K)
    for w in range(begin, end):
        r = wanted[w]
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        first, last = own_start[where[r]], own_start[where[r] + 1]
        for j in range(first, last):
            z = np.int64(listed[j])
            likelihood = 0.0
            for e in range(start[r], start[r] + count[r]):
                c = np.int64(place[e])
                if c >= 0:
                    likelihood += share[e] * log_theta(theta_keys, theta_values, rows, f, a, K,
                                                       z, c)
            after[j] = log_pi[z] + n * likelihood + weight * (
                log_fine[fine[r], z]
                + value_of(coarse_keys, coarse_values, np.int64(coarse[r]) * K + z,
                           coarse_rest[coarse[r]])
                + value_of(shifted_keys, shifted_values, np.int64(shifted[r]) * K + z,
                           shifted_rest[shifted[r]]))
        if smoothing != 0.0:
            around = 0
            for j in range(first, last):
                mean[listed[j]] = 0.0
            here = blocks[block[r]]
            for d in range(27):
                other, at = step(here, cell[r], d)
                if d == 13 or other == 0:
                    continue
                v = np.int64(blocks[other - 1].cells[at])
                if v == 0 or v > len(row) or row[v - 1] == 0:
                    continue
                around += 1
                u = where[np.int64(row[v - 1]) - 1]
                for j in range(own_start[u], own_start[u + 1]):
                    mean[listed[j]] += before[j]
            if around > 0:
                for j in range(first, last):
                    after[j] += smoothing * (mean[listed[j]] / around)
        most, whole = -np.inf, 0.0
        for j in range(first, last):
            most = max(most, after[j])
        for j in range(first, last):
            after[j] = np.exp(after[j] - most)
            whole += after[j]
        for j in range(first, last):
            after[j] /= whole


@kernel
def decide(begin, end, wanted, where, own_start, listed, posterior, best, confidence):
    """Write the most probable class and its probability; a tie goes to the smaller id."""
    for w in range(begin, end):
        r = wanted[w]
        first, last = own_start[where[r]], own_start[where[r] + 1]
        most = 0.0
        for j in range(first, last):
            most = max(most, posterior[j])
        j = first
        while most - posterior[j] > 1e-9:
            j += 1
        best[r] = listed[j]
        confidence[r] = posterior[j]
