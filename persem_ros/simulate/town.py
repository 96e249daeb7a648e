"""The town: houses on lots along the streets, gardens, the bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate import shapes, terrain as land
from persem_ros.simulate.materials import INDEX

if TYPE_CHECKING:
    from persem_ros.simulate.shapes import Solid
    from persem_ros.simulate.terrain import Terrain

ROOFS = np.array([(1, 1, 1), (.82, .80, .78), (.98, 1.3, 1.6), (.62, .85, 1.1), (1.1, 1.05, .95)])
WALLS = np.array([(1, 1, 1), (1.1, 1.08, 1.02), (.95, .82, .66), (.86, .88, .92), (1.05, .95, .8)])


def houses(solid: Solid, rng: np.random.Generator, terrain: Terrain) -> NDArray[np.float64]:
    """Build both sides of the streets; return what is taken: (n, 3) of x, y, radius."""
    taken = [np.array([[131.0, 29.0, 26.0]])]           # the car park
    blocks_x = (land.TOWN - 4, *land.STREETS_X, land.HALF_X)
    blocks_y = (-land.HALF_Y, *land.STREETS_Y[:3], 0.0, *land.STREETS_Y[3:], land.HALF_Y)
    for left, right in zip(blocks_x[:-1], blocks_x[1:]):
        for low, high in zip(blocks_y[:-1], blocks_y[1:]):
            if right - left > 20 and high - low > 20:
                _block(solid, rng, terrain, taken, left + 5.5, right - 5.5, low + 6, high - 6)
    hut = terrain.on(np.array([(-106.0, 22.0), (-60.0, -78.0), (-92.0, 60.0)]))
    for at in hut:
        shapes.house(solid, at, rng.uniform(0, 3), (9, 6, 3), 'gable', WALLS[2] * .7, ROOFS[1])
    taken.append(np.column_stack([hut[:, :2], np.full(len(hut), 9.0)]))
    return np.concatenate(taken)


def _block(
        solid: Solid, rng: np.random.Generator, terrain: Terrain, taken: list[NDArray[np.float64]],
        left: float, right: float, low: float, high: float) -> None:
    """Build two rows of lots, back to back, between four streets."""
    middle, x = (low + high) / 2, left
    big = rng.random() < .22
    while x + 12 < right:
        width = min(rng.uniform(26, 32) if big else rng.uniform(14, 19), right - x)
        for side in (-1, 1):
            depth = (high - low) / 2
            centre = np.array([x + width / 2, middle + side * (depth / 2 + 1)])
            if any(np.hypot(*(centre - t[:2])) < t[2] for part in taken for t in part):
                continue
            _lot(solid, rng, terrain, taken, centre, width, depth, side, big)
        x += width


def _lot(solid: Solid, rng: np.random.Generator, terrain: Terrain,
         taken: list[NDArray[np.float64]], centre: NDArray[np.float64], width: float, depth: float,
         side: int, big: bool) -> None:
    """Build one house with its garden's fence or hedge and a paved way to the street."""
    flat = big or rng.random() < .12
    size = np.array([width - rng.uniform(4.5, 7), depth * rng.uniform(.40, .52),
                     rng.uniform(7, 12) if big else rng.uniform(3.2, 6.4)])
    size[:2] = np.maximum(size[:2], 6)
    roof = 'flat' if flat else ('gable', 'gable', 'hip')[rng.integers(3)]
    at = terrain.on(centre + (rng.uniform(-1, 1), side * rng.uniform(0, 2)))[0]
    tint, roof_tint = WALLS[rng.integers(len(WALLS))], ROOFS[rng.integers(len(ROOFS))]
    if not flat and size[1] > size[0]:
        shapes.house(solid, at, np.pi / 2, (size[1], size[0], size[2]), roof, tint, roof_tint)
    else:
        shapes.house(solid, at, 0.0, size, roof, tint, roof_tint if not flat else WALLS[0])
    taken.append(np.array([[at[0], at[1], max(size[:2]) * .62]]))
    way = np.zeros((2, 2), int)
    way[:, 0] = ((at[0] + size[0] / 2 - 2.6 + np.array([0, 2.4]) + land.HALF_X) / land.CELL)
    way[:, 1] = np.sort((np.array([at[1], centre[1] + side * (depth / 2 + 2)]) + land.HALF_Y)
                        / land.CELL)
    patch = terrain.ground[way[0, 1]:way[1, 1], way[0, 0]:way[1, 0]]
    patch[patch == INDEX['grass']] = INDEX['paving']
    back, front = centre[1] - side * (depth / 2 + .6), centre[1] + side * (depth / 2 - 2.5)
    corner = [(centre[0] - width / 2, front), (centre[0] - width / 2, back),
              (centre[0] + width / 2, back)]
    kind = rng.random()
    line = terrain.on(np.concatenate([np.linspace(a, b, 4)
                                      for a, b in zip(corner[:-1], corner[1:])]))
    if kind < .55:
        shapes.strip(solid, line, 1.3, .12, 'planks', np.full(3, rng.uniform(.7, 1.3)))
    elif kind < .85:
        shapes.strip(solid, line, 1.5, .9, 'shrub', np.full(3, rng.uniform(.8, 1.1)))


def bridge(solid: Solid) -> None:
    """Build a deck with two parapets over the river, along the main road."""
    middle = land.river(0.0)
    y = land.main_road(middle)
    shapes.box(solid, (middle, y, land.BRIDGE_TOP - .8), 0.0, (32, 8.6, .8), 'concrete',
               top='asphalt')
    for side in (-1, 1):
        shapes.box(solid, (middle, y + side * 4.1, land.BRIDGE_TOP), 0.0, (32, .35, 1.0), 'planks',
                   (1.1, 1.5, 2.2))
