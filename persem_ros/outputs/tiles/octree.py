"""Which tiles a map has: its blocks along a Morton curve, of which every tile is a stretch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError

LEAF = 3                # 2 ** LEAF blocks along the edge of the smallest tile
WITHIN = SIDE.bit_length() - 1      # from this level on a cell has one block or several
BITS = 21               # of a place on the curve, an axis
STEADY = 8              # the grid of tiles starts at a multiple of this share of the root's edge


@dataclass(frozen=True)
class Tile:
    """
    A cube of the map.

    Attributes
    ----------
    level : int
        2 ** level voxels along the edge of what it shows as one; 0: every voxel.
    corner : tuple of 3 int
        Its least block.
    first, last : int
        Its blocks are Octree.index[first:last].

    """

    level: int
    corner: tuple[int, int, int]
    first: int
    last: int

    @property
    def side(self) -> int:
        """Return how many blocks are along its edge."""
        return 1 << LEAF + self.level


class Octree:
    """
    The tiles over some blocks.

    Parameters
    ----------
    index : ndarray, shape (n, 3), int32
        The places of blocks, each once; n > 0.

    Attributes
    ----------
    index : ndarray, shape (n, 3), int32
        The same along the curve.
    order : ndarray, shape (n,), int64
        Where each of them was.
    root : Tile

    Raises
    ------
    PersemError
        Where the map is too wide for the curve.

    """

    def __init__(self, index: NDArray[np.int32]) -> None:
        low, high = index.min(axis=0).astype(np.int64), index.max(axis=0).astype(np.int64)
        level = _level(int((high - low).max()) + 1)
        step = max(1 << LEAF + level >> STEADY.bit_length() - 1, 1 << LEAF)
        self._low = low // step * step
        level = _level(int((high - self._low).max()) + 1)
        if LEAF + level > BITS:
            wide = int((high - low).max()) * SIDE
            raise PersemError(f'the map is {wide:,} voxels wide, more than {SIDE << BITS:,}; '
                              'persem map export --crop takes a part of it')
        codes = morton(index - self._low)
        self.order = np.argsort(codes, kind='stable')
        self.index, self._codes = index[self.order], codes[self.order]
        x, y, z = self._low.tolist()
        self.root = Tile(level, (x, y, z), 0, len(index))

    def tile(self, level: int, corner: tuple[int, int, int]) -> Tile | None:
        """Return the tile of a level at a block, None where there is nothing."""
        side = 1 << LEAF + level
        away = np.array(corner, np.int64) - self._low
        if not 0 <= level <= self.root.level or (away < 0).any() or (away % side).any() or \
                (away >= self.root.side).any():
            return None
        return self._between(level, int(morton(away[None])[0]))

    def children(self, tile: Tile) -> Iterator[Tile]:
        """Yield what a tile is divided into; nothing for the smallest ones."""
        if tile.level == 0:
            return
        code, bits = int(morton(np.array(tile.corner)[None] - self._low)[0]), LEAF + tile.level - 1
        for k in range(8):
            child = self._between(tile.level - 1, code + (k << 3 * bits))
            if child is not None:
                yield child

    def reach(self, tile: Tile) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the least and the greatest of a tile's blocks, (3,) each."""
        blocks = self.index[tile.first:tile.last]
        return blocks.min(axis=0), blocks.max(axis=0)

    def middles(self, tile: Tile) -> NDArray[np.int64]:
        """Return, for each cell of a tile of level WITHIN or more, the block in its middle."""
        cells = self._codes[tile.first:tile.last] >> 3 * (tile.level - WITHIN)
        first = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
        last = np.append(first[1:], len(cells)) - 1
        return tile.first + (first + last + 1) // 2

    def find(self, index: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return where blocks are, -1 for those that are not there."""
        away = index.astype(np.int64) - self._low
        within = ((away >= 0) & (away < self.root.side)).all(axis=1)
        codes = morton(np.where(within[:, None], away, 0))
        place = np.searchsorted(self._codes, codes).clip(max=len(self._codes) - 1)
        return np.where(within & (self._codes[place] == codes), place, -1)

    def _between(self, level: int, code: int) -> Tile | None:
        """Return the tile whose first place on the curve is *code*, None for an empty one."""
        first, last = np.searchsorted(self._codes, [code, code + (1 << 3 * (LEAF + level))])
        if first == last:
            return None
        side = 1 << LEAF + level
        corner = (self.index[first] - self._low) // side * side + self._low
        return Tile(level, tuple(corner.tolist()), int(first), int(last))


def morton(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places (n, 3), 0 <= x < 2 ** 21, along the Morton curve."""
    code = np.zeros(len(places), np.int64)
    for axis in range(3):
        x = places[:, axis].astype(np.int64)
        for shift, mask in ((32, 0x1f00000000ffff), (16, 0x1f0000ff0000ff),
                            (8, 0x100f00f00f00f00f), (4, 0x10c30c30c30c30c3),
                            (2, 0x1249249249249249)):
            x = (x | x << shift) & mask
        code |= x << 2 - axis
    return code


def _level(blocks: int) -> int:
    """Return the level of the smallest tile that is so many blocks wide."""
    return max(0, (blocks - 1).bit_length() - LEAF)
