"""The vehicles: those that stand and those that move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate import shapes, terrain as land

if TYPE_CHECKING:
    from persem_ros.simulate.shapes import Solid
    from persem_ros.simulate.terrain import Terrain

PAINTS = np.array([(.9, .9, .9), (.12, .12, .13), (.45, .47, .5), (.6, .08, .07), (.1, .18, .45),
                   (.75, .75, .72), (.1, .3, .2), (.9, .75, .2)])


@dataclass(frozen=True)
class Mover:
    """A vehicle that drives along a straight street to and fro."""

    x0: float
    y0: float
    x1: float
    y1: float
    speed: float
    start: float
    tint: tuple[float, float, float]
    truck: bool

    def at(self, time: float) -> tuple[float, float, float]:
        """Return x, y in metres and yaw in radians at *time* in seconds; it keeps right."""
        length = np.hypot(self.x1 - self.x0, self.y1 - self.y0)
        way = (self.start * 2 * length + self.speed * time) % (2 * length)
        back = way > length
        share = (2 * length - way if back else way) / length
        yaw = np.arctan2(self.y1 - self.y0, self.x1 - self.x0) + np.pi * back
        x = self.x0 + share * (self.x1 - self.x0) + 1.55 * np.sin(yaw)
        y = self.y0 + share * (self.y1 - self.y0) - 1.55 * np.cos(yaw)
        if self.y0 == self.y1 == 0:         # the main road is not straight
            y += land.main_road(x)
            yaw += np.arctan(land.main_road(x + .5) - land.main_road(x - .5))
        return x, y, yaw


@dataclass(frozen=True, eq=False)
class Fleet:
    """
    All moving vehicles.

    Attributes
    ----------
    movers : tuple of Mover
    arrays : shapes.Triangles
        Those of the vehicles, each at the origin, heading along x.
    owner : ndarray, shape (vertices,)
        The mover that each vertex belongs to.

    """

    movers: tuple[Mover, ...]
    arrays: shapes.Triangles
    owner: NDArray[np.int64]

    def at(self, time: float) -> NDArray[np.float64]:
        """Return x, y, yaw of all vehicles at *time* in seconds, each of shape (movers,)."""
        return np.array([mover.at(time) for mover in self.movers]).T

    def vertices(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64],
                 yaw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the vertices with the vehicles at x, y, z, yaw, shape (vertices, 3)."""
        c, s = np.cos(yaw)[self.owner], np.sin(yaw)[self.owner]
        v = self.arrays.vertices
        return np.stack([c * v[:, 0] - s * v[:, 1] + x[self.owner],
                         s * v[:, 0] + c * v[:, 1] + y[self.owner],
                         v[:, 2] + z[self.owner]], -1)


def make_fleet(movers: tuple[Mover, ...]) -> Fleet:
    """Return the Fleet of *movers*."""
    solid, owner = shapes.Solid(), []
    for i, mover in enumerate(movers):
        before = solid.count
        shapes.vehicle(solid, (0.0, 0.0, 0.0), 0.0, mover.tint, mover.truck)
        owner.append(np.full(solid.count - before, i))
    return Fleet(tuple(movers), solid.arrays(), np.concatenate(owner))


def parked(solid: Solid, rng: np.random.Generator, terrain: Terrain) -> None:
    """Add cars that stand in the car park and along the streets."""
    spots = [(111.5 + 3 * i, row, np.pi / 2) for i in range(13) for row in (18.0, 34.0)
             if rng.random() < .6]
    for street in land.STREETS_Y:
        spots += [(x, street + side * 4.0, 0.0) for x in np.arange(land.STREETS_X[0] + 10, 240, 11)
                  for side in (-1, 1)
                  if rng.random() < .28 and np.abs(np.array(land.STREETS_X) - x).min() > 9]
    for x, y, yaw in spots:
        at = terrain.on(np.array([x, y]))[0]
        shapes.vehicle(solid, at, yaw + rng.uniform(-.04, .04), PAINTS[rng.integers(len(PAINTS))])


def movers(rng: np.random.Generator) -> tuple[Mover, ...]:
    """Return the traffic: along the streets of the town and over the bridge."""
    lanes = [(-250.0, 0.0, 250.0, 0.0)] * 9
    lanes += [(x, -200.0, x, 200.0) for x in land.STREETS_X[:3] for _ in range(5)]
    lanes += [(land.STREETS_X[0], y, 250.0, y) for y in land.STREETS_Y[1:5] for _ in range(2)]
    return tuple(Mover(*lane, rng.uniform(6, 12), rng.random(),
                       tuple(PAINTS[rng.integers(len(PAINTS))]), bool(rng.random() < .18))
                 for lane in lanes)
