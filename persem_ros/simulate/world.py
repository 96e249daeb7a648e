"""The noun world: the town, the forest and the traffic, as triangles that rays can hit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from persem_ros.simulate import shapes, terrain as land
from persem_ros.simulate.materials import GROUND
from persem_ros.simulate.nature import plant
from persem_ros.simulate.shading import shadow_map
from persem_ros.simulate.town import bridge, houses
from persem_ros.simulate.traffic import Fleet, make_fleet, movers, parked
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector


class Caster(Protocol):
    """What is used of trimesh's RayMeshIntersector; rays are (m, 3) and (m, 3)."""

    def intersects_first(
            self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """Return the triangle, -1 for none, that each ray hits first."""

    def intersects_any(
            self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return whether each ray hits anything."""


@dataclass(frozen=True, eq=False)
class Scene:
    """
    Triangles, what they are made of, and a ray caster (Embree, through trimesh).

    Attributes
    ----------
    origins, normals : ndarray, shape (n, 3)
        A corner and the unit normal of every triangle, metres.
    material : ndarray, shape (n,)
        materials.GROUND for the terrain.
    tint : ndarray, shape (n, 3)
    base : ndarray, shape (n,)
        z of the foot of walls, metres.
    caster : Caster

    """

    origins: NDArray[np.float64]
    normals: NDArray[np.float64]
    material: NDArray[np.uint8]
    tint: NDArray[np.float32]
    base: NDArray[np.float32]
    caster: Caster

    def first(
            self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """Return the triangle, -1 for none, that each ray from *origin* hits, shape (n,)."""
        return self.caster.intersects_first(np.broadcast_to(origin, directions.shape), directions)


def make_scene(
        vertices: NDArray[np.float64], faces: NDArray[np.int64], material: NDArray[np.uint8],
        tint: NDArray[np.float32], base: NDArray[np.float32]) -> Scene:
    """Return the Scene of what shapes.Solid.arrays() returns."""
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Scene(corners[:, 0].copy(), normals, material, np.ascontiguousarray(tint), base,
                 RayMeshIntersector(mesh))


@dataclass(frozen=True, eq=False)
class World:
    """Everything that is flown over: terrain, what stands still, what moves."""

    terrain: land.Terrain
    scene: Scene
    fleet: Fleet

    @cached_property
    def shadow(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return shading.shadow_map of what stands still."""
        return shadow_map(self.scene)

    def traffic(self, time: float) -> Scene:
        """Return the Scene of the moving vehicles at *time* in seconds."""
        x, y, yaw = self.fleet.at(time)
        z = self.deck(x, y)
        return make_scene(self.fleet.vertices(x, y, z, yaw), *self.fleet.arrays[1:])

    def deck(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return z of the road at x, y (arrays): the ground's, or the bridge's."""
        z = self.terrain.height(x, y)
        bridge = (np.abs(x - land.river(y)) < 17) & (np.abs(y) < 12)
        return np.where(bridge, np.maximum(z, land.BRIDGE_TOP), z)


def make_world(seed: int) -> World:
    """Return the World of a seed: the same seed, the same world."""
    rng = np.random.default_rng([seed, 1])
    terrain = land.make_terrain(rng)
    solid = shapes.Solid()
    solid.add(*terrain.mesh(), GROUND)
    taken = houses(solid, rng, terrain)
    bridge(solid)
    parked(solid, rng, terrain)
    plant(solid, rng, terrain, taken)
    return World(terrain, make_scene(*solid.arrays()), make_fleet(movers(rng)))
