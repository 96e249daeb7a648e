"""The content of tiles, made from blocks of a map file when they are asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.tiles.cells import EDGE, points_of, seen_most
from persem_ros.outputs.tiles.octree import Octree, Tile, WITHIN

if TYPE_CHECKING:
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.outputs.export.source import MapSource

SHOWN = ('label', 'confidence', 'observations', 'source', 'gone', 'last_stamp')
AT_ONCE = 1024              # blocks that are read together
# What is kept of a block: the voxel that stands for it. known: read; empty: none was chosen.
BLOCK = np.dtype([('label', 'u2'), ('confidence', 'f4'), ('observations', 'u4'), ('source', 'u1'),
                  ('gone', 'u1'), ('last_stamp', 'i8'), ('known', '?'), ('empty', '?')])


class Pyramid:
    """
    The tiles of a map: 20 bytes a block are kept, and nothing of its voxels.

    Tiles whose cells are smaller than a block are made from all voxels of their blocks. Of larger
    cells one block is read, the middle one along the curve, so that a view from afar reads
    no more of a large map than of a small one.

    Parameters
    ----------
    source : MapSource
    octree : Octree
        Over all or some of its blocks.
    choice : Choice, optional
        Which voxels; all by default, those that are gone included.

    Attributes
    ----------
    anchor : ndarray, shape (3,), int64
        The voxel from whose corner the tiles' coordinates are counted.

    """

    def __init__(self, source: MapSource, octree: Octree, choice: Choice | None = None) -> None:
        self.source, self.choice = source, choice or Choice(gone=True)
        self.octree = octree
        self.anchor = np.array(octree.root.corner, np.int64) * SIDE
        self.start = int(source.stamps.min()) if len(source.stamps) else 0
        self._blocks = np.zeros(len(octree.index), BLOCK)

    def points(self, tile: Tile) -> NDArray[np.void]:
        """Return the points of a tile, POINT; none where no voxel is chosen."""
        at, columns = self._of_blocks(tile) if tile.level >= WITHIN else self._of_voxels(tile)
        return points_of(at, columns, self._beside(tile), self.source.legend, self.start)

    def size(self, tile: Tile) -> float:
        """Return the edge of a tile's cells, metres."""
        return self.source.voxel_size * (1 << tile.level)

    def corner(self, tile: Tile) -> NDArray[np.float64]:
        """Return a tile's least corner, metres from the anchor."""
        voxel = np.array(tile.corner, np.int64) * SIDE - self.anchor
        return np.asarray(voxel * self.source.voxel_size, np.float64)

    def changed(self, octree: Octree, index: NDArray[np.int32]) -> None:
        """Go on with another octree; read the blocks *index* (n, 3) anew when they are needed."""
        blocks = np.zeros(len(octree.index), BLOCK)
        place = octree.find(self.octree.index)
        blocks[place[place >= 0]] = self._blocks[place >= 0]
        place = octree.find(index)
        blocks['known'][place[place >= 0]] = False
        self.octree, self._blocks = octree, blocks

    def _of_voxels(self, tile: Tile) -> tuple[NDArray[np.int64], Columns]:
        """Return the cells of a tile of a small one, and the voxel in each."""
        parts = []
        for first in range(tile.first, tile.last, AT_ONCE):
            columns = self.source.blocks(
                self.octree.index[first:min(first + AT_ONCE, tile.last)], self.choice)
            at = (columns['voxel'] - np.array(tile.corner, np.int64) * SIDE) >> tile.level
            # Cells are no larger than blocks, so none has voxels of two parts.
            row = seen_most(columns, (at[:, 0] * EDGE + at[:, 1]) * EDGE + at[:, 2])
            parts.append((at[row], *(columns[name][row] for name in SHOWN)))
        at, *shown = (np.concatenate(column) for column in zip(*parts))
        return at, dict(zip(SHOWN, shown))

    def _beside(self, tile: Tile) -> NDArray[np.int64]:
        """Return the cells of other tiles that touch a tile, one coordinate -1 or EDGE."""
        parts = [np.zeros((0, 3), np.int64)]
        for axis in range(3):
            for beyond in (-1, tile.side):
                corner = list(tile.corner)
                corner[axis] += tile.side if beyond > 0 else -tile.side
                other = self.octree.tile(tile.level, (corner[0], corner[1], corner[2]))
                if other is None:
                    continue
                blocks = self.octree.index[other.first:other.last].astype(np.int64)
                cells = max(1, 1 << tile.level >> WITHIN)       # blocks along a cell's edge
                at = blocks[:, axis] - tile.corner[axis]
                near = blocks[at // cells == beyond // cells]
                if not len(near):
                    continue
                if tile.level < WITHIN:
                    columns = self.source.blocks(near.astype(np.int32), self.choice)
                    near = columns['voxel'][columns['gone'] == 0].astype(np.int64)
                    parts.append(near - np.array(tile.corner, np.int64) * SIDE >> tile.level)
                else:
                    parts.append((near - tile.corner) // cells)
        found = np.concatenate(parts)
        return found[((found >= -1) & (found <= EDGE)).all(axis=1)]

    def _of_blocks(self, tile: Tile) -> tuple[NDArray[np.int64], Columns]:
        """Return the cells of a tile of a large one, and the block in the middle of each."""
        place = self.octree.middles(tile)
        self._read(place[~self._blocks['known'][place]])
        place = place[~self._blocks['empty'][place]]
        at = (self.octree.index[place].astype(np.int64) - tile.corner) >> tile.level - WITHIN
        return at, {name: self._blocks[name][place] for name in SHOWN}

    def _read(self, place: NDArray[np.int64]) -> None:
        """Enter what stands for blocks."""
        for first in range(0, len(place), AT_ONCE):
            wanted = place[first:first + AT_ONCE]
            columns = self.source.blocks(self.octree.index[wanted], self.choice)
            owner = self.octree.find(columns['voxel'] // SIDE)
            row = seen_most(columns, owner)
            entries = np.zeros(len(wanted), BLOCK)
            entries['known'] = entries['empty'] = True
            self._blocks[wanted] = entries
            for name in SHOWN:
                self._blocks[name][owner[row]] = columns[name][row]
            self._blocks['empty'][owner[row]] = False
