"""
The map of a replay of which memory holds a part (spec section 9).

The session goes to a copy of the map's file in the folder of the run, which is handed over when
all is done: map.path is as it was until then.

"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import shutil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.memory.capture import Capture
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.paging import Pager
from persem_ros.core.memory.voxel_table import ordered, sort_order
from persem_ros.errors import PersemError
from persem_ros.guard.database import checked, held_by
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.export.columns import Columns
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.outputs.map.cloud import map_points, SOURCES
from persem_ros.outputs.map.living import LivingMap
from persem_ros.outputs.map.ply import write_ply_parts
from persem_ros.outputs.map.rows import frame_rows, whole_rows
from persem_ros.outputs.map.tables import KINDS, ORDER
from persem_ros.outputs.results.mapped import Mapped, Overview
from persem_ros.settings import config_file
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

NAME = 'working.persem'     # the copy, in the folder of the run
SHOWN = 2_000_000           # voxels of a map that pages show one by one
COARSEST = 3                # a cube of an overview is 2 ** 3 voxels wide at most: a block
RADIUS_EVERY = 50           # frames between two looks at memory.keep_radius


class Paged(Mapped):
    """
    A map in a file, with memory for a part of it.

    Parameters
    ----------
    folder : Path
        Of the run.
    config : Config
    legend : Legend

    """

    paged = True

    def __init__(self, folder: Path, config: Config, legend: Legend) -> None:
        self._path, self._frames = folder / NAME, 0
        source = Path(config.map.path)
        begins = not source.exists()
        if not begins:
            try:
                shutil.copyfile(source, self._path)
            except OSError as error:
                raise PersemError(f'cannot copy {source} to {folder}: '
                                  f'{error.strerror}') from error
        self._living = LivingMap(self._path, config, lambda: legend, durable=False)
        super().__init__(self._living.memory(), config, legend)
        if begins:
            self.memory.session = 0
        self._pager = Pager(self.memory, self._living)

    @property
    def n_voxels(self) -> int:
        """Return the number of voxels of the whole map, as of the last settle()."""
        return self._living.voxels

    def make_room(self, position: ArrayLike) -> None:
        """Let go of the farthest blocks where there are too many; write what has changed first."""
        bounds = self.config.memory
        self._frames += 1
        self._refuse_damaged()
        crowded = 0 < bounds.max_voxels < self.memory.n_voxels
        if crowded or bounds.keep_radius > 0 and self._frames % RADIUS_EVERY == 0:
            self.settle()
            self._pager.let_go(position, bounds.max_voxels, bounds.keep_radius)

    def settle(self) -> None:
        """Bring the file up to date."""
        self._refuse_damaged()
        if self._pager.dirty_voxels:
            self._pager.save()

    def _refuse_damaged(self) -> None:
        """Refuse a file with a damaged block: it would be mapped anew, or left out."""
        if self._living.damaged:
            at = ', '.join(map(str, sorted(self._living.damaged)[:3]))
            raise PersemError(f'{self.config.map.path}: damaged (block {at}); expected a whole '
                              'map file, restore it from a copy')

    def write(self, folder: Path) -> None:
        """Write map.ply and map.persem of the refined map, block by block in ascending index."""
        self.settle()
        with store.reading(self._path) as (db, _):
            blocks: Any = checked(db.execute(f'SELECT * FROM blocks ORDER BY {ORDER["blocks"]}'),
                                  KINDS['blocks'], held_by(self._path))
            store.write(folder / 'map.persem', whole_rows(
                *self._about(), _FrameRows(self.memory.frames), blocks))
        source = MapSource(folder / 'map.persem')
        sight = Sight(source.n_voxels)
        gone = int(self.memory.n_gone > 0) and source.n_voxels - source.summary().voxels
        write_ply_parts(folder / 'map.ply', source.n_voxels - gone, (
            map_points(sight.seen(columns), self.memory.voxel_size, self.legend)
            for columns in source.chunks(Choice())), self.comments())
        self._overview = sight.overview(self.memory.voxel_size)

    def points(self) -> NDArray[np.void]:
        """Return the points of what is in memory, as a node that pages publishes them."""
        return map_points(self.memory.voxels(), self.memory.voxel_size, self.legend)

    def overview(self) -> Overview:
        """Return what pages show: of a large map one voxel of each cube of 2, 4 or 8."""
        return self._overview

    def close(self) -> None:
        """Remove the copy."""
        self._living.close()
        self._path.unlink(missing_ok=True)

    def _about(self) -> tuple[MemoryDump, dict[str, Any]]:
        """Return all of the map but its blocks, and what the table about has to say."""
        capture = Capture(self.memory, self._pager.moment)
        capture.step(np.inf)
        about = {'settings': config_file.to_yaml(self.config), 'legend': self.legend.to_yaml(),
                 'map_frame': self.config.frames.map, 'session': self.memory.session,
                 **self._living.counts}
        return capture.dump(), about


class _FrameRows:
    """The rows of a frame table, as often as they are asked for."""

    def __init__(self, table: FrameTable) -> None:
        self._table = table

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return frame_rows(self._table)


class Sight:
    """
    An overview that is collected while a map passes by.

    Parameters
    ----------
    n_voxels : int
        Of the map.

    """

    def __init__(self, n_voxels: int) -> None:
        self._level = next((level for level in range(COARSEST)
                            if n_voxels >> 2 * level <= SHOWN), COARSEST)
        self._parts: list[Columns] = []
        self._labels = np.zeros(65536, np.int64)
        self._sources = np.zeros(len(SOURCES), np.int64)

    def seen(self, columns: Columns) -> Columns:
        """Take note of some blocks; return their columns."""
        self._labels += np.bincount(columns['label'], minlength=65536)
        self._sources += np.bincount(columns['source'], minlength=len(SOURCES))
        voxel = columns['voxel']
        order = np.argsort(voxel[:, 2], kind='stable')
        cube = voxel[order] >> self._level
        last = sort_order(cube)             # stable: of each cube the highest comes last
        cube = cube[last]
        ends = np.append((cube[1:] != cube[:-1]).any(axis=1), True)[:len(cube)]
        rows = order[last[ends]]
        self._parts.append({
            'voxel': voxel[rows] >> self._level,
            **{name: columns[name][rows]
               for name in ('label', 'majority', 'confidence', 'observations', 'source')}})
        return columns

    def overview(self, voxel_size: float) -> Overview:
        """Return what was seen."""
        columns = ordered({name: np.concatenate([part[name] for part in self._parts])
                           for name in self._parts[0]})
        labels = np.flatnonzero(self._labels)
        return Overview(columns, voxel_size * 2 ** self._level,
                        dict(zip(labels.tolist(), self._labels[labels].tolist())), self._sources)
