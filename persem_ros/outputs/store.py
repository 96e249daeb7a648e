"""
The map file map.persem: one SQLite database, saved whole and loaded exactly (spec section 8).

A row per block of 8 x 8 x 8 voxels holds their evidence and histories as plain little-endian
binary columns; small tables hold what the map is about, its frames and its class counters.
Any SQLite program reads the file; docs/map_file.md describes the columns.

"""

from contextlib import closing
from dataclasses import dataclass, fields, replace
import logging
from pathlib import Path
import sqlite3
import struct
from urllib.parse import quote
import zlib

import numpy as np
from persem_ros import config_file
from persem_ros.core.dump import dump, load as load_memory, MemoryDump
from persem_ros.core.memory import FrameRecord
from persem_ros.core.pools import CELLS, SIDE
from persem_ros.errors import PersemError
from persem_ros.frames import MAX_ID
from persem_ros.legend import Legend
from persem_ros.outputs.files import replacing

log = logging.getLogger(__name__)

APPLICATION = 0x50455253        # 'PERS', in the header of every map file
SCHEMA = 1
EXPECTED = 'expected a .persem file, as a replay or ~/save_map leaves it'
VOXEL = (('cell', '<u2'), ('observations', '<u4'), ('switches', '<u4'), ('label', '<u2'),
         ('majority', '<u2'), ('last', '<u2'), ('source', 'u1'), ('dirty', 'u1'))
EVIDENCE = (('evidence_class', '<u2'), ('evidence_sum', '<f8'))
HISTORY = (('history_label', '<u2'), ('history_confidence', '<f4'), ('history_t', '<i4'))
COUNTS = (('evidence_count', '<u4'), ('history_count', '<u4'))
COLUMNS = (*VOXEL, *COUNTS, *EVIDENCE, *HISTORY)
TABLES = f"""
CREATE TABLE about (name TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE frames (row INTEGER PRIMARY KEY, t INTEGER, session INTEGER, sensor TEXT,
                     stamp INTEGER, T_map_sensor BLOB);
CREATE TABLE classes (id INTEGER PRIMARY KEY, starts INTEGER, changes INTEGER, seen INTEGER,
                      rho REAL);
CREATE TABLE blocks (x INTEGER, y INTEGER, z INTEGER, voxels INTEGER, crc INTEGER,
                     {", ".join(f"{name} BLOB" for name, _ in COLUMNS)},
                     PRIMARY KEY (x, y, z));
"""


@dataclass(frozen=True, eq=False)
class StoredMap:
    """
    What a map file holds.

    Attributes
    ----------
    path : Path
    saved : persem_ros.core.dump.MemoryDump
    map_frame : str
        The coordinate frame in which the voxels lie.
    settings : str
        YAML text of the settings in force when it was saved.
    legend : persem_ros.legend.Legend

    """

    path: Path
    saved: MemoryDump
    map_frame: str
    settings: str
    legend: Legend

    def memory(self, config=None):
        """
        Return a VoxelMemory that goes on exactly where the saved one stood.

        Parameters
        ----------
        config : Config, optional
            Settings with which mapping goes on.

        Raises
        ------
        PersemError
            Where voxels of these settings would not fit the map's.

        """
        saved = self.saved
        if config is not None:
            self._check_fits(config)
            kept, wanted = saved.max_history, config.memory.max_history
            if kept and not 0 < wanted <= kept:
                log.warning('%s holds the newest %d observations of each voxel; older ones do '
                            'not come back with memory.max_history %d', self.path, kept, wanted)
            saved = replace(saved, max_history=wanted)
        return load_memory(saved)

    def bounds(self):
        """Return the corners (3,) of all voxels' centres, metres in the map frame."""
        saved = self.saved
        cell = saved.cell.astype(np.int64)
        voxel = np.repeat(saved.block_index.astype(np.int64) * SIDE, np.diff(saved.block_start),
                          axis=0) + np.stack([cell >> 6, cell >> 3 & 7, cell & 7], axis=1)
        return tuple((corner + 0.5) * saved.voxel_size + np.array(saved.origin)
                     for corner in (voxel.min(axis=0), voxel.max(axis=0)))

    def config(self):
        """Return the Config in force when the map was saved."""
        return config_file.from_text(self.settings, f'settings in {self.path}')

    def _check_fits(self, config):
        """Refuse settings whose voxels are other ones."""
        for name, mine, other in (
                ('memory.voxel_size', self.saved.voxel_size, config.memory.voxel_size),
                ('map.origin', list(self.saved.origin), list(config.map.origin)),
                ('frames.map', self.map_frame, config.frames.map)):
            if mine != other:
                raise PersemError(f'{self.path} was made with {name} {mine}, now it is {other}; '
                                  f'give {name} {mine} or another map.path')


