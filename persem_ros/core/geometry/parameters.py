"""What the map's histories say of its classes: frequencies, confusions, shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.groups import Cells, cells_listed

TERM = 2.0 ** 30        # terms of sums are multiples of 1 / TERM: their order is of no account
FIRST_RHO = 0.4
RHO_BOUNDS = 0.1, 0.6
OWN = 0.7               # share of the prior of theta on the true class; the rest follows f


@dataclass(eq=False)
class Sums:
    """
    Sums over voxels of terms in units of 2^-30; sums of slices may be added.

    Attributes
    ----------
    confusion : ndarray, shape (K, K), int64
        C(z, c), in units of 2^-30.
    mass : ndarray, shape (K,), int64
        Sum of Q(z), nothing left out.
    groups : list of 3 ndarray, shape (number of groups, K), int64
        R(z, b).
    share : ndarray, shape (K,), int64
        Sum of Q(z) over the voxels with two votes or more.
    agreement : int
        Sum of Q(z) * agreement over the same voxels.

    """

    confusion: NDArray[np.int64]
    mass: NDArray[np.int64]
    groups: list[NDArray[np.int64]]
    share: NDArray[np.int64]
    agreement: int

    def alike(self) -> NDArray[np.float64]:
        """Return the chance that two independent looks at each class say the same, (K,)."""
        counted = self.confusion / TERM
        rows = counted.sum(axis=1)
        return ((counted / np.where(rows > 0, rows, 1.0)[:, None]) ** 2).sum(axis=1)

    def add(self, other: Sums) -> None:
        """Add the sums of another slice."""
        self.confusion += other.confusion
        self.mass += other.mass
        for mine, others in zip(self.groups, other.groups):
            mine += others
        self.share += other.share
        self.agreement += other.agreement


@dataclass(frozen=True, eq=False)
class Parameters:
    """
    What a round estimated.

    Attributes
    ----------
    classes : ndarray, shape (K,), uint16
        The ids; elsewhere a class is its place here.
    cells : pair of core.geometry.groups.Cells
        Which cells the coarse groups belong to.
    pi : ndarray, shape (K,)
        Frequencies of the classes.
    theta : ndarray, shape (K, K)
        P(a look says c | it is z), rows z.
    groups : list of 3 ndarray, shape (number of groups, K)
        R(z, b), voxels; the last row of the two coarse ones, all 0, is for unknown cells.
    rho : float
        Correlation of two looks.

    """

    classes: NDArray[np.uint16]
    cells: tuple[Cells, Cells]
    pi: NDArray[np.float64]
    theta: NDArray[np.float64]
    groups: list[NDArray[np.float64]]
    rho: float

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as plain arrays, by name; core.geometry.kept reads them."""
        return {**common_arrays(self), 'theta': self.theta,
                **dict(zip(('fine', 'coarse', 'shifted'), self.groups))}

    def group_share(self, k: int, b: int, prior: float) -> NDArray[np.float64]:
        """Return P_k(z|b) of one group, (K,)."""
        counted = self.groups[k][b]
        return (counted + prior * self.pi) / (counted.sum() + prior)

    def shares(self, k: int, prior: float) -> NDArray[np.float64]:
        """Return P_k(z|b), shape (number of groups, K), for k = 0, 1, 2."""
        counted = self.groups[k]
        return (counted + prior * self.pi) / (counted.sum(axis=1)[:, None] + prior)


def common_arrays(parameters: Any) -> dict[str, NDArray[Any]]:
    """Return what both forms of parameters have, as plain arrays."""
    return {'classes': parameters.classes, 'pi': parameters.pi, 'rho': np.array([parameters.rho]),
            'cells': cells_listed(parameters.cells[0]),
            'shifted_cells': cells_listed(parameters.cells[1])}


def estimate(sums: Sums, n: int, classes: NDArray[np.uint16], cells: tuple[Cells, Cells],
             rho: float, shrink: float) -> Parameters:
    """Return the Parameters that follow from the sums over n voxels (section 12.4)."""
    K, counted = len(classes), sums.confusion / TERM
    total = counted.sum()
    f, a = counted.sum(axis=0) / total, shrink * total / K
    theta = (counted + a * (OWN * np.eye(K) + (1.0 - OWN) * f)) \
        / (counted.sum(axis=1)[:, None] + a)
    pi = sums.mass / TERM / n + 1e-9
    return Parameters(classes, cells, pi / pi.sum(), theta,
                      [group / TERM for group in sums.groups], rho)


def correlation(sums: Any, rho: float) -> float:
    """
    Return how much two looks of a voxel share beyond its class; *rho* where nothing tells.

    sums are Sums, or the sparse form's.

    """
    share = sums.share / TERM
    if not share.sum() > 0:
        return rho
    A = sums.agreement / TERM / share.sum()
    B = float((share / share.sum() * sums.alike()).sum())
    if 1.0 - B <= 1e-9:
        return rho
    return float(np.clip(2.0 * (A - B) / (1.0 - B), *RHO_BOUNDS))
