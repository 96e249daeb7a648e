"""Shapes of things as triangles: houses, trees, hedges, fences, vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate.materials import INDEX
import trimesh

# Three numbers, x y z or red green blue, as a vector or written out.
Three = Union[NDArray[np.float64], tuple[float, float, float]]

WHITE = (1.0, 1.0, 1.0)


class Triangles(NamedTuple):
    """A finished Solid: see there."""

    vertices: NDArray[np.float64]       # (n, 3)
    faces: NDArray[np.int64]            # (m, 3)
    material: NDArray[np.uint8]         # (m,)
    tint: NDArray[np.float32]           # (m, 3)
    base: NDArray[np.float32]           # (m,)


@dataclass(eq=False)
class Solid:
    """
    Triangles with what they are made of; parts are added, then joined once.

    Attributes
    ----------
    vertices : list of ndarray, shape (., 3)
        Metres.
    faces : list of ndarray, shape (., 3)
    material : list of ndarray, shape (faces,)
    tint : list of ndarray, shape (faces, 3)
        Multiplies the albedo of the material.
    base : list of ndarray, shape (faces,)
        z of the foot of a wall, metres: floors are counted from there.

    """

    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    material: list[NDArray[np.uint8]] = field(default_factory=list)
    tint: list[NDArray[np.float32]] = field(default_factory=list)
    base: list[NDArray[np.float32]] = field(default_factory=list)
    count: int = 0

    def add(
            self, vertices: NDArray[np.float64], faces: NDArray[np.int64], material: int | str,
            tint: NDArray[np.float64] | Three = WHITE, base: float = 0.0) -> None:
        """Add triangles; *tint* is one for all or one a face."""
        n = len(faces)
        self.vertices.append(np.asarray(vertices, float))
        self.faces.append(np.asarray(faces) + self.count)
        if isinstance(material, str):
            material = INDEX[material]
        self.material.append(np.broadcast_to(np.uint8(material), n))
        self.tint.append(np.broadcast_to(np.asarray(tint, np.float32), (n, 3)))
        self.base.append(np.broadcast_to(np.float32(base), n))
        self.count += len(vertices)

    def arrays(self) -> Triangles:
        """Return everything, each as one array."""
        return Triangles(np.concatenate(self.vertices),
                         np.concatenate(self.faces).astype(np.int64),
                         np.concatenate(self.material), np.concatenate(self.tint),
                         np.concatenate(self.base))


_SQUARE = ((-.5, -.5), (.5, -.5), (.5, .5), (-.5, .5))
_BOX = np.array([[x, y, z] for z in (0, 1) for x, y in _SQUARE])
_SIDES = np.array([[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4],
                   [3, 4, 7]])
_TOP = np.array([[4, 5, 6], [4, 6, 7]])


def placed(vertices: NDArray[np.float64], at: Three, yaw: float) -> NDArray[np.float64]:
    """Return *vertices*, shape (n, 3), turned by *yaw* (rad) and moved to *at*."""
    c, s = np.cos(yaw), np.sin(yaw)
    return vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + at


def box(solid: Solid, at: Three, yaw: float, size: Three, material: str, tint: Three = WHITE,
        top: str | None = None) -> None:
    """Add an upright box without bottom; *at* is the middle of its foot, *size* its extent."""
    vertices = placed(_BOX * size, at, yaw)
    solid.add(vertices, _SIDES, material, tint, at[2])
    solid.add(vertices, _TOP, top or material, tint, at[2])


def house(solid: Solid, at: Three, yaw: float, size: Three, roof: str, tint: Three,
          roof_tint: Three) -> None:
    """
    Add a house; *size* is length, width, height of the eaves; *roof* gable, hip or flat.

    *at* is the middle of its foot on the ground; the walls reach half a metre below.

    """
    length, width, eaves = size
    at = np.asarray(at, float) - (0, 0, .5)
    walls = placed(_BOX * (length, width, eaves + .5), at, yaw)
    solid.add(walls, _SIDES, 'wall', tint, at[2] + .5)
    if roof == 'flat':
        solid.add(walls, _TOP, 'flat roof', roof_tint)
        for side in (-1, 1):        # the parapet
            for along, across, turn in ((length, width, 0), (width, length, np.pi / 2)):
                middle = placed(np.array([[0, side * (across / 2 - .15), eaves + .5]]), at,
                                yaw + turn)[0]
                box(solid, middle, yaw + turn, (along, .3, .5), 'flat roof', tint)
        for k in range(2):          # what stands on flat roofs
            along, across = length * (.25 - .45 * k), width * (.2 - .3 * k)
            spot = placed(np.array([[along, across, eaves + .5]]), at, yaw)[0]
            box(solid, spot, yaw, (2.2 + k, 1.8, 1.1 + .7 * k), 'flat roof', roof_tint)
        return
    over = .45
    a, b, rise = length / 2 + over, width / 2 + over, (width / 2) * .75
    ridge = a if roof == 'gable' else a - b
    low = eaves + .5 - over * .75
    shell = np.array([[-a, -b, low], [a, -b, low], [a, b, low], [-a, b, low],
                      [-ridge, 0, eaves + .5 + rise], [ridge, 0, eaves + .5 + rise]])
    slopes = np.array([[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]])
    ends = np.array([[1, 2, 5], [3, 0, 4]])
    solid.add(placed(shell, at, yaw), slopes, 'tiles', roof_tint)
    if roof == 'hip':
        solid.add(placed(shell, at, yaw), ends, 'tiles', roof_tint)
    else:
        gable = shell.copy()
        gable[:, 0] = np.sign(gable[:, 0]) * length / 2
        solid.add(placed(gable, at, yaw), ends, 'wall', tint, 1e4)     # no windows
    chimney = placed(np.array([[length * .22, width * .12, eaves + .5 + rise * .45]]), at, yaw)[0]
    box(solid, chimney, yaw, (.8, .6, rise * .55 + .7), 'wall', (.55, .38, .32), 'flat roof')


def crowns(solid: Solid, rng: np.random.Generator, at: NDArray[np.float64],
           radius: NDArray[np.float64], height: NDArray[np.float64], kind: str,
           tint: NDArray[np.float64]) -> None:
    """
    Add many trees or bushes at once.

    Parameters
    ----------
    solid : Solid
        Gets the triangles.
    rng : numpy.random.Generator
        For shapes and directions.
    at : ndarray, shape (n, 3)
        Feet, metres.
    radius, height : ndarray, shape (n,)
        Of the crown and of the whole plant, metres.
    kind : str
        leaves, needles or shrub.
    tint : ndarray, shape (n, 3)
        Multiplies the colour.

    """
    n = len(at)
    variants = [_cone() if kind == 'needles' else _lump(rng) for _ in range(3)]
    pick, yaw = rng.integers(0, 3, n), rng.uniform(0, 2 * np.pi, n)
    for v, (vertices, faces) in enumerate(variants):
        mine = np.flatnonzero(pick == v)
        c, s = np.cos(yaw[mine]), np.sin(yaw[mine])
        turn = np.zeros((len(mine), 3, 3))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1
        foot = {'leaves': .28, 'needles': .10, 'shrub': -.15}[kind]
        size = np.stack([radius[mine], radius[mine], height[mine] * (1 - foot)], -1)
        points = np.einsum('nij,nvj->nvi', turn, vertices[None] * size[:, None])
        points += at[mine][:, None] + (height[mine] * foot)[:, None, None] * (0, 0, 1)
        every = faces[None] + np.arange(len(mine))[:, None, None] * len(vertices)
        solid.add(points.reshape(-1, 3), every.reshape(-1, 3), kind,
                  np.repeat(tint[mine], len(faces), axis=0))
    if kind != 'shrub':
        prism = trimesh.creation.cylinder(radius=1, height=1, sections=6)
        points = prism.vertices * np.array([.2, .2, 1]) + (0, 0, .5)
        scale = np.stack([np.ones(n), np.ones(n), height * .5], -1)
        points = points[None] * scale[:, None] + at[:, None]
        every = prism.faces[None] + np.arange(n)[:, None, None] * len(prism.vertices)
        solid.add(points.reshape(-1, 3), every.reshape(-1, 3), 'trunk')


def _lump(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (vertices, faces) of a crown: unit radius, z from 0 to 1, knobbly."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.array(ball.vertices)
    knobs = rng.standard_normal((9, 3))
    knobs /= np.linalg.norm(knobs, axis=1, keepdims=True)
    near = np.exp(5.5 * (vertices @ knobs.T - 1)).max(axis=1)
    vertices *= (.70 + .36 * near + .05 * rng.standard_normal(len(vertices)))[:, None]
    vertices[:, 2] = (vertices[:, 2] + 1) / 2
    return vertices, np.array(ball.faces)


def _cone(sides: int = 9) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (vertices, faces) of a conifer: unit radius, z from 0 to 1, in tiers."""
    profile = np.array([[1, 0], [.42, .30], [.74, .28], [.28, .58], [.50, .56], [.16, .80],
                        [.27, .79], [0, 1]])
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    wobble = 1 + .18 * np.cos(angle * 3)[None, :] * np.array([1, -.5] * 4)[:, None]
    vertices = np.concatenate([np.column_stack([ring * (r * w)[:, None], np.full(sides, z)])
                               for (r, z), w in zip(profile, wobble)])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    low = np.arange(len(profile) - 1)[:, None] * sides
    a, b, c, d = (v.ravel() for v in (low + i, low + j, low + sides + j, low + sides + i))
    return vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def strip(solid: Solid, points: NDArray[np.float64], height: float, width: float, material: str,
          tint: Three = WHITE) -> None:
    """Add a wall, fence or hedge along the polyline *points*, shape (n, 3), metres."""
    for a, b in zip(points[:-1], points[1:]):
        along = b - a
        size = (np.hypot(along[0], along[1]) + width, width, height + .3)
        box(solid, (a + b) / 2 - (0, 0, .3), np.arctan2(along[1], along[0]), size, material, tint)


