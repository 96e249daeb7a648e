"""
A map file in Python: columns, queries, histories, explanations. Entered by persem_ros.open_map.

What is described here stays: names and meanings change with a new major version only.

"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
import importlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import ranges
from persem_ros.errors import PersemError
from persem_ros.outputs.export.choice import Choice, labels_of
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.outputs.map.cloud import SOURCES
from persem_ros.outputs.map.part import explained, surroundings

LISTS = ('start', 'classes', 'probabilities')


class Map:
    """
    A map file (.persem), opened to be read.

    Opening it reads its small tables. Queries read the file, a few blocks at a time; `history`
    loads the whole map once.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    path : Path
    voxel_size : float
        Metres.
    origin : ndarray, shape (3,), float64
        Point of the map frame from which voxels are counted, metres.
    map_frame : str
    settings : persem_ros.settings.config.Config
        In force when the map was saved.
    legend : persem_ros.settings.legend.Legend

    Raises
    ------
    PersemError
        For a file that is missing, foreign, of another schema, or damaged.

    """

    def __init__(self, path: Path | str) -> None:
        self._source = MapSource(path)
        self.path = self._source.path
        self.voxel_size = self._source.voxel_size
        self.origin, self.map_frame = self._source.origin, self._source.map_frame
        self.settings, self.legend = self._source.config, self._source.legend

    def __len__(self) -> int:
        """Return the number of voxels."""
        return self._source.n_voxels

    def __repr__(self) -> str:
        """Return what the map is, in a line."""
        return (f'<map {str(self.path)!r}: {len(self)} voxels of {self.voxel_size:g} m in '
                f'{self.map_frame!r}, {len(self._source.stamps)} frames>')

    @property
    def classes(self) -> dict[int, str]:
        """Return the names of the legend by their ids."""
        return {c: self.legend.name(c) for c in self.legend.ids}

    @property
    def frames(self) -> dict[str, NDArray[Any]]:
        """
        Return the frame table as columns, a row an integrated frame.

        Returns
        -------
        dict
            stamp (f,) int64 nanoseconds; position (f, 3) float64, the sensor's, metres in the
            map frame.

        """
        return {'stamp': self._source.stamps, 'position': self._source.positions}

    def counts(self) -> dict[int, int]:
        """Return {label: number of voxels}, the most frequent first."""
        found = self._source.summary(Choice(gone=True)).labels
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    def columns(self, box: Iterable[float] | None = None,
                classes: Iterable[int | str] | int | str | None = None, min_observations: int = 1,
                gone: bool = False) -> dict[str, NDArray[Any]]:
        """
        Return voxels as columns of NumPy, sorted by voxel index.

        Parameters
        ----------
        box : 6 floats, optional
            x0 y0 z0 x1 y1 z1, metres in the map frame; centres must lie within.
        classes : class ids or names, or one of them, or names separated by commas
            Only voxels with these refined labels; None: all.
        min_observations : int
            Only voxels that were observed so often.
        gone : bool
            Whether voxels whose content moved away are among them.

        Returns
        -------
        dict
            voxel (n, 3) int32; xyz (n, 3) float64, centres, metres in the map frame; label,
            majority (n,) uint16; confidence (n,) float32; observations, switches (n,) uint32;
            source (n,) uint8, place in persem_ros.notebook.SOURCES; gone (n,) uint8;
            first_stamp, last_stamp (n,) int64 ns.

        """
        parts = list(self.chunks(box, classes, min_observations, gone))
        return {name: column for name, column in self._joined(parts).items()
                if name not in LISTS}

    def probabilities(self, box: Iterable[float] | None = None,
                      classes: Iterable[int | str] | int | str | None = None,
                      min_observations: int = 1, gone: bool = False
                      ) -> tuple[list[int], NDArray[np.float32]]:
        """
        Return (ids, P): P (n, len(ids)) float32 has the shares of evidence, rows sum to 1.

        The rows are those of columns() with the same arguments.

        """
        whole = self._joined(list(self.chunks(box, classes, min_observations, gone)))
        ids, place = np.unique(whole['classes'], return_inverse=True)
        result = np.zeros((len(whole['label']), len(ids)), np.float32)
        row = np.repeat(np.arange(len(result)), np.diff(whole['start']))
        result[row, place.reshape(-1)] = whole['probabilities']
        return ids.tolist(), result

    def table(self, **choice: Any) -> Any:
        """Return columns() of the same choice as a pandas.DataFrame, with names and times."""
        try:
            pandas = importlib.import_module('pandas')
        except ImportError:
            raise PersemError('table() needs the Python package pandas, which is not installed; '
                              'pip install pandas, or use columns()') from None
        columns = self.columns(**choice)
        frame = pandas.DataFrame({
            **dict(zip('ijk', columns.pop('voxel').T)), **dict(zip('xyz', columns.pop('xyz').T)),
            **columns})
        frame['name'] = frame['label'].map(self.legend.name)
        frame['source'] = frame['source'].map(dict(enumerate(SOURCES)))
        for name in ('first_stamp', 'last_stamp'):
            frame[name] = pandas.to_datetime(frame[name], unit='ns', utc=True)
        return frame

    def chunks(self, box: Iterable[float] | None = None,
               classes: Iterable[int | str] | int | str | None = None, min_observations: int = 1,
               gone: bool = False) -> Iterator[dict[str, NDArray[Any]]]:
        """
        Yield what columns() returns in parts, for maps that are larger than memory.

        Parts are sorted by block; besides, they have start, classes and probabilities (see
        MapSource.chunks).

        """
        words = None if classes is None else list(
            map(str.strip, classes.split(',')) if isinstance(classes, str) else
            [classes] if isinstance(classes, (int, np.integer)) else classes)
        try:
            corners = None if box is None else tuple(float(x) for x in box)
        except (TypeError, ValueError):
            raise PersemError('a box: expected six numbers x0 y0 z0 x1 y1 z1, '
                              f'got {box!r}') from None
        wanted = Choice(min_observations, corners, labels_of(words or (), self.legend), gone)
        if words == []:
            return
        for chunk in self._source.chunks(wanted):
            yield {'voxel': chunk['voxel'], 'xyz': self._source.centres(chunk['voxel']), **chunk}

    def history(self, x: float, y: float, z: float) -> dict[str, NDArray[Any]]:
        """
        Return what was seen in the voxel at a point (metres in the map frame), oldest first.

        Returns
        -------
        dict
            label (k,) uint16; confidence (k,) float32; stamp (k,) int64 ns; position (k, 3)
            float64, from where it was seen, metres in the map frame.

        Raises
        ------
        PersemError
            Where nothing was observed.

        """
        labels, confidences, frames, _ = self._memory.sightings(self._voxel(x, y, z))
        table = self._memory.frames
        return {'label': labels, 'confidence': confidences, 'stamp': table.stamp[frames],
                'position': table.placed[frames, :3, 3]}

    def explain(self, x: float, y: float, z: float) -> str:
        """Return why the voxel at a point has its label: the text of persem map query."""
        stored, memory, voxel = surroundings(self.path, np.array([x, y, z], float))
        if memory.find(voxel)[0] < 0:
            raise PersemError(f'{self.path}: nothing was observed at {x:g} {y:g} {z:g} m')
        return explained(stored, memory, voxel)[0]

    @cached_property
    def _stored(self) -> store.StoredMap:
        found = store.load(self.path)
        assert found is not None
        return found

    @cached_property
    def _memory(self) -> Any:
        return self._stored.memory()

    def _voxel(self, x: float, y: float, z: float) -> NDArray[np.int32]:
        """Return the index of the observed voxel at a point."""
        place = np.floor((np.array([x, y, z], float) - self.origin) / self.voxel_size)
        if not (np.abs(place) < 2 ** 31 - 16).all() or \
                self._memory.find(place.astype(np.int32))[0] < 0:
            raise PersemError(f'{self.path}: nothing was observed at {x:g} {y:g} {z:g} m')
        return place.astype(np.int32)

    @staticmethod
    def _joined(parts: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
        """Return parts as one, sorted by voxel index."""
        if not parts:
            parts = [_empty()]
        whole = {name: np.concatenate([part[name] for part in parts])
                 for name in parts[0] if name != 'start'}
        length = np.concatenate([np.diff(part['start']) for part in parts])
        order = np.lexsort(whole['voxel'].T[::-1])
        start = np.concatenate([[0], np.cumsum(length)])
        entries = ranges(start[:-1][order], length[order])
        result = {name: column[order] for name, column in whole.items() if name not in LISTS}
        return {**result, 'start': np.concatenate([[0], np.cumsum(length[order])]),
                **{name: whole[name][entries] for name in LISTS if name != 'start'}}


def _empty() -> dict[str, NDArray[Any]]:
    """Return the columns of no voxels."""
    kinds = {'label': 'u2', 'majority': 'u2', 'confidence': 'f4', 'observations': 'u4',
             'switches': 'u4', 'source': 'u1', 'gone': 'u1', 'first_stamp': 'i8',
             'last_stamp': 'i8', 'classes': 'u2', 'probabilities': 'f4'}
    return {'voxel': np.empty((0, 3), np.int32), 'xyz': np.empty((0, 3)),
            **{name: np.empty(0, kind) for name, kind in kinds.items()},
            'start': np.zeros(1, np.int64)}
