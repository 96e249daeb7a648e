"""The schedule of section 12.5: parameters from the map's own histories, by a few EM rounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Optional

from persem_ros.core.geometry.parameters import correlation, FIRST_RHO


class Schedule:
    """
    How far the fit of a map's parameters has come.

    Parameters
    ----------
    rounds : int
        How many there are.
    estimate : callable
        estimate(sums, rho) gives the parameters that follow from the sums of the whole map.
    taken : int
        How many sums were taken already.
    parameters : Parameters or SparseParameters, optional
        Those that followed from them.

    Attributes
    ----------
    parameters : Parameters, SparseParameters or None
        By which the next round goes, at the end the result; None: the sums where Q is p come
        first.
    rho : float
        Correlation of two looks by which the next sums are taken.

    """

    def __init__(self, rounds: int, estimate: Callable[[Any, float], Any], taken: int = 0,
                 parameters: Optional[Any] = None) -> None:
        self._rounds, self._estimate, self.taken = rounds, estimate, taken
        self.parameters = parameters
        self.rho = FIRST_RHO if parameters is None else parameters.rho

    @property
    def ended(self) -> bool:
        """Return whether nothing is left to do."""
        return self.taken > self._rounds

    def sums(self, model: Any) -> Any:
        """Return the sums that are wanted now, of a model of the map or of a part of it."""
        if self.parameters is None:
            return model.start(self.rho)
        return model.round(self.parameters)

    def take(self, sums: Any) -> None:
        """Go on with the sums of the whole map."""
        if self.taken == 1:
            self.rho = correlation(sums, self.rho)
        self.parameters = self._estimate(sums, self.rho)
        self.taken += 1


def fit(model: Any, rounds: int) -> Any:
    """
    Return the parameters of a map, fitted from the start.

    Parameters
    ----------
    model : core.geometry.dense.Dense or core.geometry.sparse.Sparse
        Votes and groups of every voxel of the map.
    rounds : int
        How often.

    """
    schedule = Schedule(rounds, model.estimate)
    while not schedule.ended:
        schedule.take(schedule.sums(model))
    return schedule.parameters
