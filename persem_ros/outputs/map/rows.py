"""The rows of a map file: a MemoryDump as tables, and back (docs/map_file.md)."""

from dataclasses import fields
import struct
import zlib

import numpy as np
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.voxel_memory import FrameRecord
from persem_ros.frames import MAX_ID
from persem_ros.outputs.map.checks import check_about, check_dump

SCHEMA = 1
ORDER = {'about': 'name', 'frames': 'row', 'classes': 'id', 'blocks': 'x, y, z'}
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
# Columns of the tables and the types of their values, as a file must have them.
NAMES = {'about': ('name', 'value'),
         'frames': ('row', 't', 'session', 'sensor', 'stamp', 'T_map_sensor'),
         'classes': ('id', 'starts', 'changes', 'seen', 'rho'),
         'blocks': ('x', 'y', 'z', 'voxels', 'crc', *(name for name, _ in COLUMNS))}
KINDS = {'about': (str, (int, float, str, bytes)), 'frames': (int, int, int, str, int, bytes),
         'classes': (int, int, int, int, float), 'blocks': (int,) * 5 + (bytes,) * len(COLUMNS)}


def to_rows(saved, texts):
    """
    Return {table: iterable of rows} of a map file, in the order of ORDER.

    Parameters
    ----------
    saved : persem_ros.core.memory.dump.MemoryDump
        The map.
    texts : dict
        settings, map_frame and legend, for the table about.

    """
    about = {**texts, 'origin': struct.pack('<3d', *saved.origin),
             'voxel_size': saved.voxel_size, 'max_history': saved.max_history,
             'session': saved.session, 'refined': int(saved.rho is not None),
             'blocks': len(saved.block_index), 'voxels': len(saved.cell),
             'observations': int(saved.observations.sum(dtype=np.int64))}
    frames, classes = list(_frame_rows(saved)), list(_class_rows(saved))
    about['crc'] = _crc(*sorted(about.items()), *frames, *classes)
    return {'about': sorted(about.items()), 'frames': frames, 'classes': classes,
            'blocks': _block_rows(saved)}


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


def from_rows(rows):
    """
    Return what the rows of a map file say.

    Parameters
    ----------
    rows : dict
        {table: list of rows}, sorted as ORDER says.

    Returns
    -------
    about : dict
        {name: value} of the table about.
    saved : persem_ros.core.memory.dump.MemoryDump
        The map.

    Raises
    ------
    ValueError, TypeError, KeyError, IndexError, OverflowError, struct.error
        For rows that are damaged.

    """
    about, frames, classes, blocks = dict(rows['about']), rows['frames'], rows['classes'], \
        rows['blocks']
    crc = about.pop('crc')
    if crc != _crc(*sorted(about.items()), *frames, *classes):
        raise ValueError('checksum of the small tables')
    check_about(about)
    columns = {name: np.frombuffer(bytearray().join(row[5 + k] for row in blocks), kind)
               for k, (name, kind) in enumerate(COLUMNS)}
    for row in blocks:
        if row[4] != _crc((*row[:4], *row[5:])):
            raise ValueError(f'checksum of block {row[:3]}')
    start = {name: _starts(columns.pop(f'{name}_count')) for name in ('evidence', 'history')}
    counts = {name: np.zeros(MAX_ID + 2, kind) for name, kind in (
        ('starts', np.int64), ('changes', np.int64), ('seen', np.uint8), ('rho', np.float64))}
    ids = [row[0] for row in classes]
    if ids and not 0 <= min(ids) <= max(ids) <= MAX_ID:
        raise ValueError('ids of the classes')
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
    check_dump(saved, about)
    return about, saved


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
