"""
The map file map.persem: one SQLite database, saved whole and loaded exactly (spec section 8).

A row per block of 8 x 8 x 8 voxels holds their evidence and histories as plain little-endian
binary columns; small tables hold what the map is about, its frames and its class counters.
Any SQLite program reads the file; docs/map_file.md describes the columns.

"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
import logging
from pathlib import Path
import shutil
import sqlite3
import struct
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.capture import Parts
from persem_ros.core.memory.dump import Blocks, load as load_memory, MemoryDump
from persem_ros.errors import PersemError
from persem_ros.guard.database import (
    check_beside, check_tables, checked, harden, held_by, journal_of, opened,
    Unsafe)
from persem_ros.outputs.files import replacing
from persem_ros.outputs.map import schema1
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.rows import blocks_of, from_rows, to_rows
from persem_ros.outputs.map.tables import (
    bring_up, check_ours, declared, KINDS, Kinds, NAMES, ORDER, SCHEMA, TABLES)
from persem_ros.settings import config_file
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Config

log = logging.getLogger(__name__)

APPLICATION = 0x50455253        # 'PERS', in the header of every map file
EXPECTED = 'expected a .persem file, as a replay or ~/save_map leaves it'


@dataclass(frozen=True, eq=False)
class StoredMap:
    """
    What a map file holds.

    Attributes
    ----------
    path : Path
    saved : persem_ros.core.memory.dump.MemoryDump
    map_frame : str
        The coordinate frame in which the voxels lie.
    settings : str
        YAML text of the settings in force when it was saved.
    legend : persem_ros.settings.legend.Legend

    """

    path: Path
    saved: MemoryDump
    map_frame: str
    settings: str
    legend: Legend

    def memory(self, config: Config | None = None) -> VoxelMemory:
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
            self.check_fits(config)
            self.warn_of_history(config)
            saved = replace(saved, max_history=config.memory.max_history)
        return load_memory(saved)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the corners (3,) of all voxels' centres, metres in the map frame."""
        saved = self.saved
        voxel = saved.voxels()
        return tuple((corner + 0.5) * saved.voxel_size + np.array(saved.origin)
                     for corner in (voxel.min(axis=0), voxel.max(axis=0)))

    def config(self) -> Config:
        """Return the Config in force when the map was saved."""
        return config_file.from_text(self.settings, f'settings in {self.path}')

    def check_fits(self, config: Config) -> None:
        """Refuse settings whose voxels are other ones."""
        for name, mine, other in (
                ('memory.voxel_size', self.saved.voxel_size, config.memory.voxel_size),
                ('map.origin', list(self.saved.origin), list(config.map.origin)),
                ('frames.map', self.map_frame, config.frames.map)):
            if mine != other:
                raise PersemError(f'{self.path} was made with {name} {mine}, now it is {other}; '
                                  f'give {name} {mine} or another map.path')

    def warn_of_history(self, config: Config) -> None:
        """Say where settings ask for observations that the map has let go of."""
        kept, wanted = self.saved.max_history, config.memory.max_history
        if kept and not 0 < wanted <= kept:
            log.warning('%s holds the newest %d observations of each voxel; older ones do '
                        'not come back with memory.max_history %d', self.path, kept, wanted)


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
                          f'({_why(error)}); move both aside') from error
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


def load(path: Path | str) -> StoredMap:
    """
    Return the StoredMap in a file; one that is being written: as of its last checkpoint.

    Raises
    ------
    PersemError
        For a file that is missing, foreign, of another schema, or damaged.

    """
    return _read(Path(path), '').stored


def load_part(path: Path | str, low: Sequence[int], high: Sequence[int]) -> StoredMap:
    """Return what load() does, but only of blocks whose indices lie within *low* … *high*."""
    return _read(Path(path), _within(low, high)).stored


def _within(low: Sequence[int], high: Sequence[int]) -> str:
    """Return the WHERE of the blocks whose indices lie within *low* … *high*."""
    return 'WHERE ' + ' AND '.join(f'{axis} BETWEEN {int(least)} AND {int(most)}'
                                   for axis, least, most in zip('xyz', low, high))


def load_blocks(path: Path | str, low: Sequence[int], high: Sequence[int]) -> Blocks:
    """Return the blocks that load_part() does, alone; whether they fit anything is not checked."""
    with reading(Path(path)) as (db, _):
        return blocks_of(list(checked(
            db.execute(f'SELECT * FROM blocks {_within(low, high)} ORDER BY {ORDER["blocks"]}'),
            KINDS['blocks'], held_by(Path(path)))))


