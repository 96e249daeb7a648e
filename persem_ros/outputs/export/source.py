"""A map file as a stream of voxels: a few blocks at a time, whatever the size of the map."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.guard.database import checked, held_by
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.export.columns import Columns, decoded, kept
from persem_ros.outputs.map import schema1
from persem_ros.outputs.map.checks import FARTHEST_BLOCK
from persem_ros.outputs.map.loading import reading
from persem_ros.outputs.map.rows import about_of, matrices
from persem_ros.outputs.map.tables import KINDS, ORDER
from persem_ros.outputs.progress import progress
from persem_ros.settings import config_file
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

BLOCKS = 256            # read at a time


@dataclass
class Summary:
    """What chosen voxels have in common: counts, extent, labels."""

    voxels: int = 0
    of: int = 0             # voxels of the map
    most_observed: int = 0
    low: Any = None         # ndarray (3,), int64: indices of voxels, inclusive; None: no voxel
    high: Any = None
    labels: dict[int, int] = field(default_factory=dict)   # label -> number of voxels


class MapSource:
    """
    A map file, of which nothing but its small tables is held in memory.

    Parameters
    ----------
    path : str or Path
    legend : persem_ros.settings.legend.Legend, optional
        In place of the file's own.

    Attributes
    ----------
    path : Path
    voxel_size : float
        Metres.
    origin : ndarray, shape (3,), float64
        Metres in the map frame.
    map_frame : str
    config : persem_ros.settings.config.Config
        In force when the map was saved.
    legend : persem_ros.settings.legend.Legend
        In force.
    own_legend : persem_ros.settings.legend.Legend or None
        The file's.
    n_voxels, n_blocks : int
    stamps : ndarray, shape (f,), int64
        Nanoseconds, by row of the frame table.
    positions : ndarray, shape (f, 3), float64
        The sensor's, metres in the map frame, the best known.
    lines : list of (int, str), f of them
        Session and sensor.
    seen : list of int
        The ids that were ever observed.

    Raises
    ------
    PersemError
        For a file that is missing, foreign, of another schema, or damaged.

    """

    def __init__(self, path: Path | str, legend: Legend | None = None) -> None:
        self.path = Path(path)
        with reading(self.path) as (db, self._first):
            kinds: dict[str, Any] = dict(schema1.KINDS if self._first else KINDS)
            small = {table: list(checked(
                db.execute(f'SELECT * FROM {table} ORDER BY {ORDER[table]}'), kinds[table],
                held_by(self.path))) for table in ORDER if table in kinds and
                table != 'blocks'}
            about = about_of(small)
            self.stamps = np.array([row[4] for row in small['frames']], np.int64)
            best = [row[6] if len(row) > 6 and row[6] is not None else row[5]
                    for row in small['frames']]
            self.positions = matrices(best)[:, :3, 3]
            self._t = np.array([row[1] for row in small['frames']], np.int32)
            self.lines = [(row[2], row[3]) for row in small['frames']]
            self.seen = [row[0] for row in small['classes'] if row[3]]
        self.voxel_size = float(about['voxel_size'])
        self.origin = np.array(struct.unpack('<3d', about['origin']))
        self.map_frame = str(about['map_frame'])
        self.n_voxels, self.n_blocks = int(about['voxels']), int(about['blocks'])
        self.config: Config = config_file.from_text(
            about['settings'], f'settings in {self.path}') or Config()
        own = Legend.from_yaml(about['legend'], str(self.path)) if about['legend'] else None
        self.own_legend, self.legend = own, legend or own or Legend()

    def chunks(self, choice: Choice | None = None,
               blocks: int = BLOCKS) -> Generator[Columns, None, None]:
        """
        Yield the chosen voxels' columns, sorted by block, *blocks* blocks at a time.

        A column of blocks along z is never cut in two.

        Yields
        ------
        dict
            voxel (n, 3) int32; label, majority (n,) uint16; confidence (n,) float32 (of the
            label); observations, switches (n,) uint32; source, gone (n,) uint8; first_stamp,
            last_stamp (n,) int64 ns, of the observations that are kept; start (n + 1,) int64,
            classes (m,) uint16 and probabilities (m,) float32: voxel v saw
            classes[start[v]:start[v + 1]] with these shares of its evidence.

        """
        choice = choice or Choice()
        with reading(self.path) as (db, first):
            kinds: Any = (schema1.KINDS if first else KINDS)['blocks']
            rows: list[Any] = []
            before: Any = ()
            for row in checked(db.execute('SELECT * FROM blocks ORDER BY x, y, z'), kinds,
                               held_by(self.path)):
                if row[:3] <= before:
                    raise ValueError('a block twice')
                before = row[:3]
                if len(rows) >= blocks and row[:2] != rows[-1][:2]:
                    yield self._chosen(decoded(rows, first), choice)
                    rows = []
                rows.append(row)
            if rows:
                yield self._chosen(decoded(rows, first), choice)

    def index(self, since: int = 0) -> tuple[NDArray[np.int32], int]:
        """
        Return the places of blocks and a mark of this moment.

        Parameters
        ----------
        since : int
            An earlier mark: only blocks that were written after it. A mark that is less than the
            one handed in means another file: all blocks are new.

        Returns
        -------
        index : ndarray, shape (n, 3), int32
        mark : int

        """
        with reading(self.path) as (db, _):
            # Whoever writes a block anew gives it the next row, or the last one once more.
            mark = int(db.execute('SELECT coalesce(max(rowid), 0) FROM blocks').fetchone()[0])
            rows = db.execute('SELECT x, y, z FROM blocks WHERE rowid >= ?', (since,)).fetchall() \
                if since else db.execute('SELECT x, y, z FROM blocks').fetchall()
            if not all(type(x) is int and abs(x) <= FARTHEST_BLOCK for row in rows for x in row):
                raise ValueError('place of a block')
        return np.array(rows, np.int32).reshape(-1, 3), mark

    def blocks(self, index: NDArray[np.int32], choice: Choice | None = None) -> Columns:
        """Return the chosen voxels of some blocks, as chunks() does, in the order of *index*."""
        with reading(self.path) as (db, first):
            self._catch_up(db)
            found = (row for key in index.tolist() for row in db.execute(
                'SELECT * FROM blocks WHERE x = ? AND y = ? AND z = ?', key))
            kinds: Any = (schema1.KINDS if first else KINDS)['blocks']
            rows: list[Any] = list(checked(found, kinds, held_by(self.path)))
            return self._chosen(decoded(rows, first), choice or Choice())

    def _catch_up(self, db: Any) -> None:
        """Read the frames that a living map has had since it was opened."""
        if self._first or db.execute('SELECT coalesce(max(row), -1) FROM frames').fetchone()[0] \
                < len(self.stamps):
            return
        kinds: Any = KINDS['frames']
        rows = list(checked(db.execute(
            'SELECT * FROM frames WHERE row >= ? ORDER BY row', (len(self.stamps),)),
            kinds, held_by(self.path)))
        best = matrices([row[5] if row[6] is None else row[6] for row in rows])
        self.positions = np.concatenate([self.positions, best[:, :3, 3]])
        self._t = np.concatenate([self._t, np.array([row[1] for row in rows], np.int32)])
        self.lines = self.lines + [(row[2], row[3]) for row in rows]
        self.stamps = np.concatenate([self.stamps, np.array([row[4] for row in rows], np.int64)])

    def shown(self, choice: Choice, what: str) -> AbstractContextManager[Iterable[Columns]]:
        """Give chunks(choice) to be looped over, with a progress bar called *what*."""
        return progress(self.chunks(choice), what, -(-self.n_blocks // BLOCKS), 'parts')

    def summary(self, choice: Choice | None = None) -> Summary:
        """Return what the chosen voxels have in common; reads the whole file once."""
        result = Summary(of=self.n_voxels)
        for columns in self.chunks(choice):
            voxel = columns['voxel']
            if not len(voxel):
                continue
            low, high = voxel.min(axis=0).astype(np.int64), voxel.max(axis=0).astype(np.int64)
            result.low = low if result.low is None else np.minimum(result.low, low)
            result.high = high if result.high is None else np.maximum(result.high, high)
            result.voxels += len(voxel)
            result.most_observed = max(result.most_observed, int(columns['observations'].max()))
            for label, count in zip(*np.unique(columns['label'], return_counts=True)):
                result.labels[int(label)] = result.labels.get(int(label), 0) + int(count)
        return result

    def summary_of_something(self, choice: Choice) -> Summary:
        """Return summary(choice); refuse a choice of nothing in a sentence."""
        found = self.summary(choice)
        if found.voxels:
            return found
        whole = self.summary(Choice(gone=True))
        if whole.low is None or whole.high is None:
            raise PersemError(f'{self.path}: no voxel is left to export; the map is empty')
        corners = (_point(self.centres(corner[None])[0]) for corner in (whole.low, whole.high))
        raise PersemError(
            f'{self.path}: no voxel is left to export; the map reaches from '
            f'{" to ".join(corners)} m, with up to {whole.most_observed} observations a voxel and '
            f'the labels {", ".join(map(str, sorted(whole.labels)[:20]))}')

    def centres(self, voxel: NDArray[Any]) -> NDArray[np.float64]:
        """Return the middles of voxels, (n, 3), metres in the map frame."""
        return (voxel + 0.5) * self.voxel_size + self.origin

    def _chosen(self, columns: Columns, choice: Choice) -> Columns:
        """Return the columns of the chosen voxels, with the stamps of their observations."""
        for name in ('first', 'last'):
            place = columns.pop(f'{name}_seen')
            if self._first:
                place = np.searchsorted(self._t, place)
            columns[f'{name}_stamp'] = self.stamps[place]
        keep = columns['observations'] >= choice.min_observations
        if not choice.gone:
            keep &= columns['gone'] == 0
        if choice.labels:
            keep &= np.isin(columns['label'], list(choice.labels))
        if choice.crop:
            low, high = np.array(choice.crop[:3]), np.array(choice.crop[3:])
            centres = self.centres(columns['voxel'])
            keep &= ((centres >= low) & (centres <= high)).all(axis=1)
        return columns if keep.all() else kept(columns, keep)


def _point(xyz: NDArray[np.float64]) -> str:
    """Return three numbers as text."""
    return ' '.join(f'{x:.6g}' if abs(x) < 1e5 else f'{x:.2f}' for x in xyz)
