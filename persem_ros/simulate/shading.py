"""Light and colour: sun, shadow, sky, texture, haze."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.simulate import materials as mat

if TYPE_CHECKING:
    from persem_ros.simulate.world import Scene

SUN = np.array([-0.46, -0.52, 0.72]) / np.linalg.norm([-0.46, -0.52, 0.72])
SHADOW_CELL = 0.35      # metres, of the shadow map
SHADOW_HALF = 180.0     # metres, half of the shadow map's edge


def shadow_map(scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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


@cached
def hashed(i, j, k):
    """Return a number in -1 .. 1 that depends on three integers, float32."""
    h = np.uint32(i) * np.uint32(374761393) + np.uint32(j) * np.uint32(668265263)
    h += np.uint32(k) * np.uint32(2147483647)
    h = (h ^ (h >> np.uint32(13))) * np.uint32(1274126177)
    return np.float32((h ^ (h >> np.uint32(16))) & np.uint32(0xffff)) / np.float32(32767.5) - 1


@cached
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


@cached
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


@cached
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


@cached
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


@cached
def sky(rays, color):
    """Write the colour of the sky for every ray."""
    for i in range(len(rays)):
        up = rays[i, 2] / np.sqrt(rays[i, 0] ** 2 + rays[i, 1] ** 2 + rays[i, 2] ** 2)
        t = min(max(up * 2.0, 0.0), 1.0)
        color[i, 0], color[i, 1] = 0.62 - 0.45 * t, 0.72 - 0.35 * t
        color[i, 2] = 0.84 - 0.15 * t


@cached
def to_bytes(linear, shown):
    """Write linear intensities as display values 0 .. 255, gamma 2."""
    for i in range(len(linear)):
        shown[i] = np.uint8(min(255.0, 255.0 * np.sqrt(max(linear[i], 0.0))))
