"""Sums and parameters of the method for more than 64 classes: tables of what occurs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.candidates import LIKELY
from persem_ros.core.geometry.entries import (
    Entries, entries_of, FREE, listed, merged, value_of)
from persem_ros.core.geometry.groups import Cells, counts, KINDS
from persem_ros.core.geometry.hints import hints
from persem_ros.core.geometry.parameters import common_arrays, OWN, TERM


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
            found[f'{name}_keys'], found[f'{name}_values'] = listed(entries)
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


def summed(parts: list[Any]) -> SparseSums:
    """Return the sum of the slices' sums."""
    confusion, mass, fine, coarse, shifted, share, agreement = zip(*[
        ((part[0], part[1]), part[2], part[3], (part[4], part[5]), (part[6], part[7]), part[8],
         int(part[9])) for part in parts])
    return SparseSums(merged(list(confusion)), sum(mass), sum(fine), merged(list(coarse)),
                      merged(list(shifted)), sum(share), sum(agreement))
