"""Reading map files: whole, in part, piece by piece; what is foreign or damaged is refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
import sqlite3
import struct
from typing import Any

from persem_ros.core.memory.dump import Blocks
from persem_ros.errors import PersemError
from persem_ros.guard.database import check_tables, checked, held_by, opened
from persem_ros.outputs.map import schema1
from persem_ros.outputs.map.rows import blocks_of, from_rows
from persem_ros.outputs.map.stored import Head, StoredMap
from persem_ros.outputs.map.tables import check_ours, KINDS, Kinds, NAMES, ORDER, SCHEMA
from persem_ros.settings.legend import Legend

APPLICATION = 0x50455253        # 'PERS', in the header of every map file
EXPECTED = 'expected a .persem file, as a replay or ~/save_map leaves it'


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
        raise PersemError(f'{path}: damaged ({why(error)}); expected a whole map file, restore '
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


def why(error: Exception) -> str:
    """Return what is damaged, in a few words."""
    text = str(error) if isinstance(error, (sqlite3.Error, ValueError)) else ''
    if text == 'interrupted':       # by guard.database.limit_steps
        return 'reading it takes more steps than a file of its size needs'
    return ' '.join(text.split())[:60] or type(error).__name__
