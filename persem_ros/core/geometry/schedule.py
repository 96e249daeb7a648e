"""The schedule of section 12.5: parameters from the map's own histories, by a few EM rounds."""

from __future__ import annotations

from typing import Any

from persem_ros.core.geometry.parameters import correlation, FIRST_RHO


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
    rho = FIRST_RHO
    parameters = model.estimate(model.start(rho), rho)
    for number in range(rounds):
        sums = model.round(parameters)
        if number == 0:
            rho = correlation(sums, rho)
        parameters = model.estimate(sums, rho)
    return parameters
