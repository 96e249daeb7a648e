"""The plants: a forest, trees along the river and in gardens, bushes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate import shapes, terrain as land
from persem_ros.simulate.materials import INDEX

if TYPE_CHECKING:
    from persem_ros.simulate.shapes import Solid
    from persem_ros.simulate.terrain import Terrain


def plant(
        solid: Solid, rng: np.random.Generator, terrain: Terrain, taken: NDArray[np.float64]
) -> None:
    """Plant the forest, trees along river and in gardens, bushes."""
    x, y = (np.arange(-half + 3, half - 3, 5.2) for half in (land.HALF_X, land.HALF_Y))
    spot = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    spot += rng.uniform(-2.2, 2.2, spot.shape)
    luck = rng.random(len(spot))
    ground = terrain.material(spot[:, 0], spot[:, 1])
    clump = terrain.edges(spot.astype(np.float32) / np.float32(3))
    density = np.select([ground == INDEX[name] for name in ('forest floor', 'meadow', 'grass')],
                        [.93 - .5 * (clump > 1.0), .05 + .10 * (clump > .9), .26], 0.0)
    bank = np.abs(spot[:, 0] - land.river(spot[:, 1]))
    density[(bank > 12) & (bank < 17) & (ground != INDEX['forest floor'])] = .38
    density[(np.abs(spot[:, 1]) < 8) & (spot[:, 0] > -40)] = 0
    keep = luck < density
    for ring in np.array_split(taken, max(1, len(taken) // 16)):
        near = np.linalg.norm(spot[:, None] - ring[None, :, :2], axis=-1) < ring[None, :, 2]
        keep &= ~near.any(axis=1)
    small = terrain.material(spot[:, 0] + 1.6, spot[:, 1]) != ground
    small = small[keep] | (rng.random(keep.sum()) < .1)
    _grow(solid, rng, terrain, spot[keep], ground[keep], small)


def _grow(solid: Solid, rng: np.random.Generator, terrain: Terrain, spot: NDArray[np.float64],
          ground: NDArray[np.uint8], small: NDArray[np.bool_]) -> None:
    """Add a plant at each of *spot*, shape (n, 2): conifers and broadleaves, *small*: bushes."""
    n = len(spot)
    wood = ground == INDEX['forest floor']
    mixed = terrain.edges(spot.astype(np.float32) / np.float32(5) + np.float32(40)) > -.1
    conifer = wood & mixed & ~small
    broad = ~conifer & ~small
    at = terrain.on(spot)
    size = rng.uniform(.75, 1.25, n)
    tint = (1 + .16 * rng.standard_normal((n, 1)) + rng.standard_normal((n, 3)) * (.16, .07, .05))
    tint = np.clip(tint, .45, 1.7)
    for mine, kind, radius, height in (
            (conifer, 'needles', 2.1, 12.0), (broad & wood, 'leaves', 3.1, 10.5),
            (broad & ~wood, 'leaves', 2.4, 6.5), (small, 'shrub', 1.3, 1.7)):
        shapes.crowns(solid, rng, at[mine], radius * size[mine],
                      height * size[mine] * rng.uniform(.85, 1.15, mine.sum()), kind, tint[mine])
