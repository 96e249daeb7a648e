"""The noun terrain: heights and the ground map of materials; river, roads, fields, tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate.fields import make_field
from persem_ros.simulate.materials import INDEX

if TYPE_CHECKING:
    from persem_ros.simulate.fields import Field

HALF_X, HALF_Y = 260.0, 220.0   # metres, the drawn part of the world
CELL = 0.2                      # metres, of the ground map
STEP = 2.0                      # metres, of the terrain mesh
WATER_LEVEL = -1.8              # metres
BRIDGE_TOP = .25                # metres, the bridge's deck
STREETS_X = (48.0, 104.0, 160.0, 216.0)             # streets that run north-south, in the town
STREETS_Y = (-162.0, -108.0, -54.0, 56.0, 110.0, 164.0)     # and east-west; the main road is 0
TOWN = 26.0                     # metres: the town lies east of here
FOREST = -40.0                  # metres: the forest lies west of here

Metres = TypeVar('Metres', float, NDArray[np.float32], NDArray[np.float64])


@dataclass(frozen=True, eq=False)
class Terrain:
    """
    The ground of the world; x east, y north, z up, metres.

    Attributes
    ----------
    hills : Field
        Over (x, y).
    ground : ndarray, shape (rows, columns)
        Material of the cell at x = -HALF_X + CELL * column, y = -HALF_Y + CELL * row.
    edges : Field
        Over (x, y); makes borders of fields and woods irregular.

    """

    hills: Field
    edges: Field
    ground: NDArray[np.uint8]

    def height(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return z of the ground at x, y (arrays of one shape), metres."""
        return _height(self.hills, x, y)

    def on(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return *points*, shape (n, 2) or (2,), with the ground's z as (n, 3)."""
        points = np.asarray(points, float).reshape(-1, 2)
        return np.column_stack([points, self.height(points[:, 0], points[:, 1])])

    def material(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the material of the ground at x, y (arrays of one shape)."""
        column = np.clip(((np.asarray(x) + HALF_X) / CELL).astype(int), 0,
                         self.ground.shape[1] - 1)
        row = np.clip(((np.asarray(y) + HALF_Y) / CELL).astype(int), 0, self.ground.shape[0] - 1)
        return self.ground[row, column]

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return (vertices, faces) of the ground, with a coarse apron to the horizon."""
        apron = np.array([40.0, 120.0, 260.0, 500.0, 900.0])
        x, y = (np.concatenate([-half - apron[::-1], np.arange(-half, half + .1, STEP),
                                half + apron]) for half in (HALF_X, HALF_Y))
        grid = np.stack(np.meshgrid(x, y, indexing='ij'), -1).reshape(-1, 2)
        vertices = np.column_stack([grid, self.height(grid[:, 0], grid[:, 1])])
        corner = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)).ravel()
        faces = np.concatenate([np.stack([corner, corner + len(y), corner + 1], -1),
                                np.stack([corner + 1, corner + len(y), corner + len(y) + 1], -1)])
        return vertices, faces


def make_terrain(rng: np.random.Generator) -> Terrain:
    """Return the Terrain drawn from the generator *rng*."""
    hills, edges = make_field(rng, (75.0, 75.0), 24), make_field(rng, (9.0, 9.0), 24)
    x = np.arange(-HALF_X, HALF_X, CELL, dtype=np.float32)
    y = np.arange(-HALF_Y, HALF_Y, CELL, dtype=np.float32)
    ground = np.full((len(y), len(x)), INDEX['grass'], np.uint8)
    x, y = x[None, :], y[:, None]
    rough = _sampled(edges, x.ravel(), y.ravel())
    _draw_country(ground, x, y, rough)
    _draw_streets(ground, x, y)
    shore = 10 + .9 * np.clip(rough, -1.5, 1)           # all of it on the level bed
    ground[np.abs(x - river(y)) < shore] = INDEX['water']
    _draw_main_road(ground, x, y)
    return Terrain(hills, edges, ground)


def river(y: Metres) -> Metres:
    """Return x of the river's middle at y."""
    return -8 + 13 * np.sin(y / 62 + .6) + 5 * np.sin(y / 23)


