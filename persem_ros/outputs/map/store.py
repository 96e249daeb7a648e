"""
The map file map.persem: one SQLite database, saved whole and loaded exactly (spec section 8).

A row per block of 8 x 8 x 8 voxels holds their evidence and histories as plain little-endian
binary columns; small tables hold what the map is about, its frames and its class counters.
Any SQLite program reads the file; docs/map_file.md describes the columns.

"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
import logging
from pathlib import Path
import shutil
import sqlite3
import struct
from typing import Any, TYPE_CHECKING

from persem_ros.core.memory.capture import Parts
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.errors import PersemError
from persem_ros.guard.database import check_beside, harden, held_by, journal_of, Unsafe
from persem_ros.outputs.files import replacing
from persem_ros.outputs.map.loading import (
    APPLICATION, head, load, load_blocks, load_part, reading, why)
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.rows import to_rows
from persem_ros.outputs.map.stored import Head, StoredMap
from persem_ros.outputs.map.tables import bring_up, check_ours, declared, SCHEMA, TABLES
from persem_ros.settings import config_file

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)

# Saving is here, reading in loading.py; whoever does both needs this module only.
__all__ = ('Head', 'SCHEMA', 'StoredMap', 'copy', 'declared_as_ours', 'fold_log', 'head', 'load',
           'load_blocks', 'load_part', 'reading', 'save', 'write')


def save(path: Path | str, memory: VoxelMemory | MemoryDump, config: Config,
         legend: Legend | None = None) -> None:
    """
    Save a map, whole or not at all; the same map gives the same bytes.

    Parameters
    ----------
    path : str or Path
        The file; an older one is replaced when the new one is whole and on the disk.
    memory : VoxelMemory or MemoryDump
        The map, which nothing may change meanwhile; a dump may be saved beside the mapping.
    config : persem_ros.settings.config.Config
        Settings in force.
    legend : persem_ros.settings.legend.Legend, optional
        Names and colours of the classes.

    Raises
    ------
    PersemError
        When the folder cannot be written or the disk is full.

    """
    saved = memory if isinstance(memory, MemoryDump) else Parts(memory)
    rows = to_rows(saved, {'settings': config_file.to_yaml(config),
                           'map_frame': config.frames.map,
                           'legend': legend.to_yaml() if legend is not None else ''})
    write(path, rows)


def write(path: Path | str, rows: dict[str, Any]) -> None:
    """Write the rows of a map file (rows.to_rows), whole or not at all; raises as save() does."""
    fold_log(path)
    with replacing(path) as work:
        try:
            with closing(sqlite3.connect(work, isolation_level=None)) as db:
                db.executescript(
                    'PRAGMA page_size = 8192; PRAGMA journal_mode = OFF; '
                    'PRAGMA synchronous = OFF; PRAGMA locking_mode = EXCLUSIVE; '
                    f'PRAGMA application_id = {APPLICATION}; PRAGMA user_version = {SCHEMA};'
                    f'BEGIN; {TABLES}')
                for table, content in rows.items():
                    _insert(db, table, content)
                db.execute('COMMIT')
            _keep_schema_1(path)
        except sqlite3.Error as error:
            raise PersemError(f'cannot write {path}: {error}') from error


def copy(source: Path, path: Path) -> None:
    """
    Copy a finished map file to another name, whole or not at all.

    Raises
    ------
    PersemError
        As save() does; what was there before is untouched.

    """
    fold_log(path, locked=True)
    with replacing(path) as work:
        shutil.copyfile(source, work)
        _keep_schema_1(path)


def fold_log(path: Path | str, locked: bool = False) -> None:
    """
    Bring the log or journal that a killed writer left beside a map file into the file.

    Raises
    ------
    PersemError
        Where a writer is at work (unless we are the writer: *locked*), and for a damaged file.

    """
    path = Path(path)
    if not path.exists() or held_by(path) == path.stat().st_size and journal_of(path) is None:
        return
    lock = None if locked else WriterLock(path)
    try:
        check_beside(path)
        with closing(sqlite3.connect(path, isolation_level=None)) as db:
            harden(db)
            check_ours(db)
            db.execute('PRAGMA wal_checkpoint(TRUNCATE)').fetchall()
            db.execute('PRAGMA journal_mode = DELETE').fetchall()
    except (sqlite3.Error, ValueError) as error:
        raise PersemError(f'{path}: damaged, or its log cannot be brought into it '
                          f'({why(error)}); move both aside') from error
    finally:
        if lock is not None:
            lock.close()


def declared_as_ours(path: Path) -> None:
    """
    Write a map file anew that is of schema 1, or whose tables somebody else has declared.

    One of the first of schema 2 gets the columns that it lacks, in place.

    Raises
    ------
    PersemError
        As load() and save() do, and for links beside it that SQLite would follow.

    """
    try:
        check_beside(path)
        if journal_of(path) is not None:
            fold_log(path, locked=True)
        with reading(path) as (db, first):
            if not first and declared(db):
                return
        if not first:
            return _bring_up(path)
    except Unsafe as error:
        raise PersemError(f'{path}: {error}; move what lies beside it away') from error
    except PersemError as error:
        if not isinstance(error.__cause__, Unsafe):
            raise
    whole = load(path)
    save(path, whole.saved, whole.config(), whole.legend)


def _bring_up(path: Path) -> None:
    """Give one of the first files of schema 2 the columns that it lacks, in one transaction."""
    try:
        with closing(sqlite3.connect(path, isolation_level=None)) as db:
            harden(db)
            # A log can be read by anybody after a kill; a journal could not.
            db.execute('PRAGMA journal_mode = WAL').fetchall()
            bring_up(db)
        fold_log(path, locked=True)
    except sqlite3.Error as error:
        raise PersemError(f'{path} cannot be written ({error}); copy it to a disk that has room '
                          'for it twice') from error


def _keep_schema_1(path: Any) -> None:
    """Leave a file of schema 1 that is about to be replaced beside it, as NAME.v1."""
    try:
        with open(path, 'rb') as file:
            header = file.read(72)
        kept, wanted = Path(f'{path}.v1'), struct.pack('>i', APPLICATION)
        if header[60:64] == struct.pack('>i', 1) and header[68:] == wanted and not kept.exists():
            shutil.copy2(path, kept)
            log.warning('%s was a map file of schema 1 and is brought up to schema %d; the old '
                        'one stays as %s', path, SCHEMA, kept)
    except FileNotFoundError:
        pass


def _insert(db: sqlite3.Connection, table: str, rows: Iterable[Any]) -> None:
    """Insert all rows, whose number of columns the first one tells."""
    left = iter(rows)
    first = next(left, None)
    if first is not None:
        statement = f'INSERT INTO {table} VALUES ({", ".join("?" * len(first))})'
        db.execute(statement, first)
        db.executemany(statement, left)
