"""What the camera sees: depth, class and colour of every pixel, by ray casting."""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from persem_ros.simulate import materials as mat
from persem_ros.simulate import terrain as land

SUN = np.array([-0.46, -0.52, 0.72]) / np.linalg.norm([-0.46, -0.52, 0.72])
SHADOW_CELL = 0.35      # metres, of the shadow map
SHADOW_HALF = 180.0     # metres, half of the shadow map's edge


@dataclass(frozen=True, eq=False)
class View:
    """
    One picture of the world, without any error.

    Attributes
    ----------
    depth : ndarray, shape (H, W), float64
        Metres along the optical axis; infinity where nothing is hit.
    labels : ndarray, shape (H, W), uint8
        Class ids, materials.VOID where nothing is hit.
    points : ndarray, shape (H, W, 3), float32
        What the pixels see, in the map frame, metres.
    facing : ndarray, shape (H, W), float32
        Cosine of the angle between the ray and the surface's normal.
    color : ndarray, shape (H, W, 3), uint8
        Red, green, blue.

    """

    depth: np.ndarray
    labels: np.ndarray
    points: np.ndarray
    facing: np.ndarray
    color: np.ndarray


class Renderer:
    """
    Renders one world through one camera.

    Parameters
    ----------
    world : persem_ros.simulate.world.World
    camera : persem_ros.frames.Camera

    """

    def __init__(self, world, camera):
        self.world, self.camera = world, camera
        rays = np.ones((camera.height, camera.width, 3))
        rays[..., :2] = camera.rays
        self._rays = rays.reshape(-1, 3)
        self._shadow = shadow_map(world.scene)
        self._slope = _slopes(world.terrain)

    def render(self, T_map_camera, time):
        """Return the View from a pose (4x4, optical frame to map) at *time* in seconds."""
        origin = np.ascontiguousarray(T_map_camera[:3, 3])
        n = len(self._rays)
        rays = np.empty((n, 3))
        turned(self._rays, np.ascontiguousarray(T_map_camera[:3, :3]), rays)
        depth, labels = np.full(n, np.inf), np.full(n, mat.VOID, np.uint8)
        points, facing = np.zeros((n, 3), np.float32), np.ones(n, np.float32)
        color = np.empty((n, 3), np.float32)
        _sky(rays, color)
        scene, every = self.world.scene, np.arange(n)
        self._draw(scene, scene.first(origin, rays), every, origin, rays,
                   (depth, labels, points, facing, color))
        self._draw_traffic(T_map_camera, time, origin, rays, (depth, labels, points, facing, color))
        shape = self.camera.height, self.camera.width
        color = cv2.GaussianBlur(color.reshape(*shape, 3), (3, 3), 0.55)    # an optic's blur
        shown = np.empty((*shape, 3), np.uint8)
        to_bytes(color.ravel(), shown.ravel())
        return View(depth.reshape(shape), labels.reshape(shape), points.reshape(*shape, 3),
                    facing.reshape(shape), shown)

    def _draw(self, scene, hit, pixels, origin, rays, out):
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

    def _draw_traffic(self, T_map_camera, time, origin, rays, out):
        """Draw the moving vehicles and their shadows, only where the camera sees them."""
        scene = self.world.traffic(time)
        pixels = self._near(T_map_camera, scene.origins)
        if not len(pixels):
            return
        depth, labels, points, facing, color = out
        hit = scene.first(origin, rays[pixels])
        self._draw(scene, hit, pixels, origin, rays, out)
        below = pixels[(hit < 0) & np.isfinite(depth[pixels])]
        start = points[below].astype(float) + 0.05 * SUN
        dark = scene.caster.intersects_any(start, np.broadcast_to(SUN, start.shape))
        color[below[dark]] *= 0.35

    def _near(self, T_map_camera, points):
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