def main_road(x: Metres) -> Metres:
    """Return y of the main road's middle at x."""
    return 5 * np.sin(x / 55) * np.clip((np.abs(x - 5) - 22) / 60, 0, 1)


def track(y: Metres) -> Metres:
    """Return x of the forest track's middle at y."""
    return -92 + 14 * np.sin(y / 37 + 1) + 4 * np.sin(y / 13)


def _height(hills: Field, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = np.asarray(x, float), np.asarray(y, float)
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float32)
    rolling = hills(points).reshape(x.shape).astype(float)
    away = np.abs(x - river(y))
    wild = smoothstep((FOREST + 30 - x) / 60)           # the town is nearly level
    z = (1.0 + 5.5 * wild) * rolling * smoothstep((away - 14) / 50)
    bank = smoothstep((away - 13) / 5)
    return z * bank + WATER_LEVEL * (1 - bank)


def smoothstep(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rise smoothly from 0 at t <= 0 to 1 at t >= 1."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _sampled(field: Field, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the field over (x, y) as (len(y), len(x)): every sixteenth cell, then blown up."""
    points = np.stack(np.meshgrid(x[::16], y[::16]), -1)
    coarse = field(points.reshape(-1, 2)).reshape(points.shape[0], points.shape[1])
    rows = np.minimum(np.arange(len(y)) / 16, coarse.shape[0] - 1.001)
    columns = np.minimum(np.arange(len(x)) / 16, coarse.shape[1] - 1.001)
    i, j = rows.astype(int), columns.astype(int)
    a, b = (rows - i)[:, None].astype(np.float32), (columns - j)[None].astype(np.float32)
    lines = coarse[:, j] * (1 - b) + coarse[:, j + 1] * b
    return lines[i] * (1 - a) + lines[i + 1] * a


def _draw_country(ground: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32],
                  rough: NDArray[np.float32]) -> None:
    """Draw meadows, fields, the forest's floor and its track."""
    west = x < river(y) - 14
    ground[west] = INDEX['meadow']
    ground[(x < FOREST + 5 * rough) & west] = INDEX['forest floor']
    for left, right, low, high, material in (
            (-78, -34, 22, 74, 'crop'), (-66, -32, -64, -14, 'soil'),
            (-160, -106, 84, 150, 'crop'), (-250, -176, -60, 10, 'soil'),
            (-72, -36, -140, -84, 'crop')):
        inside = (x > left + rough) & (x < right + rough) & (y > low + rough) & (y < high + rough)
        ground[inside & west & (x < river(y) - 17)] = INDEX[material]
    ground[np.abs(x - track(y)) < 1.7 + .25 * rough] = INDEX['gravel']


def _draw_streets(
        ground: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32]) -> None:
    """Draw the grid of streets, their pavements and markings, and a car park."""
    main = np.abs(y - main_road(x))
    for half, material in ((4.9, 'paving'), (3.0, 'asphalt')):
        for street in STREETS_X:
            ground[:, np.abs(x - street).ravel() < half] = INDEX[material]
        for street in STREETS_Y:
            ground[(np.abs(y - street) < half) & (x > STREETS_X[0] - 3)] = INDEX[material]
        if material == 'paving':
            ground[(main < 5.6) & (x > TOWN - 6)] = INDEX['paving']
    for street in STREETS_X:
        clear = np.min([np.abs(y - other) for other in STREETS_Y], axis=0) > 5
        ground[(np.abs(x - street) < .12) & (y % 6 < 2.6) & clear & (main > 7)] = INDEX['marking']
    park = (x > 110) & (x < 152) & (y > 12) & (y < 46)
    ground[park] = INDEX['asphalt']
    ground[park & (np.abs((x - 110) % 3 - 1.5) > 1.4) & ((y - 13) % 16 < 10)] = INDEX['marking']


def _draw_main_road(
        ground: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32]) -> None:
    """Draw the road that crosses the river on a bridge."""
    away = np.abs(y - main_road(x))
    ground[away < 3.6] = INDEX['asphalt']
    crossing = np.min([np.abs(x - street) for street in STREETS_X], axis=0) < 4.5
    ground[(away < .12) & (x % 7 < 3) & ~crossing] = INDEX['marking']
    ground[(np.abs(away - 3.35) < .1) & ~crossing] = INDEX['marking']
