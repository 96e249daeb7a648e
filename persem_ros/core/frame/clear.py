"""
Clearing what moved away: voxels through which later frames look (spec section 10, *Clearing*).

A thing that was mapped and drove off leaves voxels behind which everything is measured from then
on. Looks through a voxel since its last observation are counted, one a second; where they are
enough the voxel is gone: it is not shown and no neighbour, but keeps its history, and one new
observation makes it present again.

"""

from __future__ import annotations

import functools
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.append import mark
from persem_ros.core.memory.paging import block_numbers
from persem_ros.core.memory.pools import CLOCK, ROWS, SIDE

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Camera, Frame
    from persem_ros.settings.config import Memory

SLACK = 1e-9            # metres: what is nearer than this to a bound is not decided early
MANY = 20_000           # blocks in view, from which on it pays to look how far the depth reaches
WIDEST = 1 << 20        # and from which on only those are looked at that the store has
FARTHEST = (1 << 28) - 2        # block index, so that voxels are int32
DISTORTED = 0.01        # pixels from which on rays are not those of a pinhole
ROUNDS = 20             # of finding the pixel of a distorted ray; each leaves a tenth or less
NO_WARP = np.empty((0, 0, 2))


def clear(memory: VoxelMemory, frame: Frame, settings: Memory) -> int:
    """
    Count looks through voxels; return how many became gone. Call it after VoxelMemory.add().

    A voxel is seen through when its 8 corners project in front of the camera and into the depth
    image, at least half (and one) of the pixels of their bounding rectangle are measured (finite,
    min_depth or more), and all of these lie farther than the farthest corner's z by more than
    clear_margin voxels and clear_slope of that z. Labelled clouds have no such pixels.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map; with a pager, the blocks in view come into memory.
    frame : persem_ros.frames.Frame
        All its pixels count, whatever the stride.
    settings : persem_ros.settings.config.Memory
        clear_after (0: nothing is done), clear_margin, clear_slope, clear_range, min_depth.

    """
    if not settings.clear_after or frame.points is not None:
        return 0
    view = View(frame, memory, settings.clear_range)
    index = view.blocks()
    if memory.pager is not None:
        memory.pager.need(index)
    numbers = block_numbers(memory, index)
    numbers = numbers[numbers >= 0]
    margin = settings.clear_margin * memory.voxel_size
    limits = np.array([max(settings.min_depth, np.nextafter(0.0, 1.0)), settings.clear_range,
                       margin, settings.clear_slope])
    memory.some_passed = True
    memory.m.used[CLOCK] += 1
    went: list[Any] = split(
        look_through, len(numbers), memory.m.blocks, memory.m.voxels, memory.m.stamps,
        memory.store.passed, memory.store.beliefs, numbers, view.depth, warp_of(frame.camera),
        view.turn, view.shift, view.lens, limits, settings.clear_after,
        frame.stamp // 1_000_000_000, memory.clock, grain=64)
    memory.n_gone += sum(went)
    return int(sum(went))


class View:
    """
    What a depth image can see of a grid of voxels.

    Attributes
    ----------
    turn, shift : ndarray, shapes (3, 3) and (3,), float64
        turn @ (i, j, k) + shift is the corner of voxel (i, j, k) in the optical frame, metres.
    lens : ndarray, shape (4,), float64
        fx, fy, cx, cy, pixels.
    depth : ndarray, shape (h, w), float64

    """

    def __init__(self, frame: Frame, memory: VoxelMemory, far: float) -> None:
        R, t = frame.T_map_camera[:3, :3], frame.T_map_camera[:3, 3]
        K = frame.camera.K
        self._R, self._memory, self._far = R, memory, far
        self.turn = np.ascontiguousarray(R.T * memory.voxel_size)
        self.shift = R.T @ (np.array(memory.origin) - t)
        self.lens = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.float64)
        self.depth = np.require(frame.depth, np.float64, ['C', 'W'])

    def blocks(self) -> NDArray[np.int32]:
        """Return the indices (n, 3) of all blocks in view, and of a few beside."""
        low, high = self._box(self._far)
        if np.prod(high - low + 1.0) > MANY:
            depths: list[Any] = split(deepest, len(self.depth), self.depth, grain=64)
            low, high = self._box(min(self._far, max(depths, default=0.0)))
        here, volume = self._memory.n_blocks, np.prod(high - low + 1.0)
        if volume > (4 * here if self._memory.pager is None else WIDEST):
            blocks = self._memory.m.blocks[:here]
            index = blocks['index'][blocks['near'][:, 13] > 0]
            if self._memory.pager is not None:
                index = np.concatenate([index, self._memory.pager.backing.index()])
            inside = ((index >= low) & (index <= high)).all(axis=1)
            return np.ascontiguousarray(index[inside])
        out = np.empty((int(volume), 3), np.int32)
        return out[:list_view(low, high, self.turn, self.shift, self._edges(), self._far, out)]

    def _edges(self) -> NDArray[np.float64]:
        """Return the borders of the image, x/z at the left, right, y/z above and below."""
        (h, w), (fx, fy, cx, cy) = self.depth.shape, self.lens
        return np.array([(-0.5 - cx) / fx, (w - 0.5 - cx) / fx,
                         (-0.5 - cy) / fy, (h - 0.5 - cy) / fy])

    def _box(self, far: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lowest and highest indices (3,) of blocks that may be in view."""
        left, right, above, below = self._edges()
        corners = np.array([[0.0, 0.0, 0.0], *(
            [x * far, y * far, far] for x in (left, right) for y in (above, below))])
        places = (corners - self.shift) @ self._R.T / (self._memory.voxel_size * SIDE)
        low, high = (np.clip(np.floor(edge), -FARTHEST, FARTHEST).astype(np.int64)
                     for edge in (places.min(axis=0), places.max(axis=0)))
        return low, high


@functools.lru_cache(maxsize=16)
def warp_of(camera: Camera) -> NDArray[np.float64]:
    """
    Return where each pixel of a pinhole camera with the same K lies in a distorted image.

    Shape (h, w, 2), float64: u, v in pixels, NaN where the image does not show it; of size 0 for
    a camera whose rays are those of a pinhole.

    """
    (fx, fy, cx, cy), rays = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], camera.rays
    h, w = rays.shape[:2]
    u, v = np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float))
    wanted = np.stack([(u - cx) / fx, (v - cy) / fy], axis=-1)
    if min(h, w) < 2 or np.nanmax(np.abs(rays - wanted) * (fx, fy), initial=0.0) < DISTORTED:
        return NO_WARP
    place = np.stack([u, v], axis=-1)
    for _ in range(ROUNDS):
        missed = (wanted - _between(rays, place)) * (fx, fy)
        place = np.clip(place + missed, 0.0, (w - 1.0, h - 1.0))
    found = (np.abs(missed) < 0.1).all(axis=-1)
    return np.where(found[..., None], place, np.nan)


def _between(rays: NDArray[np.float64], place: NDArray[np.float64]) -> Any:
    """Return the rays of places (u, v) between pixels, bilinear."""
    h, w = rays.shape[:2]
    u0 = np.minimum(place[..., 0].astype(int), max(w - 2, 0))
    v0 = np.minimum(place[..., 1].astype(int), max(h - 2, 0))
    a, b = (place[..., 0] - u0)[..., None], (place[..., 1] - v0)[..., None]
    u1, v1 = np.minimum(u0 + 1, w - 1), np.minimum(v0 + 1, h - 1)
    return ((1 - a) * (1 - b) * rays[v0, u0] + a * (1 - b) * rays[v0, u1]
            + (1 - a) * b * rays[v1, u0] + a * b * rays[v1, u1])


@kernel
def deepest(begin, end, depth):
    """Return the largest finite depth of rows begin .. end, 0.0 where there is none."""
    most = 0.0
    for v in range(begin, end):
        for u in range(depth.shape[1]):
            d = depth[v, u]
            most = d if most < d < np.inf else most
    return most


@kernel
def list_view(low, high, turn, shift, edges, far, out):
    """Write the indices of the blocks of a box whose sphere reaches into view; return how many."""
    n, half = 0, SIDE / 2
    radius = np.sqrt(turn[0, 0] ** 2 + turn[1, 0] ** 2 + turn[2, 0] ** 2) * half * np.sqrt(3.0)
    wide = radius * np.sqrt(1.0 + edges * edges)
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            for k in range(low[2], high[2] + 1):
                a, b, c = SIDE * i + half, SIDE * j + half, SIDE * k + half
                z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + shift[2]
                if z < -radius or z - radius > far:
                    continue
                x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + shift[0]
                y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + shift[1]
                if x - edges[0] * z < -wide[0] or edges[1] * z - x < -wide[1] or \
                        y - edges[2] * z < -wide[2] or edges[3] * z - y < -wide[3]:
                    continue
                out[n, 0], out[n, 1], out[n, 2] = i, j, k
                n += 1
    return n


@kernel
def look_through(begin, end, blocks, voxels, stamps, passed, beliefs, numbers, depth, warp, turn,
                 shift, lens, limits, after, second, now):
    """Count the looks through the voxels of blocks numbers[begin:end]; return how many went."""
    least, far, margin, slope = limits
    fx, fy, cx, cy = lens
    ax, bx, kx, ay, by, ky = turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2]
    az, bz, kz = turn[2, 0], turn[2, 1], turn[2, 2]
    reach = 0.5 * (abs(az) + abs(bz) + abs(kz))
    behind, lead = reach + margin + slope * reach - SLACK, 1.0 + slope
    nearest, farthest = max(reach - SLACK, 0.0), far - reach + SLACK
    (h, w), went, warped = depth.shape, 0, len(warp) > 0
    for p in range(begin, end):
        b = numbers[p]
        cells, index = blocks[b].cells, blocks[b].index
        for row in range(ROWS):
            i = np.int64(index[0]) * SIDE + (row >> 3)
            j = np.int64(index[1]) * SIDE + (row & 7)
            k = np.int64(index[2]) * SIDE
            x0 = ax * (i + 0.5) + bx * (j + 0.5) + kx * (k + 0.5) + shift[0]
            y0 = ay * (i + 0.5) + by * (j + 0.5) + ky * (k + 0.5) + shift[1]
            z0 = az * (i + 0.5) + bz * (j + 0.5) + kz * (k + 0.5) + shift[2]
            for cell in range(SIDE):
                v = np.int64(cells[np.uint64(row * SIDE + cell)]) - 1
                if v < 0:
                    continue
                z = z0 + kz * cell
                if not nearest < z <= farthest:
                    continue
                # Most voxels are at the surface: their middle's own pixel says so.
                u, m = fx * (x0 + kx * cell) / z + cx, fy * (y0 + ky * cell) / z + cy
                if not (u >= -0.5 and m >= -0.5 and u < w - 0.5 and m < h - 0.5):
                    continue
                if not warped:
                    d = depth[np.uint64(m + 0.5), np.uint64(u + 0.5)]
                    if least <= d <= lead * z + behind:
                        continue
                if not seen_through(i, j, k + cell, depth, warp, turn, shift, lens, limits):
                    continue
                voxel, record = voxels[v], passed[v]
                if voxel.gone:
                    continue
                if record.n != voxel.n:
                    record.n = voxel.n
                    record.count = 0
                elif record.second == second:
                    continue
                record.second = second
                record.count += 1
                stamps[b].stored = now
                if record.count >= after and 10 * np.int64(record.count) >= np.int64(voxel.n):
                    voxel.gone = 1
                    voxel.label = voxel.majority
                    voxel.source = 0
                    beliefs[v].posterior = 0.0
                    mark(blocks[b], stamps[b], now, i, j, k + cell)
                    went += 1
    return went


@inlined
def seen_through(i, j, k, depth, warp, turn, shift, lens, limits):
    """Return whether all that is measured around voxel (i, j, k) lies behind it."""
    least, far, margin, slope = limits
    farthest = 0.0
    u0 = v0 = np.inf
    u1 = v1 = -np.inf
    for corner in range(8):
        a, b, c = i + (corner >> 2), j + (corner >> 1 & 1), k + (corner & 1)
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + shift[2]
        if not 0.0 < z <= far:
            return False
        x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + shift[0]
        y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + shift[1]
        inside, u, v = project(x, y, z, lens, warp, depth)
        if not inside:
            return False
        farthest = max(farthest, z)
        u0, u1 = min(u0, u), max(u1, u)
        v0, v1 = min(v0, v), max(v1, v)
    bound, measured, total = farthest + margin + slope * farthest, 0, 0
    for v in range(np.int64(v0 + 0.5), np.int64(v1 + 0.5) + 1):
        for u in range(np.int64(u0 + 0.5), np.int64(u1 + 0.5) + 1):
            total += 1
            d = depth[v, u]
            if d >= least and d < np.inf:
                if not d > bound:
                    return False
                measured += 1
    return measured > 0 and 2 * measured >= total


@inlined
def project(x, y, z, lens, warp, depth):
    """Return whether a point in front of the camera has a pixel, and its u and v."""
    u, v = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
    h, w = depth.shape
    inside = u >= -0.5 and v >= -0.5 and u < w - 0.5 and v < h - 0.5
    if inside and len(warp):
        at_u, at_v = min(max(np.int64(u), 0), w - 2), min(max(np.int64(v), 0), h - 2)
        a, b = u - at_u, v - at_v
        low, high = warp[at_v], warp[at_v + 1]
        p, q = low[at_u], low[at_u + 1]
        r, s = high[at_u], high[at_u + 1]
        u = (1 - a) * (1 - b) * p[0] + a * (1 - b) * q[0] + (1 - a) * b * r[0] + a * b * s[0]
        v = (1 - a) * (1 - b) * p[1] + a * (1 - b) * q[1] + (1 - a) * b * r[1] + a * b * s[1]
        inside = u >= -0.5 and v >= -0.5 and u < w - 0.5 and v < h - 0.5
    return inside, u, v