def vehicle(solid: Solid, at: Three, yaw: float, tint: Three, truck: bool = False) -> None:
    """Add a car or a truck; *at* is the middle of its foot, x of the vehicle is forward."""
    length, width = (7.2, 2.4) if truck else (4.3, 1.8)
    body = np.array([length, width, .75])
    at = np.asarray(at, float)
    if truck:
        box(solid, at + (0, 0, .45), yaw, (length, width, .4), 'glass')
        cab = placed(np.array([[length / 2 - 1, 0, .8]]), at, yaw)[0]
        box(solid, cab, yaw, (1.9, width * .95, 1.7), 'paint', tint)
        load = placed(np.array([[-.9, 0, .85]]), at, yaw)[0]
        box(solid, load, yaw, (length - 2.1, width, 2.3), 'paint', (.95, .95, .93))
        return
    box(solid, at + (0, 0, .25), yaw, body, 'paint', tint)
    low = _BOX[:4] * (length * .62, width * .92, 1)
    high = _BOX[:4] * (length * .38, width * .78, 1)
    cabin = np.concatenate([low + (-.25, 0, 1.0), high + (-.30, 0, 1.5)])
    solid.add(placed(cabin, at, yaw), _SIDES, 'glass')
    solid.add(placed(cabin, at, yaw), _TOP, 'paint', tint)