@dataclass(frozen=True, eq=False)
class Head:
    """All of a map file but its blocks: a StoredMap without any, the table about, the schema."""

    stored: StoredMap
    about: dict[str, Any]
    schema: int


def head(path: Path | str) -> Head:
    """Return the Head of a file; raises as load() does."""
    return _read(Path(path), None)


def _read(path: Path, which: str | None) -> Head:
    """Return what a file holds, with all blocks (''), those of a WHERE, or without (None)."""
    with reading(path) as (db, first):
        names = schema1.NAMES if first else NAMES
        kinds: dict[str, Kinds] = schema1.KINDS if first else KINDS
        size = held_by(path)
        where = dict.fromkeys(ORDER, '') | {'blocks': which}
        rows: dict[str, Any] = {table: list(checked(
            db.execute(f'SELECT * FROM {table} {where[table]} ORDER BY {ORDER[table]}'),
            kinds[table], size))
            for table in ORDER if table in names and where[table] is not None}
        about, saved = from_rows(rows, part=bool(which))
    legend = Legend.from_yaml(about['legend'], str(path)) if about['legend'] else Legend()
    return Head(StoredMap(path, saved, about['map_frame'], about['settings'], legend),
                dict(rows['about']), 1 if first else SCHEMA)


@contextmanager
def reading(path: Path) -> Iterator[tuple[sqlite3.Connection, bool]]:
    """
    Open a map file to be read piece by piece; give it, and whether it is of schema 1.

    All is of one moment, also where the file is being written.

    Raises
    ------
    PersemError
        As load() does, also for what is found to be damaged inside of the block.

    """
    _check_magic(path)
    try:
        with closing(opened(path, living=True)) as db:
            db.execute('BEGIN')
            first = _schema(db, path) == 1
            if first:
                check_tables(db, schema1.NAMES)
            else:
                check_ours(db)
            yield db, first
    except (sqlite3.Error, sqlite3.Warning, KeyError, TypeError, ValueError, IndexError,
            OverflowError, struct.error) as error:
        raise PersemError(f'{path}: damaged ({_why(error)}); expected a whole map file, restore '
                          'it from a copy') from error


def _check_magic(path: Path) -> None:
    """Refuse a file that is not there, cannot be read or is no database at all."""
    try:
        with open(path, 'rb') as file:
            magic = file.read(16)
    except IsADirectoryError:
        inside = path / 'map.persem'
        what = f'did you mean {inside}?' if inside.is_file() else EXPECTED
        raise PersemError(f'{path}: is a folder; {what}') from None
    except OSError as error:
        raise PersemError(f'{path}: cannot be read ({error.strerror}); {EXPECTED}') from None
    if magic != b'SQLite format 3\0':
        raise PersemError(f'{path}: not a map file; {EXPECTED}')


def _schema(db: sqlite3.Connection, path: Path) -> int:
    """Return the schema of a map file; refuse another database, or a schema not known."""
    application = db.execute('PRAGMA application_id').fetchone()[0]
    schema: int = db.execute('PRAGMA user_version').fetchone()[0]
    if application != APPLICATION:
        raise PersemError(f'{path}: a database, but not a map file; {EXPECTED}')
    if not 1 <= schema <= SCHEMA:
        raise PersemError(f'{path}: a map file of schema {schema}, expected schema {SCHEMA}; '
                          'use the version of persem_ros that wrote it, or replay the recording')
    return schema


def _insert(db: sqlite3.Connection, table: str, rows: Iterable[Any]) -> None:
    """Insert all rows, whose number of columns the first one tells."""
    left = iter(rows)
    first = next(left, None)
    if first is not None:
        statement = f'INSERT INTO {table} VALUES ({", ".join("?" * len(first))})'
        db.execute(statement, first)
        db.executemany(statement, left)


def _why(error: Exception) -> str:
    """Return what is damaged, in a few words."""
    text = str(error) if isinstance(error, (sqlite3.Error, ValueError)) else ''
    if text == 'interrupted':       # by guard.database.limit_steps
        return 'reading it takes more steps than a file of its size needs'
    return ' '.join(text.split())[:60] or type(error).__name__
