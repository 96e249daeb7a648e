"""What columns of voxels cost to cross: by class, and by height above the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import NONE, TILE
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

LETHAL = 100
UNKNOWN_COST = -1
UNKNOWN_CLASS = 65535


@dataclass(frozen=True, eq=False)
class Rule:
    """
    Costs and heights.

    Attributes
    ----------
    cost : ndarray, shape (65536,), int16
        Of a class on the ground, 0 .. 100; a class of which the legend does not say it: 100.
    step, height : int
        Voxels above the ground: more than step, up to height is an obstacle.
    window : int
        grid.window.
    min_observations : int
    top : bool
        Whether a cell's class is that of its top-most voxel, else that of its ground.

    """

    cost: NDArray[np.int16]
    step: int
    height: int
    window: int
    min_observations: int
    top: bool


def rule_of(config: Config, legend: Legend, voxel_size: float) -> Rule:
    """
    Return the Rule of the settings grid.* and of a legend.

    Raises
    ------
    PersemError
        For a legend without costs, a map whose z does not point up, and cells smaller than
        voxels.

    """
    grid, costs = config.grid, legend.numbers('cost')
    if not costs:
        raise PersemError(
            'a grid needs costs of the classes, but the legend '
            + (f'{legend.title!r} has none' if legend.classes else 'is empty')
            + '; give its classes a key cost, 0 (free) to 100 (lethal), as in '
            "'- {id: 3, name: road, cost: 0}'")
    if config.refine.up != 'z':
        raise PersemError(f'a grid needs z to point up, in this map {config.refine.up} does '
                          '(refine.up)')
    if 0 < grid.resolution < voxel_size * (1 - 1e-9):
        raise PersemError(f'grid.resolution: expected 0 or at least the size of a voxel '
                          f'({voxel_size:g} m), got {grid.resolution:g}')
    if grid.height <= grid.step:
        raise PersemError(f'grid.height: expected more than grid.step ({grid.step:g} m), got '
                          f'{grid.height:g}')
    cost = np.full(65536, LETHAL, np.int16)
    cost[list(costs)] = list(costs.values())
    # One voxel above the lowest one is the ground's own thickness.
    step = max(1, int(grid.step / voxel_size + 1e-9))
    return Rule(cost, step, max(step, int(grid.height / voxel_size + 1e-9)), grid.window,
                grid.min_observations, grid.labels == 'top')


def column_of(voxel: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the place (n,) of voxels' columns in their tiles of 8 x 8, j fastest."""
    return (voxel[:, 0].astype(np.int64) & 7) * SIDE + (voxel[:, 1] & 7)


def lowest_of(voxel: NDArray[np.int32], tile: NDArray[np.int64], tiles: int
              ) -> NDArray[np.int32]:
    """Return the lowest k of each column, (tiles, 64) int32; NONE where there is no voxel."""
    lowest = np.full(tiles * TILE, NONE, np.int32)
    np.minimum.at(lowest, tile * TILE + column_of(voxel), voxel[:, 2])
    return lowest.reshape(tiles, TILE)


def costs_of(voxel: NDArray[np.int32], label: NDArray[np.uint16], tile: NDArray[np.int64],
             level: NDArray[np.int32], rule: Rule
             ) -> tuple[NDArray[np.int8], NDArray[np.uint16]]:
    """
    Return what the columns of tiles cost and are.

    Parameters
    ----------
    voxel : ndarray, shape (n, 3), int32
        All voxels of the tiles that count.
    label : ndarray, shape (n,), uint16
        Their classes.
    tile : ndarray, shape (n,), int64
        Row of *level* of each.
    level : ndarray, shape (T, 64), int32
        The ground's k under each column, NONE where there is none.
    rule : Rule
        Costs and heights.

    Returns
    -------
    cost : ndarray, shape (T, 64), int8
        0 .. 100; -1 where nothing was seen between the ground and rule.height.
    label : ndarray, shape (T, 64), uint16
        65535 where there is none.

    """
    place = tile * TILE + column_of(voxel)
    above = voxel[:, 2].astype(np.int64) - level.reshape(-1)[place]
    cost = np.full(level.size, UNKNOWN_COST, np.int8)
    within = above <= rule.height
    price = np.where(above > rule.step, LETHAL, rule.cost[label])[within].astype(np.int8)
    np.maximum.at(cost, place[within], price)
    classes = np.full(level.size, UNKNOWN_CLASS, np.uint16)
    # The last one of a column wins: the top-most, or the lowest of the ground.
    rows = np.arange(len(voxel)) if rule.top else np.flatnonzero(above <= rule.step)
    rows = rows[np.argsort(voxel[rows, 2] * (1 if rule.top else -1), kind='stable')]
    classes[place[rows]] = label[rows]
    return cost.reshape(level.shape), classes.reshape(level.shape)
