"""The grid of a map that grows: what changed is computed anew, and the ground around it."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import ground_of, TILE
from persem_ros.core.memory.pools import SIDE
from persem_ros.outputs.grid.cells import cell_size, Cells, cells_of, MOST_CELLS
from persem_ros.outputs.grid.rule import costs_of, lowest_of, Rule, UNKNOWN_CLASS, UNKNOWN_COST
from persem_ros.outputs.grid.tiles import Tiles

MARGIN = 64             # cells by which the rectangle grows, so that it rarely does


class Changed(Protocol):
    """What changed in a map: core.memory.changes.Changed."""

    index: NDArray[np.int32]
    counts: NDArray[np.int64]
    columns: dict[str, NDArray[Any]]
    forgotten: NDArray[np.int32]
    anew: bool


class TooLarge(ValueError):
    """The rectangle would have more than MOST_CELLS cells."""


class Layers:
    """
    Costs and classes of all cells, kept up to date by what changed.

    What an update costs grows with what changed and with the ground around it (2 grid.window
    columns), not with the map; a rectangle that grows is copied, and 16 bytes a tile.

    Parameters
    ----------
    rule : Rule
    voxel_size, resolution : float
        Metres.
    tie : str
        grid.tie.

    Attributes
    ----------
    cells : Cells
        All of them, its rectangle larger than what is known.

    """

    def __init__(self, rule: Rule, voxel_size: float, resolution: float, tie: str) -> None:
        self._rule, self._tie = rule, tie
        self._voxel_size, self._resolution = voxel_size, resolution
        self._clear()

    def _clear(self) -> None:
        """Know nothing."""
        self._blocks: dict[tuple[int, int], dict[int, tuple[Any, Any]]] = {}
        self._tiles = Tiles()
        size = cell_size(self._resolution, self._voxel_size)
        self.cells = Cells((0, 0), size, np.empty((0, 0), np.int8), np.empty((0, 0), np.uint16))

    def update(self, changed: Changed) -> tuple[tuple[int, int, int, int] | None, bool]:
        """
        Take in what changed.

        Returns
        -------
        box : tuple of 4 int or None
            x0, y0, x1, y1 of the cells of `cells` that may be others now, half-open.
        grown : bool
            The rectangle is another one: nothing that was told of it holds.

        """
        grown = changed.anew and bool(len(self._tiles))
        if changed.anew:
            self._clear()
        tiles = self._take(changed)
        if not len(tiles):
            return None, grown
        rows = self._tiles.rows(tiles)
        lowest = self._lowest_of(rows)
        lower = rows[(lowest != self._tiles.get('lowest', rows)).any(axis=1)]
        self._tiles.put('lowest', rows, lowest)
        rows = np.union1d(rows, self._ground(lower))
        self._price(rows)
        return self._draw(rows, grown)

    def _take(self, changed: Changed) -> NDArray[np.int32]:
        """Keep the voxels of the blocks that changed; return their tiles, unique."""
        columns = changed.columns
        good = columns['observations'] >= self._rule.min_observations
        ends = np.cumsum(changed.counts)
        for (x, y, z), end, n in zip(changed.index.tolist(), ends.tolist(),
                                     changed.counts.tolist()):
            rows = np.flatnonzero(good[end - n:end]) + end - n
            tower = self._blocks.setdefault((x, y), {})
            tower.pop(z, None)
            if len(rows):
                tower[z] = columns['voxel'][rows], columns['label'][rows]
        back = set(map(tuple, changed.index.tolist()))
        for x, y, z in changed.forgotten.tolist():
            if (x, y, z) not in back:
                self._blocks.get((x, y), {}).pop(z, None)
        touched = np.concatenate([changed.index[:, :2], changed.forgotten[:, :2]])
        return np.unique(touched.astype(np.int32), axis=0)

    def _voxels(self, rows: NDArray[np.int64]) -> tuple[Any, Any, Any]:
        """Return (voxels, labels, place among *rows* of each) of tiles."""
        parts = [(voxel, label, place) for place, (x, y) in enumerate(
                     self._tiles.get('tile', rows).tolist())
                 for voxel, label in self._blocks.get((x, y), {}).values()]
        if not parts:
            return np.empty((0, 3), np.int32), np.empty(0, np.uint16), np.empty(0, np.int64)
        return (np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]),
                np.repeat([p[2] for p in parts], [len(p[1]) for p in parts]))

    def _lowest_of(self, rows: NDArray[np.int64]) -> NDArray[np.int32]:
        voxel, _, place = self._voxels(rows)
        return lowest_of(voxel, place, len(rows))

    def _ground(self, lower: NDArray[np.int64]) -> NDArray[np.int64]:
        """Open the ground around tiles whose lowest voxels changed; return where it changed."""
        if not len(lower):
            return lower
        reach = -(-2 * self._rule.window // SIDE)
        tiles = self._tiles
        around = tiles.near(lower, reach)
        wide = tiles.near(around, reach)
        level = ground_of(tiles.get('tile', wide), tiles.get('lowest', wide),
                          self._rule.window).level[np.searchsorted(wide, around)]
        other = (level != tiles.get('level', around)).any(axis=1)
        tiles.put('level', around, level)
        return around[other]

    def _price(self, rows: NDArray[np.int64]) -> None:
        """Compute the costs and classes of tiles."""
        voxel, label, place = self._voxels(rows)
        cost, classes = costs_of(voxel, label, place, self._tiles.get('level', rows), self._rule)
        self._tiles.put('cost', rows, cost)
        self._tiles.put('label', rows, classes)

    def _draw(self, rows: NDArray[np.int64], grown: bool
              ) -> tuple[tuple[int, int, int, int], bool]:
        """Enter tiles into the rectangle of cells."""
        tiles = self._tiles
        drawn = tiles.get('tile', rows)
        low, high = (self._cell_of(corner) for corner in (
            drawn.min(axis=0) * SIDE, drawn.max(axis=0) * SIDE + SIDE - 1))
        grown |= self._reserve(low, high + 1)
        # A cell at the edge has columns of tiles around, which are as they were.
        wide = tiles.near(rows, 1 + int(self.cells.size / self._voxel_size) // SIDE) \
            if self.cells.size != self._voxel_size else rows
        part = cells_of(tiles.get('tile', wide), tiles.get('cost', wide),
                        tiles.get('label', wide), self._voxel_size, self._resolution, self._tie)
        corner = np.array(self.cells.corner)
        x0, y0 = (low - corner).tolist()
        x1, y1 = (high + 1 - corner).tolist()
        mask = self._touched(drawn, low, high)
        for name, blank in (('cost', UNKNOWN_COST), ('label', UNKNOWN_CLASS)):
            source = getattr(part, name)
            fresh = np.full(mask.shape, blank, source.dtype)
            # The part of the rectangle low .. high that *part* covers.
            a = np.maximum(low, part.corner)
            b = np.minimum(high + 1, np.array(part.corner) + source.shape[::-1])
            if (a < b).all():
                to, of = a - low, a - np.array(part.corner)
                n = b - a
                fresh[to[1]:to[1] + n[1], to[0]:to[0] + n[0]] = \
                    source[of[1]:of[1] + n[1], of[0]:of[0] + n[0]]
            target = getattr(self.cells, name)[y0:y1, x0:x1]
            target[mask] = fresh[mask]
        return (x0, y0, x1, y1), grown

    def _touched(self, tiles: NDArray[np.int32], low: NDArray[np.int64],
                 high: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which cells of low .. high have columns of the tiles."""
        mask = np.zeros((high - low + 1)[::-1], bool)
        place = np.arange(TILE)
        columns = (tiles.astype(np.int64)[:, None] * SIDE
                   + np.stack([place >> 3, place & 7], axis=1)).reshape(-1, 2)
        cells = self._cell_of(columns) - low
        mask[cells[:, 1], cells[:, 0]] = True
        return mask

    def _cell_of(self, column: NDArray[Any]) -> NDArray[np.int64]:
        """Return the cells (x, y) that columns (i, j) belong to."""
        if self.cells.size == self._voxel_size:
            return column.astype(np.int64)
        return np.floor((column + 0.5) * self._voxel_size / self.cells.size + 1e-9).astype(
            np.int64)

    def _reserve(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> bool:
        """Let the rectangle cover low .. high (exclusive); return whether it grew."""
        old = self.cells
        a, b = np.array(old.corner), np.array(old.corner) + old.cost.shape[::-1]
        if old.cost.size and (low >= a).all() and (high <= b).all():
            return False
        wide = low // MARGIN * MARGIN, -(-high // MARGIN) * MARGIN
        a, b = (np.minimum(a, wide[0]), np.maximum(b, wide[1])) if old.cost.size else wide
        if float(np.prod((b - a).astype(float))) > MOST_CELLS:
            raise TooLarge(f'{b[0] - a[0]} x {b[1] - a[1]} cells')
        cost = np.full((b - a)[::-1], UNKNOWN_COST, np.int8)
        label = np.full((b - a)[::-1], UNKNOWN_CLASS, np.uint16)
        if old.cost.size:
            x, y = np.array(old.corner) - a
            h, w = old.cost.shape
            cost[y:y + h, x:x + w], label[y:y + h, x:x + w] = old.cost, old.label
        self.cells = Cells((int(a[0]), int(a[1])), old.size, cost, label)
        return True