def save(path, memory, config, legend=None):
    """
    Save a map, whole or not at all; the same map gives the same bytes.

    Parameters
    ----------
    path : str or Path
        The file; an older one is replaced when the new one is whole and on the disk.
    memory : VoxelMemory or MemoryDump
        The map; a dump may be saved beside the mapping.
    config : persem_ros.config.Config
        Settings in force.
    legend : persem_ros.legend.Legend, optional
        Names and colours of the classes.

    Raises
    ------
    PersemError
        When the folder cannot be written or the disk is full.

    """
    saved = memory if isinstance(memory, MemoryDump) else dump(memory)
    about = {'settings': config_file.to_yaml(config), 'map_frame': config.frames.map,
             'legend': legend.to_yaml() if legend is not None else '',
             'origin': _packed('3d', saved.origin), 'voxel_size': saved.voxel_size,
             'max_history': saved.max_history, 'session': saved.session,
             'refined': int(saved.rho is not None), 'blocks': len(saved.block_index),
             'voxels': len(saved.cell), 'observations': int(saved.observations.sum(dtype='i8'))}
    frames, classes = list(_frame_rows(saved)), list(_class_rows(saved))
    about['crc'] = _crc(*_about_rows(about), *frames, *classes)
    with replacing(path) as work:
        try:
            with closing(sqlite3.connect(work, isolation_level=None)) as db:
                db.executescript(
                    'PRAGMA page_size = 8192; PRAGMA journal_mode = OFF; '
                    'PRAGMA synchronous = OFF; PRAGMA locking_mode = EXCLUSIVE; '
                    f'PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {SCHEMA};'
                    f'BEGIN; {TABLES}')
                _insert(db, 'about', _about_rows(about))
                _insert(db, 'frames', frames)
                _insert(db, 'classes', classes)
                _insert(db, 'blocks', _block_rows(saved))
                db.execute('COMMIT')
        except sqlite3.Error as error:
            raise PersemError(f'cannot write {path}: {error}') from error


def load(path):
    """
    Return the StoredMap in a file.

    Raises
    ------
    PersemError
        For a file that is missing, foreign, of another schema, or damaged.

    """
    path = Path(path)
    _check_magic(path)
    try:
        # Immutable: no lock, no journal, nothing is ever written beside the file.
        uri = f'file:{quote(str(path.resolve()))}?mode=ro&immutable=1'
        with closing(sqlite3.connect(uri, uri=True)) as db:
            _check_kind(db, path)
            about = dict(db.execute('SELECT name, value FROM about'))
            tables = [list(db.execute(f'SELECT * FROM {name} ORDER BY {key}'))
                      for name, key in (('frames', 'row'), ('classes', 'id'),
                                        ('blocks', 'x, y, z'))]
        stored = _unpacked(path, about, *tables)
    except (sqlite3.Error, sqlite3.Warning, KeyError, TypeError, ValueError, IndexError,
            OverflowError, struct.error) as error:
        raise PersemError(f'{path}: damaged ({_why(error)}); expected a whole map file, restore '
                          'it from a copy') from error
    return stored