def shadow_map(scene):
    """Return (axes (2, 3), map): how far towards the sun the first thing lies, metres."""
    axes = np.array([np.cross(SUN, (0, 0, 1)), np.cross(SUN, np.cross(SUN, (0, 0, 1)))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    steps = np.arange(-SHADOW_HALF, SHADOW_HALF, SHADOW_CELL)
    a, b = np.meshgrid(steps, steps, indexing='ij')
    starts = a.reshape(-1, 1) * axes[0] + b.reshape(-1, 1) * axes[1] + 400 * SUN
    hit = scene.caster.intersects_first(starts, np.broadcast_to(-SUN, starts.shape))
    normals, corners = scene.normals[hit], scene.origins[hit]
    facing = normals @ SUN
    facing[np.abs(facing) < 1e-3] = 1e-3
    toward = np.einsum('ij,ij->i', corners - starts, normals) / facing + 400
    toward[hit < 0] = -1e4
    return axes.astype(np.float32), toward.astype(np.float32).reshape(a.shape)


def _slopes(terrain):
    """Return the terrain's gradient every STEP metres, shape (nx, ny, 2), float32."""
    x, y = (np.arange(-half, half + .1, land.STEP) for half in (land.HALF_X, land.HALF_Y))
    grid = np.meshgrid(x, y, indexing='ij')
    return np.stack(np.gradient(terrain.height(*grid), land.STEP), -1).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def turned(rays, R, out):
    """Write R @ ray of every ray; their z is 1 in the camera, so that their t is the depth."""
    for i in range(len(rays)):
        for j in range(3):
            out[i, j] = R[j, 0] * rays[i, 0] + R[j, 1] * rays[i, 1] + R[j, 2] * rays[i, 2]


@numba.njit(cache=True, nogil=True)
def to_bytes(linear, shown):
    """Write linear intensities as display values 0 .. 255, gamma 2."""
    for i in range(len(linear)):
        shown[i] = np.uint8(min(255.0, 255.0 * np.sqrt(max(linear[i], 0.0))))


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
def hashed(i, j, k):
    """Return a number in -1 .. 1 that depends on three integers, float32."""
    h = np.uint32(i) * np.uint32(374761393) + np.uint32(j) * np.uint32(668265263)
    h += np.uint32(k) * np.uint32(2147483647)
    h = (h ^ (h >> np.uint32(13))) * np.uint32(1274126177)
    return np.float32((h ^ (h >> np.uint32(16))) & np.uint32(0xffff)) / np.float32(32767.5) - 1


@numba.njit(cache=True, nogil=True)
def noise(x, y, z):
    """Return smooth noise in -1 .. 1 with cells of size 1."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    a, b, c = x - i, y - j, z - k
    a, b, c = a * a * (3 - 2 * a), b * b * (3 - 2 * b), c * c * (3 - 2 * c)
    low = ((1 - b) * ((1 - a) * hashed(i, j, k) + a * hashed(i + 1, j, k))
           + b * ((1 - a) * hashed(i, j + 1, k) + a * hashed(i + 1, j + 1, k)))
    high = ((1 - b) * ((1 - a) * hashed(i, j, k + 1) + a * hashed(i + 1, j, k + 1))
            + b * ((1 - a) * hashed(i, j + 1, k + 1) + a * hashed(i + 1, j + 1, k + 1)))
    return (1 - c) * low + c * high


@numba.njit(cache=True, nogil=True)
def sunlit(p, sun, axes, shadow):
    """Return how much of the sun a point sees, 0 .. 1, from the shadow map (four taps)."""
    a = (axes[0, 0] * p[0] + axes[0, 1] * p[1] + axes[0, 2] * p[2] + SHADOW_HALF) / SHADOW_CELL
    b = (axes[1, 0] * p[0] + axes[1, 1] * p[1] + axes[1, 2] * p[2] + SHADOW_HALF) / SHADOW_CELL
    i, j = int(np.floor(a)), int(np.floor(b))
    if i < 0 or j < 0 or i + 1 >= shadow.shape[0] or j + 1 >= shadow.shape[1]:
        return np.float32(1.0)
    toward = sun[0] * p[0] + sun[1] * p[1] + sun[2] * p[2] + 0.45
    a, b = a - i, b - j
    lit = ((1 - a) * ((1 - b) * (toward > shadow[i, j]) + b * (toward > shadow[i, j + 1]))
           + a * ((1 - b) * (toward > shadow[i + 1, j]) + b * (toward > shadow[i + 1, j + 1])))
    return np.float32(lit)


@numba.njit(cache=True, nogil=True)
def pattern_gain(pattern, p, n, base):
    """Return the factor on the albedo that a pattern (rows, windows, tiles, slabs) makes."""
    if pattern == mat.ROWS:
        return 1 + 0.22 * np.sin(2.7 * (0.94 * p[0] + 0.34 * p[1]))
    if pattern == mat.SLABS:
        return 0.86 if (p[0] % 1.2 < 0.12 or p[1] % 1.2 < 0.12) else 1.04
    if pattern == mat.TILES:
        return 1 + 0.12 * np.sin(12.0 * p[2]) * (1 if n[2] > 0.2 else 0)
    if pattern == mat.WINDOWS and abs(n[2]) < 0.3:
        along = (p[0] * -n[1] + p[1] * n[0]) % 2.6
        up = (p[2] - base) % 2.9
        if p[2] > base + 0.3 and 0.8 < along < 1.9 and 0.95 < up < 2.3:
            return 0.28
    return 1.0


@numba.njit(cache=True, nogil=True)
def shade(hit, pixels, origin, points, normals, material, tint, base, albedo, strength, size,
          patterns, sun, shadow, color):
    """Write the linear colour of every pixel that was hit: sun, sky, shadow, texture, haze."""
    axes, reach = shadow
    sun_color = np.array([1.90, 1.76, 1.50])
    sky_color = np.array([0.42, 0.52, 0.70])
    haze_color = np.array([0.56, 0.66, 0.78])
    n = np.empty(3, np.float32)
    for i in range(len(pixels)):
        m = material[i]
        if m == 255:
            continue
        p, face, pattern = points[pixels[i]], hit[i], patterns[m]
        fine = noise(p[0] / size[m], p[1] / size[m], p[2] / size[m])
        finer = noise(p[0] * 4 / size[m], p[1] * 4 / size[m], p[2] * 4 / size[m])
        broad = noise(p[0] / 13.0 + 7, p[1] / 13.0, p[2] / 13.0)
        for j in range(3):
            n[j] = normals[i, j]
        if pattern == mat.FOLIAGE:          # leaves look every way
            n[0] += 0.5 * fine + 0.35 * finer
            n[1] += 0.5 * finer - 0.35 * fine
        elif pattern == mat.RIPPLES:
            n[0] += 0.035 * finer
            n[1] += 0.035 * fine
        inverse = 1 / np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        n *= np.float32(inverse)
        view = np.array([origin[0] - p[0], origin[1] - p[1], origin[2] - p[2]])
        distance = np.sqrt(view[0] ** 2 + view[1] ** 2 + view[2] ** 2)
        view /= distance
        toward = max(0.0, n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2])
        lit = sunlit(p, sun, axes, reach) if toward > 0 else np.float32(0.0)
        gain = (1 + strength[m] * (0.42 * fine + 0.36 * finer + 0.30 * broad))
        gain *= pattern_gain(pattern, p, n, base[face])
        facing = max(0.02, n[0] * view[0] + n[1] * view[1] + n[2] * view[2])
        glint, mirror = 0.0, 0.0
        if pattern == mat.RIPPLES or pattern == mat.GLOSS:
            mirror = 0.04 + 0.5 * (1 - facing) ** 5
            half = sun + view.astype(np.float32)
            half /= np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
            glint = 0.8 * lit * max(0.0, n[0] * half[0] + n[1] * half[1] + n[2] * half[2]) ** 90
        haze = 1 - np.exp(-distance / 1400)
        for j in range(3):
            surface = (albedo[m, j] * tint[face, j]) ** 2 * max(gain, 0.15) ** 2
            light = sun_color[j] * toward * lit + sky_color[j] * (0.62 + 0.38 * n[2])
            value = surface * light * (1 - mirror) + mirror * haze_color[j] * 1.3 + glint
            color[pixels[i], j] = value * (1 - haze) + haze * haze_color[j]


@numba.njit(cache=True, nogil=True)
def _sky(rays, color):
    """Write the colour of the sky for every ray."""
    for i in range(len(rays)):
        up = rays[i, 2] / np.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
        t = min(max(up * 2.0, 0.0), 1.0)
        color[i, 0], color[i, 1] = 0.62 - 0.45 * t, 0.72 - 0.35 * t
        color[i, 2] = 0.84 - 0.15 * t
