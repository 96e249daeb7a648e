"""The schedule of section 12.5: parameters from the map's own histories, by a few EM rounds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from persem_ros.core.geometry.groups import Cells, Groups, KINDS, SHAPES
from persem_ros.core.geometry.parameters import correlation, estimate, FIRST_RHO, Parameters
from persem_ros.core.geometry.score import begin_sums, round_sums, tables_of
from persem_ros.core.geometry.votes import Votes


def fit(votes: Votes, groups: Groups, cells: tuple[Cells, Cells], settings: Any) -> Parameters:
    """
    Return the parameters of a map, fitted from the start.

    Parameters
    ----------
    votes, groups : Votes, Groups
        Of every voxel.
    cells : pair of Cells
        The cells that the coarse groups count in.
    settings : persem_ros.settings.config.Geometry
        rounds, weight, prior, shrink.

    """
    n, sizes = len(votes.count), [SHAPES, *(known.number * KINDS + 1 for known in cells)]
    rho = FIRST_RHO
    parameters = estimate(begin_sums(votes, groups, sizes), n, votes.classes, cells, rho,
                          settings.shrink)
    for number in range(settings.rounds):
        sums = round_sums(votes, groups, sizes, tables_of(parameters, settings))
        if number == 0:
            rho = correlation(sums, rho)
        parameters = estimate(sums, n, votes.classes, cells, rho, settings.shrink)
    return replace(parameters, rho=rho)