def _check_magic(path):
    """Refuse a file that is not there, cannot be read or is no database at all."""
    try:
        with open(path, 'rb') as file:
            magic = file.read(16)
    except OSError as error:
        raise PersemError(f'{path}: cannot be read ({error.strerror}); {EXPECTED}') from None
    if magic != b'SQLite format 3\0':
        raise PersemError(f'{path}: not a map file; {EXPECTED}')


def _check_kind(db, path):
    """Refuse a database that is no map, or one of another schema."""
    application = db.execute('PRAGMA application_id').fetchone()[0]
    schema = db.execute('PRAGMA user_version').fetchone()[0]
    if application != APPLICATION:
        raise PersemError(f'{path}: a database, but not a map file; {EXPECTED}')
    if schema != SCHEMA:
        raise PersemError(f'{path}: a map file of schema {schema}, expected schema {SCHEMA}; '
                          'use the version of persem_ros that wrote it, or replay the recording')


def _unpacked(path, about, frames, classes, blocks):
    """Return the StoredMap of a file's rows; ValueError where they do not fit together."""
    crc = about.pop('crc')
    if crc != _crc(*_about_rows(about), *frames, *classes):
        raise ValueError('checksum of the small tables')
    columns = {name: np.frombuffer(bytearray().join(row[5 + k] for row in blocks), kind)
               for k, (name, kind) in enumerate(COLUMNS)}
    for row in blocks:
        if row[4] != _crc((*row[:4], *row[5:])):
            raise ValueError(f'checksum of block {row[:3]}')
    start = {name: _starts(columns.pop(f'{name}_count')) for name in ('evidence', 'history')}
    counts = {name: np.zeros(MAX_ID + 2, kind) for name, kind in (
        ('starts', np.int64), ('changes', np.int64), ('seen', np.uint8), ('rho', np.float64))}
    ids = [row[0] for row in classes]
    for k, column in enumerate(counts.values(), 1):
        column[ids] = [row[k] for row in classes]
    saved = MemoryDump(
        about['voxel_size'], struct.unpack('<3d', about['origin']), about['max_history'],
        about['session'], np.array([row[:3] for row in blocks], np.int32).reshape(-1, 3),
        _starts([row[3] for row in blocks]), **columns, evidence_start=start['evidence'],
        history_start=start['history'], starts=counts['starts'], changes=counts['changes'],
        seen_ids=counts['seen'], rho=counts['rho'] if about['refined'] else None,
        frames=[FrameRecord(*row[1:5], np.frombuffer(row[5]).reshape(4, 4).copy())
                for row in frames])
    _check(saved, about)
    legend = Legend.from_yaml(about['legend'], str(path)) if about['legend'] else Legend()
    return StoredMap(path, saved, about['map_frame'], about['settings'], legend)


def _check(saved, about):
    """Refuse (ValueError) columns that do not fit together, whoever wrote their checksums."""
    n, rows = len(saved.cell), np.diff(saved.block_start)
    evidence, history = np.diff(saved.evidence_start), np.diff(saved.history_start)
    last = np.zeros(n, bool)
    last[saved.block_start[1:] - 1] = True
    newest = np.zeros(len(saved.history_t), bool)
    newest[saved.history_start[1:] - 1] = True
    fits = {
        'number of blocks': len(rows) == about['blocks'] and (rows > 0).all(),
        'number of voxels': n == about['voxels'] == saved.block_start[-1],
        'length of a column': len(saved.evidence_sum) == saved.evidence_start[-1] and
        len(saved.history_t) == saved.history_start[-1] and
        all(len(getattr(saved, name)) == n for name, _ in VOXEL) and
        all(len(getattr(saved, name)) == len(saved.history_t) for name, _ in HISTORY) and
        all(len(getattr(saved, name)) == len(saved.evidence_sum) for name, _ in EVIDENCE)}
    _all_or_damaged(fits)
    fits = {
        'cells': (saved.cell < CELLS).all() and
        ((np.diff(saved.cell.astype(np.int64)) > 0) | last[:-1]).all(),
        'observations': (history > 0).all() and (history <= saved.observations).all() and
        saved.observations.sum(dtype=np.int64) == about['observations'],
        'labels': max((column.max(initial=0) for column in (
            saved.label, saved.majority, saved.last, saved.history_label,
            saved.evidence_class))) <= MAX_ID and saved.source.max(initial=0) <= 3,
        'evidence': (evidence > 0).all() and (saved.evidence_sum > 0).all() and
        np.isfinite(saved.evidence_sum).all(),
        'times': (saved.history_t >= 0).all() and
        ((np.diff(saved.history_t) >= 0) | newest[:-1]).all()}
    _all_or_damaged(fits)


