"""What a depth image can see of the map: blocks in view, and pixels of distorted cameras."""

from __future__ import annotations

import functools
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.pools import SIDE

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Camera, Frame

MANY = 20_000           # blocks in view, from which on it pays to look how far the depth reaches
WIDEST = 1 << 20        # and from which on only those are looked at that the store has
FARTHEST = (1 << 28) - 2        # block index, so that voxels are int32
DISTORTED = 0.01        # pixels from which on rays are not those of a pinhole
ROUNDS = 20             # of finding the pixel of a distorted ray; each leaves a tenth or less
NO_WARP = np.empty((0, 0, 2))


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
