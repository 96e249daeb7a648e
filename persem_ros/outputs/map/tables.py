"""The tables of a map file (docs/map_file.md), and how older ones are declared."""

from __future__ import annotations

from collections.abc import Sequence
import sqlite3
from typing import Union

from persem_ros.guard.database import check_declared, check_tables, columns_of, Unsafe

SCHEMA = 2
ORDER = {'about': 'name', 'sessions': 'number', 'mounts': 'session, sensor', 'frames': 'row',
         'classes': 'id', 'blocks': 'x, y, z'}
VOXEL = (('cell', '<u2'), ('observations', '<u4'), ('switches', '<u4'), ('label', '<u2'),
         ('majority', '<u2'), ('last', '<u2'), ('first_label', '<u2'), ('source', 'u1'),
         ('dirty', 'u1'), ('gone', 'u1'), ('posterior', '<f4'))
EVIDENCE = (('evidence_class', '<u2'), ('evidence_sum', '<f8'))
HISTORY = (('history_label', '<u2'), ('history_confidence', '<f4'), ('history_frame', '<i4'),
           ('history_offset', 'u1'))
AXES = {'history_offset': 3}        # numbers an entry; 1 elsewhere
COUNTS = (('evidence_count', '<u4'), ('history_count', '<u4'))
# Of each voxel, too, but empty where all of a block's are 0. The first files of schema 2 had none
# of them, which says the same: an empty column leaves a block's checksum as it is.
SPARSE = (('passed', '<u4'), ('passed_at', '<i8'))
COLUMNS = (*VOXEL, *COUNTS, *EVIDENCE, *HISTORY, *SPARSE)
BEFORE_SPARSE = COLUMNS[:-len(SPARSE)]


def _blocks(columns: tuple[tuple[str, str], ...]) -> str:
    """Return how the table blocks with these columns is declared."""
    return f"""CREATE TABLE blocks (x INTEGER, y INTEGER, z INTEGER, voxels INTEGER, crc INTEGER,
                     {", ".join(f"{name} BLOB" for name, _ in columns)},
                     PRIMARY KEY (x, y, z));
"""


SMALL = """
CREATE TABLE about (name TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE frames (row INTEGER PRIMARY KEY, t INTEGER, session INTEGER, sensor TEXT,
                     stamp INTEGER, T_map_sensor BLOB, T_map_best BLOB);
CREATE TABLE sessions (number INTEGER PRIMARY KEY, uuid TEXT);
CREATE TABLE mounts (session INTEGER, sensor TEXT, T_body_sensor BLOB,
                     PRIMARY KEY (session, sensor)) WITHOUT ROWID;
CREATE TABLE classes (id INTEGER PRIMARY KEY, starts INTEGER, changes INTEGER, seen INTEGER,
                      rho REAL);
"""
TABLES = SMALL + _blocks(COLUMNS)
# Columns of the tables and the types of their values, as a file must have them.
NAMES = {'about': ('name', 'value'),
         'sessions': ('number', 'uuid'), 'mounts': ('session', 'sensor', 'T_body_sensor'),
         'frames': ('row', 't', 'session', 'sensor', 'stamp', 'T_map_sensor', 'T_map_best'),
         'classes': ('id', 'starts', 'changes', 'seen', 'rho'),
         'blocks': ('x', 'y', 'z', 'voxels', 'crc', *(name for name, _ in COLUMNS))}
Kinds = Sequence[Union[type, tuple[type, ...]]]      # of the values of a row
KINDS: dict[str, Kinds] = {
    'about': (str, (int, float, str, bytes)), 'sessions': (int, str), 'mounts': (int, str, bytes),
    'frames': (int, int, int, str, int, bytes, (bytes, type(None))),
    'classes': (int, int, int, int, float), 'blocks': (int,) * 5 + (bytes,) * len(COLUMNS)}


def check_ours(db: sqlite3.Connection) -> None:
    """Refuse (Unsafe) tables with other columns than those of schema 2, of now or at first."""
    first = columns_of(db, 'blocks') == list(NAMES['blocks'][:-len(SPARSE)])
    check_tables(db, {name: columns for name, columns in NAMES.items()
                      if name != 'blocks' or not first})


def declared(db: sqlite3.Connection) -> bool:
    """
    Return whether a file's tables are declared as TABLES are; False where as they were at first.

    Raises
    ------
    Unsafe
        Where they are declared as neither.

    """
    try:
        check_declared(db, TABLES)
        return True
    except Unsafe:
        check_declared(db, SMALL + _blocks(BEFORE_SPARSE))
        return False


def bring_up(db: sqlite3.Connection) -> None:
    """
    Give a file in which declared() is False the columns that it lacks.

    In one transaction, and without holding the map in memory; the file grows by its own size, of
    which the next blocks make use.

    """
    if declared(db):
        return
    empty = ", x''" * len(SPARSE)
    for statement in ('BEGIN IMMEDIATE', 'ALTER TABLE blocks RENAME TO before', _blocks(COLUMNS),
                      f'INSERT INTO blocks SELECT *{empty} FROM before ORDER BY x, y, z',
                      'DROP TABLE before', 'COMMIT'):
        db.execute(statement)
