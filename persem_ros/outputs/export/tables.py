"""The map as tables, a row a voxel: NumPy's .npz and Apache Parquet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from pathlib import Path
import shutil
import tempfile
from typing import Any, BinaryIO, TYPE_CHECKING
import zipfile

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from persem_ros.outputs.export.libraries import needed
from persem_ros.outputs.export.place import place_of
from persem_ros.outputs.files import replacing

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.outputs.export.source import MapSource

# Columns with one entry a voxel, as both formats have them; docs/exports.md describes them.
VOXEL = ('label', 'majority', 'confidence', 'observations', 'switches', 'source', 'gone',
         'first_stamp', 'last_stamp')


def write_npz(path: Path | str, source: MapSource, choice: Choice) -> int:
    """
    Write a NumPy archive; return the number of voxels.

    It holds voxel (n, 3) int32, xyz (n, 3) float64 (centres in the map frame, metres), the
    columns of VOXEL, and start (n + 1,), classes, probabilities as MapSource.chunks gives them;
    voxel_size and origin; class_ids and class_names of the legend.

    """
    legend = source.legend
    facts = {'voxel_size': np.array(source.voxel_size), 'origin': source.origin,
             'class_ids': np.array(legend.ids, np.int32),
             'class_names': np.array([legend.name(c) for c in legend.ids], np.str_)}
    with replacing(path) as work, _spool(work) as spool:
        with source.shown(choice, 'npz') as chunks:
            for columns in chunks:
                spool.add({'voxel': columns['voxel'], 'xyz': source.centres(columns['voxel']),
                           **{name: columns[name] for name in VOXEL},
                           'length': np.diff(columns['start']), 'classes': columns['classes'],
                           'probabilities': columns['probabilities']})
        n = spool.rows('voxel')
        with zipfile.ZipFile(work, 'w', zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, array in facts.items():
                with archive.open(f'{name}.npy', 'w', force_zip64=True) as out:
                    npy.write_array(out, array, allow_pickle=False)
            spool.pour(archive)
    return n


def write_parquet(path: Path | str, source: MapSource, choice: Choice) -> int:
    """
    Write a Parquet file, a row group per part of the map; return the number of voxels.

    Columns: i, j, k; x, y, z (map frame, metres); those of VOXEL; name (of the label); classes
    and probabilities, lists. The file's metadata has voxel_size, origin, map_frame and crs.

    """
    pa = needed('pyarrow', 'a Parquet file')
    parquet = needed('pyarrow.parquet', 'a Parquet file')
    place = place_of(source)
    about = {'persem_ros.voxel_size': repr(source.voxel_size),
             'persem_ros.origin': ' '.join(map(repr, source.origin.tolist())),
             'persem_ros.map_frame': source.map_frame, 'persem_ros.crs': place.crs,
             'persem_ros.georeference': f'{place.east!r} {place.north!r} {place.up!r} '
                                        f'{place.yaw!r}'}
    n = 0
    with replacing(path) as work, source.shown(choice, 'parquet') as chunks, ExitStack() as stack:
        writer = None
        for columns in chunks:
            table = _table(pa, source, columns).replace_schema_metadata(about)
            writer = writer or stack.enter_context(parquet.ParquetWriter(work, table.schema))
            if len(table):
                writer.write_table(table)
                n += len(table)
    return n


def _table(pa: Any, source: MapSource, columns: Columns) -> Any:
    """Return the pyarrow.Table of some voxels."""
    arrays = dict(zip('ijk', columns['voxel'].T))
    arrays.update(zip('xyz', source.centres(columns['voxel']).T))
    arrays.update((name, columns[name]) for name in VOXEL)
    table: dict[str, Any] = {name: pa.array(np.ascontiguousarray(a))
                             for name, a in arrays.items()}
    for name in ('first_stamp', 'last_stamp'):
        table[name] = table[name].cast(pa.timestamp('ns'))
    ids, place = np.unique(columns['label'], return_inverse=True)
    names = pa.array([source.legend.name(c) for c in ids], pa.string())
    table['name'] = names.take(pa.array(place.reshape(-1)))
    start = pa.array(columns['start'].astype(np.int32))
    for name in ('classes', 'probabilities'):
        table[name] = pa.ListArray.from_arrays(start, pa.array(columns[name]))
    return pa.table(table)


class _Spool:
    """Columns that grow on the disk, for a format that wants to know their lengths first."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, BinaryIO] = {}
        self._like: dict[str, NDArray[Any]] = {}
        self._rows: dict[str, int] = {}

    def add(self, columns: dict[str, NDArray[Any]]) -> None:
        """Append to each column."""
        for name, column in columns.items():
            if name not in self._files:
                self._files[name] = open(self._folder / name, 'w+b')
                self._like[name], self._rows[name] = column[:0], 0
            self._files[name].write(np.ascontiguousarray(column).tobytes())
            self._rows[name] += len(column)

    def rows(self, name: str) -> int:
        """Return the length of a column."""
        return self._rows.get(name, 0)

    def pour(self, archive: zipfile.ZipFile) -> None:
        """Write all columns into an archive; 'length' becomes 'start'."""
        for name, file in self._files.items():
            like, rows = self._like[name], self._rows[name]
            file.seek(0)
            start = name == 'length'
            header = {'descr': npy.dtype_to_descr(like.dtype), 'fortran_order': False,
                      'shape': (rows + start, *like.shape[1:])}
            target = 'start' if start else name
            with archive.open(f'{target}.npy', 'w', force_zip64=True) as out:
                npy.write_array_header_1_0(out, header)
                if not start:
                    shutil.copyfileobj(file, out, 1 << 20)
                    continue
                total = 0
                out.write(np.zeros(1, np.int64).tobytes())
                while data := file.read(1 << 20):
                    sums = total + np.cumsum(np.frombuffer(data, np.int64))
                    total = int(sums[-1])
                    out.write(sums.tobytes())

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()


@contextmanager
def _spool(beside: Path) -> Iterator[_Spool]:
    """Give a _Spool in a folder of its own beside a file; both go at the end."""
    with tempfile.TemporaryDirectory(dir=beside.parent, prefix=f'{beside.name}.') as folder:
        spool = _Spool(Path(folder))
        try:
            yield spool
        finally:
            spool.close()