def _all_or_damaged(fits):
    """Raise ValueError with the first name whose condition does not hold."""
    for name, holds in fits.items():
        if not holds:
            raise ValueError(name)


def _about_rows(about):
    """Return the rows of the table about, sorted."""
    return sorted(about.items())


def _frame_rows(saved):
    """Yield the rows of the table frames, in the order of integration."""
    for row, frame in enumerate(saved.frames):
        pose = np.ascontiguousarray(frame.T_map_sensor, '<f8').tobytes()
        yield row, int(frame.t), int(frame.session), frame.sensor, int(frame.stamp), pose


def _class_rows(saved):
    """Yield the rows of the table classes: ids that were ever counted."""
    rho = np.zeros(len(saved.starts)) if saved.rho is None else saved.rho
    for c in np.flatnonzero((saved.starts != 0) | (saved.changes != 0) | (saved.seen_ids != 0)):
        yield (int(c), int(saved.starts[c]), int(saved.changes[c]), int(saved.seen_ids[c]),
               float(rho[c]))


def _block_rows(saved):
    """Yield the rows of the table blocks, sorted by index; columns are views, not copies."""
    arrays = {field.name: getattr(saved, field.name) for field in fields(saved)}
    arrays['evidence_count'] = np.diff(saved.evidence_start)
    arrays['history_count'] = np.diff(saved.history_start)
    columns = [np.ascontiguousarray(arrays[name], kind) for name, kind in COLUMNS]
    views = [memoryview(column.view(np.uint8)) for column in columns]
    sizes = [column.itemsize for column in columns]
    borders = saved.block_start, saved.evidence_start[saved.block_start], \
        saved.history_start[saved.block_start]
    which = [borders[0]] * (len(VOXEL) + len(COUNTS)) + [borders[1]] * len(EVIDENCE) + \
        [borders[2]] * len(HISTORY)
    edges = [(border * size).tolist() for border, size in zip(which, sizes)]
    index, rows = saved.block_index.tolist(), np.diff(saved.block_start).tolist()
    for b, (x, y, z) in enumerate(index):
        data = [view[edge[b]:edge[b + 1]] for view, edge in zip(views, edges)]
        key = x, y, z, rows[b]
        yield (*key, _crc((*key, *data)), *data)


def _insert(db, table, rows):
    """Insert all rows, whose number of columns the first one tells."""
    rows = iter(rows)
    first = next(rows, None)
    if first is not None:
        statement = f'INSERT INTO {table} VALUES ({", ".join("?" * len(first))})'
        db.execute(statement, first)
        db.executemany(statement, rows)


def _crc(*rows):
    """Return the CRC-32 of rows of numbers, texts and bytes."""
    crc = 0
    for row in rows:
        for value in row:
            data = value if isinstance(value, (bytes, memoryview)) else f'{value!r};'.encode()
            crc = zlib.crc32(data, crc)
    return crc


def _starts(counts):
    """Return 0 and the running sums of counts, int64."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)


def _packed(form, values):
    """Return numbers as little-endian bytes."""
    return struct.pack(f'<{form}', *values)


def _why(error):
    """Return what is damaged, in a few words."""
    text = str(error) if isinstance(error, (sqlite3.Error, ValueError)) else ''
    return ' '.join(text.split())[:60] or type(error).__name__
