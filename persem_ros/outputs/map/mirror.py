"""The map as its viewers know it: points encoded once, and what they were not told yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.memory.changes import Changed
from persem_ros.core.memory.pools import ranges, SIDE, sparse_zeros
from persem_ros.core.memory.voxel_table import sort_order
from persem_ros.outputs.map.cloud import map_points, POINT
from persem_ros.settings.config import Map
from persem_ros.settings.legend import Legend

COMPARED = ('label', 'observations', 'source')
# A voxel's row; 'point' as bytes, with the gaps between its fields.
ROW = np.dtype([('point', np.void, POINT.itemsize), ('voxel', 'i4', 3), ('untold', '?')])
BLOCK = np.dtype([('index', 'i4', 3), ('start', 'i8'), ('count', 'i8'), ('untold', '?')])
SPARE = 1 << 16         # rows out of use that are not worth tidying up


class Mirror:
    """
    The points of a map, block by block, kept up to date by what changed.

    Parameters
    ----------
    voxel_size : float
        Metres.
    legend : Legend
        Gives labels their colours.

    Attributes
    ----------
    complete : bool
        Whether it has seen all that changed.

    """

    def __init__(self, voxel_size: float, legend: Legend) -> None:
        self._voxel_size, self._legend = voxel_size, legend
        self.complete = False
        self._lost: list[NDArray[np.int32]] = []    # voxels that are not there any more
        self._clear()

    def __len__(self) -> int:
        return int(self._blocks['count'].sum())

    @property
    def waiting(self) -> bool:
        """Whether difference() has left something for the next time."""
        return bool(self._blocks['untold'].any())

    def update(self, changed: Changed) -> None:
        """Take in what changed; the cost grows with that."""
        self.complete = changed.complete
        if changed.anew:
            self._lost.append(self._rows['voxel'][self._live(self._all())].copy())
            self._clear()
        self._remove(changed.left)
        self._lost.append(self._remove(changed.forgotten)['voxel'])
        old = self._remove(changed.index)
        fresh = np.zeros(int(changed.counts.sum()), ROW)
        fresh['voxel'] = changed.columns['voxel']
        points = map_points(changed.columns, self._voxel_size, self._legend)
        fresh['point'] = points.view(ROW['point'])
        place, there = matched(fresh['voxel'], old['voxel'])
        was = points_of(old[place[there]])
        fresh['untold'] = True
        fresh['untold'][there] = old['untold'][place[there]] | np.logical_or.reduce(
            [points[name][there] != was[name] for name in COMPARED])
        gone = np.ones(len(old), bool)
        gone[place[there]] = False
        self._lost.append(old['voxel'][gone])
        self._append(changed.index, changed.counts, fresh)

    def tell_all(self) -> None:
        """Take every voxel for one that was not told yet: somebody else listens now."""
        self._rows['untold'][:self._n] = True
        self._blocks['untold'] = self._blocks['count'] > 0

    def told(self) -> None:
        """Forget what differs: nobody wants to be told."""
        self._rows['untold'][:self._n] = False
        self._blocks['untold'] = False
        self._lost = []

    def difference(self, centre: ArrayLike, most: int) -> NDArray[np.void]:
        """
        Return the points that were not told yet, and forget them.

        Where there are more than *most*, the blocks nearest to *centre* (metres, map.origin taken
        off) go, of the last one more than asked for, and the others wait.

        Returns
        -------
        ndarray, shape (m,), POINT
            Voxels that are gone come first; their observations are 0.

        """
        blocks = np.flatnonzero(self._blocks['untold'])
        rows = self._live(blocks)
        rows = rows[self._rows['untold'][rows]]
        if len(rows) > most:
            blocks = blocks[np.argsort(self._away(blocks, centre), kind='stable')]
            rows = self._live(blocks)
            untold = self._rows['untold'][rows]
            before = np.cumsum(untold)      # of a block's last row: how many up to its end
            ends = np.cumsum(self._blocks['count'][blocks])
            n = int(np.searchsorted(before[ends - 1], most)) + 1
            blocks, rows = blocks[:n], rows[:ends[n - 1]][untold[:ends[n - 1]]]
        self._blocks['untold'][blocks] = False
        self._rows['untold'][rows] = False
        told = self._rows[rows]
        told = told[sort_order(told['voxel'])]
        lost = np.concatenate([np.zeros((0, 3), np.int32), *self._lost])
        lost = lost[~matched(lost, told['voxel'])[1]]       # what came back is told as changed
        self._lost = []
        points = np.zeros(len(lost) + len(told), POINT)
        for axis, name in enumerate('xyz'):
            points[name][:len(lost)] = (lost[:, axis] + 0.5) * self._voxel_size
        points[len(lost):].view(ROW['point'])[:] = told['point']
        return points

    def shown(self, centre: ArrayLike, settings: Map) -> NDArray[np.void]:
        """Return the points of ~/map, sorted by voxel index (*centre* as in difference())."""
        blocks, near = self._all(), settings.show == 'nearest'
        away = self._away(blocks, centre)
        reach = SIDE * self._voxel_size * 3 ** 0.5 / 2      # from a block's centre to its corner
        if settings.crop > 0:
            blocks = blocks[away <= settings.crop + reach]
            away = self._away(blocks, centre)
        rows = self._live(blocks)
        enough = points_of(self._rows[rows])['observations'] >= max(1, settings.min_observations)
        if near and 0 < settings.max_voxels < np.count_nonzero(enough):
            # Blocks as far away as the one in which the bound is reached, and a little farther.
            counts = np.add.reduceat(enough, np.cumsum(self._blocks['count'][blocks]) -
                                     self._blocks['count'][blocks])
            order = np.argsort(away)
            last = away[order[np.searchsorted(np.cumsum(counts[order]), settings.max_voxels)]]
            blocks = blocks[away <= last + 2 * reach]
            rows = self._live(blocks)
            enough = points_of(self._rows[rows])['observations'] >= settings.min_observations
        found = self._rows[rows[enough]]
        found = found[sort_order(found['voxel'])]
        offset = (found['voxel'] + 0.5) * self._voxel_size - np.asarray(centre)
        away = np.einsum('ij,ij->i', offset, offset)
        if settings.crop > 0:
            found, away = found[away <= settings.crop ** 2], away[away <= settings.crop ** 2]
        if 0 < settings.max_voxels < len(found):
            rank = away if near else -points_of(found)['observations'].astype(np.int64)
            found = found[np.sort(np.argsort(rank, kind='stable')[:settings.max_voxels])]
        return points_of(found)

    def recolour(self, legend: Legend) -> None:
        """Give the points the colours of another legend; they count as not told."""
        if legend is self._legend:
            return
        self._legend = legend
        points = points_of(self._rows[:self._n])
        rgb = legend.colors(points['label']).astype(np.uint32)
        points['rgb'] = (rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]).view(np.float32)
        self._rows['point'][:self._n] = points.view(ROW['point'])
        self.tell_all()

    def _clear(self) -> None:
        """Forget all points."""
        self._rows, self._n = sparse_zeros(0, ROW), 0
        self._blocks = np.zeros(0, BLOCK)
        self._slot: dict[tuple[int, ...], int] = {}     # index -> place in _blocks
        self._free: list[int] = []

    def _all(self) -> NDArray[np.int64]:
        """Return the places of all blocks."""
        return np.flatnonzero(self._blocks['count'])

    def _live(self, blocks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the rows of some blocks, one block after the other."""
        return ranges(self._blocks['start'][blocks], self._blocks['count'][blocks])

    def _away(self, blocks: NDArray[np.int64], centre: ArrayLike) -> NDArray[np.float64]:
        """Return how far the centres of blocks are from a point, metres."""
        middle = (self._blocks['index'][blocks] + 0.5) * (SIDE * self._voxel_size)
        away: NDArray[np.float64] = np.linalg.norm(middle - np.asarray(centre), axis=1)
        return away

    def _remove(self, index: NDArray[np.int32]) -> NDArray[np.void]:
        """Take blocks out, those that are there; return copies of their rows."""
        slots = [self._slot.pop(key, -1) for key in map(tuple, index.tolist())]
        blocks = np.array([slot for slot in slots if slot >= 0], np.int64)
        rows: NDArray[np.void] = self._rows[self._live(blocks)]
        self._blocks[blocks] = np.zeros(1, BLOCK)
        self._free += blocks.tolist()
        return rows

    def _append(self, index: NDArray[np.int32], counts: NDArray[np.int64],
                rows: NDArray[np.void]) -> None:
        """Enter blocks that are not there."""
        missing = len(index) - len(self._free)
        if missing > 0:
            n = len(self._blocks)
            more = max(missing, n)
            self._blocks = np.concatenate([self._blocks, np.zeros(more, BLOCK)])
            self._free += range(n + more - 1, n - 1, -1)
        slots = np.array([self._free.pop() for _ in range(len(index))], np.int64)
        self._slot.update(zip(map(tuple, index.tolist()), slots.tolist()))
        if self._n + len(rows) > len(self._rows):
            self._tidy(len(rows))
        ends = np.cumsum(counts)
        self._blocks['index'][slots], self._blocks['count'][slots] = index, counts
        self._blocks['start'][slots] = self._n + ends - counts
        self._rows[self._n:self._n + len(rows)] = rows
        self._n += len(rows)
        untold = np.concatenate([[0], np.cumsum(rows['untold'])])
        self._blocks['untold'][slots] = untold[ends] > untold[ends - counts]

    def _tidy(self, more: int) -> None:
        """Leave out the rows that are out of use, and make room for *more*."""
        blocks = self._all()
        rows = self._rows[self._live(blocks)]
        counts = self._blocks['count'][blocks]
        self._blocks['start'][blocks] = np.cumsum(counts) - counts
        self._n = len(rows)
        self._rows = sparse_zeros(2 * (len(rows) + more) + SPARE, ROW)
        self._rows[:self._n] = rows


def points_of(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Return the points of rows, POINT."""
    return np.ascontiguousarray(rows['point']).view(POINT)


def matched(voxels: NDArray[np.int32], others: NDArray[np.int32],
            ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the place of each voxel (n, 3) among *others* (m, 3), and whether it is there."""
    if not len(voxels) or not len(others):
        return np.zeros(len(voxels), np.int64), np.zeros(len(voxels), bool)
    keys = _keys(np.concatenate([others, voxels]))
    theirs, mine = keys[:len(others)], keys[len(others):]
    order = np.argsort(theirs, kind='stable')
    place = order[np.searchsorted(theirs, mine, sorter=order).clip(0, len(others) - 1)]
    return place, theirs[place] == mine


def _keys(voxels: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return a number for each of some voxels, the same for the same."""
    low = voxels.min(axis=0).astype(np.int64)
    span = voxels.max(axis=0).astype(np.int64) - low + 1
    if float(span[0]) * float(span[1]) * float(span[2]) < 2.0 ** 62:
        x, y, z = (voxels - low).T
        return (x * span[1] + y) * span[2] + z
    return np.unique(voxels, axis=0, return_inverse=True)[1].reshape(-1)
