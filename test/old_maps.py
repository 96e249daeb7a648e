"""Writes map files as earlier versions of persem_ros left them: of schema 1, the first of 2."""

from contextlib import closing
import sqlite3
import struct
import zlib

import numpy as np
from persem_ros.settings import config_file

COLUMNS = (
    ('cell', '<u2'), ('observations', '<u4'), ('switches', '<u4'), ('label', '<u2'),
    ('majority', '<u2'), ('last', '<u2'), ('source', 'u1'), ('dirty', 'u1'),
    ('evidence_count', '<u4'), ('history_count', '<u4'), ('evidence_class', '<u2'),
    ('evidence_sum', '<f8'), ('history_label', '<u2'), ('history_confidence', '<f4'),
    ('history_t', '<i4'))
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


def save(path, saved, config):
    """Write a MemoryDump as a file of schema 1."""
    about = {'settings': config_file.to_yaml(config), 'map_frame': config.frames.map,
             'legend': '', 'origin': struct.pack('<3d', *saved.origin),
             'voxel_size': saved.voxel_size, 'max_history': saved.max_history,
             'session': saved.session, 'refined': int(saved.rho is not None),
             'blocks': len(saved.block_index), 'voxels': len(saved.cell),
             'observations': int(saved.observations.sum(dtype=np.int64))}
    frames = [(row, f.t, f.session, f.sensor, f.stamp, f.T_map_sensor.tobytes())
              for row, f in enumerate(saved.frames)]
    rho = np.zeros(65536) if saved.rho is None else saved.rho
    classes = [(c, int(saved.starts[c]), int(saved.changes[c]), int(saved.seen_ids[c]),
                float(rho[c])) for c in range(65536)
               if saved.starts[c] or saved.changes[c] or saved.seen_ids[c]]
    about['crc'] = _crc(*sorted(about.items()), *frames, *classes)
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.executescript(f'PRAGMA page_size = 8192; PRAGMA application_id = {0x50455253}; '
                         f'PRAGMA user_version = 1; BEGIN; {TABLES}')
        for table, rows in (('about', sorted(about.items())), ('frames', frames),
                            ('classes', classes), ('blocks', list(_blocks(saved)))):
            if rows:
                db.executemany(
                    f'INSERT INTO {table} VALUES ({", ".join("?" * len(rows[0]))})', rows)
        db.execute('COMMIT')


def _blocks(saved):
    """Yield the rows of the table blocks."""
    columns = {name: getattr(saved, name, None) for name, _ in COLUMNS}
    columns['evidence_count'] = np.diff(saved.evidence_start)
    columns['history_count'] = np.diff(saved.history_start)
    columns['history_t'] = saved.frames.t[saved.history_frame]
    for b, (x, y, z) in enumerate(saved.block_index.tolist()):
        begin, end = saved.block_start[b:b + 2]
        data = []
        for name, kind in COLUMNS:
            rows = slice(begin, end)
            for group in ('evidence', 'history'):
                if name.startswith(group) and not name.endswith('count'):
                    start = getattr(saved, f'{group}_start')
                    rows = slice(start[begin], start[end])
            data.append(np.ascontiguousarray(columns[name][rows], kind).tobytes())
        key = x, y, z, int(end - begin)
        yield (*key, _crc((*key, *data)), *data)


def _crc(*rows):
    """Return the CRC-32 of rows of numbers, texts and bytes."""
    crc = 0
    for row in rows:
        for value in row:
            crc = zlib.crc32(value if isinstance(value, bytes) else f'{value!r};'.encode(), crc)
    return crc


# The table blocks of schema 2 before voxels were looked through (memory.clear_after).
FIRST_OF_2 = (
    'cell', 'observations', 'switches', 'label', 'majority', 'last', 'first_label', 'source',
    'dirty', 'gone', 'posterior', 'evidence_count', 'history_count', 'evidence_class',
    'evidence_sum', 'history_label', 'history_confidence', 'history_frame', 'history_offset')


def make_first_of_2(path):
    """Turn a map file of today into one of the first of schema 2, as these were written."""
    own = ', '.join(('x', 'y', 'z', 'voxels', 'crc', *FIRST_OF_2))
    columns = ', '.join(f'{name} BLOB' for name in FIRST_OF_2)
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        rows = list(db.execute(f'SELECT {own} FROM blocks ORDER BY x, y, z'))
        db.executescript(f"""PRAGMA journal_mode = OFF; BEGIN; DROP TABLE blocks;
CREATE TABLE blocks (x INTEGER, y INTEGER, z INTEGER, voxels INTEGER, crc INTEGER,
                     {columns},
                     PRIMARY KEY (x, y, z));
""")
        for row in rows:
            key, data = row[:4], row[5:]
            db.execute(f'INSERT INTO blocks VALUES ({", ".join("?" * len(row))})',
                       (*key, _crc((*key, *data)), *data))
        db.execute('COMMIT')
