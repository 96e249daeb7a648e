"""What the camera sees: depth, class and colour of every pixel, by ray casting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.simulate import materials as mat, terrain as land
from persem_ros.simulate.shading import shade, sky, SUN, to_bytes

if TYPE_CHECKING:
    from persem_ros.frames import Camera
    from persem_ros.simulate.terrain import Terrain
    from persem_ros.simulate.world import Scene, World


@dataclass(frozen=True, eq=False)
class View:
    """
    One picture of the world, without any error.

    Attributes
    ----------
    depth : ndarray, shape (H, W)
        Metres along the optical axis; infinity where nothing is hit.
    labels : ndarray, shape (H, W)
        Class ids, materials.VOID where nothing is hit.
    points : ndarray, shape (H, W, 3)
        What the pixels see, in the map frame, metres.
    facing : ndarray, shape (H, W)
        Cosine of the angle between the ray and the surface's normal.
    color : ndarray, shape (H, W, 3)
        Red, green, blue.

    """

    depth: NDArray[np.float64]
    labels: NDArray[np.uint8]
    points: NDArray[np.float32]
    facing: NDArray[np.float32]
    color: NDArray[np.uint8]


class Canvas(NamedTuple):
    """A View under way, row by row; colours are linear intensities."""

    depth: NDArray[np.float64]      # (n,)
    labels: NDArray[np.uint8]       # (n,)
    points: NDArray[np.float32]     # (n, 3)
    facing: NDArray[np.float32]     # (n,)
    color: NDArray[np.float32]      # (n, 3)


class Renderer:
    """
    Renders one world through one camera.

    Parameters
    ----------
    world : persem_ros.simulate.world.World
    camera : persem_ros.frames.Camera

    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera
        rays = np.ones((camera.height, camera.width, 3))
        rays[..., :2] = camera.rays
        self._rays = rays.reshape(-1, 3)
        self._shadow = world.shadow
        self._slope = _slopes(world.terrain)

    def render(self, T_map_camera: NDArray[np.float64], time: float) -> View:
        """Return the View from a pose (4x4, optical frame to map) at *time* in seconds."""
        origin = np.ascontiguousarray(T_map_camera[:3, 3])
        n = len(self._rays)
        rays = np.empty((n, 3))
        turned(self._rays, np.ascontiguousarray(T_map_camera[:3, :3]), rays)
        out = Canvas(np.full(n, np.inf), np.full(n, mat.VOID, np.uint8),
                     np.zeros((n, 3), np.float32), np.ones(n, np.float32),
                     np.empty((n, 3), np.float32))
        sky(rays, out.color)
        scene, every = self.world.scene, np.arange(n)
        self._draw(scene, scene.first(origin, rays), every, origin, rays, out)
        self._draw_traffic(T_map_camera, time, origin, rays, out)
        shape = self.camera.height, self.camera.width
        color = cv2.GaussianBlur(out.color.reshape(*shape, 3), (3, 3), 0.55)    # an optic's blur
        shown = np.empty((*shape, 3), np.uint8)
        to_bytes(color.ravel(), shown.ravel())
        return View(out.depth.reshape(shape), out.labels.reshape(shape),
                    out.points.reshape(*shape, 3), out.facing.reshape(shape), shown)

    def _draw(
            self, scene: Scene, hit: NDArray[np.int32], pixels: NDArray[np.int64],
            origin: NDArray[np.float64], rays: NDArray[np.float64], out: Canvas) -> None:
        """Draw the triangles *hit* (-1: none) by the rays *pixels* where they are the nearest."""
        depth, labels, points, facing, color = out
        normals = np.empty((len(hit), 3), np.float32)
        material = np.full(len(hit), 255, np.uint8)
        meet(hit, pixels, origin, rays, scene.origins, scene.normals, scene.material, depth,
             points, normals, material)
        ground_material(pixels, points, material, self.world.terrain.ground, self._slope, normals)
        classify(pixels, origin, points, normals, material, mat.CLASS, labels, facing)
        shade(hit, pixels, origin, points, normals, material, scene.tint, scene.base, mat.ALBEDO,
              mat.STRENGTH, mat.SIZE, mat.PATTERN, SUN.astype(np.float32), self._shadow, color)

    def _draw_traffic(
            self, T_map_camera: NDArray[np.float64], time: float, origin: NDArray[np.float64],
            rays: NDArray[np.float64], out: Canvas) -> None:
        """Draw the moving vehicles and their shadows, only where the camera sees them."""
        scene = self.world.traffic(time)
        pixels = self._near(T_map_camera, scene.origins)
        if not len(pixels):
            return
        hit = scene.first(origin, rays[pixels])
        self._draw(scene, hit, pixels, origin, rays, out)
        below = pixels[(hit < 0) & np.isfinite(out.depth[pixels])]
        start = out.points[below].astype(float) + 0.05 * SUN
        dark = scene.caster.intersects_any(start, np.broadcast_to(SUN, start.shape))
        out.color[below[dark]] *= 0.35

    def _near(
            self, T_map_camera: NDArray[np.float64], points: NDArray[np.float64]
    ) -> NDArray[np.int64]:
        """Return the pixels in the rectangles, grown by shadows, around *points*, (n, 3)."""
        local = (points - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
        local = local[local[:, 2] > 1.0]
        K, height, width = self.camera.K, self.camera.height, self.camera.width
        u, v = (local[:, :2] / local[:, 2:] * (K[0, 0], K[1, 1]) + K[:2, 2]).T
        grow = 5.0 * K[0, 0] / local[:, 2]
        mask = np.zeros((height, width), np.uint8)
        seen = (u > -grow) & (u < width + grow) & (v > -grow) & (v < height + grow)
        corners = np.stack([u - grow, v - grow, u + grow, v + grow], -1)[seen]
        for left, top, right, bottom in np.unique((corners / 4).astype(int), axis=0) * 4:
            mask[max(top, 0):max(bottom, 0), max(left, 0):max(right, 0)] = 1
        return np.flatnonzero(mask)


def _slopes(terrain: Terrain) -> NDArray[np.float32]:
    """Return the terrain's gradient every STEP metres, shape (nx, ny, 2), float32."""
    x, y = (np.arange(-half, half + .1, land.STEP) for half in (land.HALF_X, land.HALF_Y))
    grid = np.meshgrid(x, y, indexing='ij')
    return np.stack(list(np.gradient(terrain.height(*grid), land.STEP)), -1).astype(np.float32)


@cached
def turned(rays, R, out):
    """Write R @ ray of every ray; their z is 1 in the camera, so that their t is the depth."""
    for i in range(len(rays)):
        for j in range(3):
            out[i, j] = R[j, 0] * rays[i, 0] + R[j, 1] * rays[i, 1] + R[j, 2] * rays[i, 2]


@cached
def meet(hit, pixels, origin, rays, corners, face_normals, face_material, depth, points, normals,
         material):
    """Where rays meet the planes of the triangles that they hit; *hit* becomes -1 if hidden."""
    for i in range(len(pixels)):
        face, pixel = hit[i], pixels[i]
        if face < 0:
            continue
        n, c, d = face_normals[face], corners[face], rays[pixel]
        slope = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
        away = n[0] * (c[0] - origin[0]) + n[1] * (c[1] - origin[1]) + n[2] * (c[2] - origin[2])
        t = away / slope if slope != 0.0 else np.inf
        if not (0.0 < t < depth[pixel]):
            hit[i] = -1
            continue
        depth[pixel] = t
        sign = -1.0 if slope > 0.0 else 1.0
        material[i] = face_material[face]
        for j in range(3):
            points[pixel, j] = origin[j] + t * d[j]
            normals[i, j] = sign * n[j]


@cached
def ground_material(pixels, points, material, ground, slope, normals):
    """Replace the terrain's material by the ground map's, its normal by a smooth one."""
    rows, columns = ground.shape
    for i in range(len(pixels)):
        if material[i] != mat.GROUND:
            continue
        x, y = points[pixels[i], 0], points[pixels[i], 1]
        row, column = int((y + land.HALF_Y) / land.CELL), int((x + land.HALF_X) / land.CELL)
        if not (0 <= row < rows and 0 <= column < columns and x > -land.HALF_X
                and y > -land.HALF_Y):
            material[i] = 0
            continue
        material[i] = ground[row, column]
        a, b = (x + land.HALF_X) / land.STEP, (y + land.HALF_Y) / land.STEP
        p = min(max(int(a), 0), slope.shape[0] - 2)
        q = min(max(int(b), 0), slope.shape[1] - 2)
        a, b = a - p, b - q
        s = np.empty(2)
        for j in range(2):
            s[j] = ((1 - a) * ((1 - b) * slope[p, q, j] + b * slope[p, q + 1, j])
                    + a * ((1 - b) * slope[p + 1, q, j] + b * slope[p + 1, q + 1, j]))
        norm = 1 / np.sqrt(1 + s[0] ** 2 + s[1] ** 2)
        normals[i, 0], normals[i, 1], normals[i, 2] = -s[0] * norm, -s[1] * norm, norm


@cached
def classify(pixels, origin, points, normals, material, classes, labels, facing):
    """Write the class and the cosine of incidence of every pixel that was hit."""
    for i in range(len(pixels)):
        if material[i] == 255:
            continue
        pixel = pixels[i]
        labels[pixel] = classes[material[i]]
        dot, norm = 0.0, 0.0
        for j in range(3):
            toward = origin[j] - points[pixel, j]
            dot += toward * normals[i, j]
            norm += toward * toward
        facing[pixel] = abs(dot) / np.sqrt(norm)
