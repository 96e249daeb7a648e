"""
SQLite files from anywhere: plain tables only, read within bounds that their own size sets.

A schema is a program: a view, a virtual table or a generated column of the expected name computes
whatever its author wanted, and a tree whose branches share pages holds more rows than atoms are.
What an honest file gives is bounded by its size, so that is the bound.

"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import os
from pathlib import Path
import sqlite3
from typing import Any
from urllib.parse import quote

LONGEST = 1 << 30           # bytes of one value: SQLite's own default limit
STEPS = 20_000_000         # steps of SQLite's machine that every file may take
STEPS_A_BYTE = 50           # and that each of its bytes adds: rows of 8 bytes take 20 to 40
PER_CALL = 100_000          # steps between two looks at what is left
SUPER = bytes.fromhex('d9d505f920a163d7')   # ends a journal that names a file to be deleted
LIMIT_LENGTH = 0            # sqlite3.SQLITE_LIMIT_LENGTH, which Python 3.10 does not name


class Unsafe(ValueError):
    """What a file holds that no honest one does: a few words."""


def opened(path: str | Path, check_same_thread: bool = True, living: bool = False,
           ) -> sqlite3.Connection:
    """
    Open a database read-only: no lock, no journal, nothing is ever written beside it.

    What is read costs at most a number of steps that the file's size sets (limit_steps). A
    *living* one that has a write-ahead log beside it is read together with that.

    """
    path = Path(path)
    rights = 'mode=ro' if living and held_by(path) > path.stat().st_size else 'mode=ro&immutable=1'
    db = sqlite3.connect(f'file:{quote(os.fsencode(path.resolve()))}?{rights}', uri=True,
                         check_same_thread=check_same_thread)
    harden(db)
    limit_steps(db, held_by(path) if living else path.stat().st_size)
    return db


def held_by(path: Path) -> int:
    """Return the bytes of a database and its write-ahead log."""
    size = path.stat().st_size
    try:
        return size + Path(f'{path}-wal').stat().st_size
    except OSError:
        return size


def harden(db: sqlite3.Connection) -> None:
    """Let nothing in the schema call functions, and no value be longer than LONGEST."""
    db.execute('PRAGMA trusted_schema = OFF')
    db.execute('PRAGMA cell_size_check = ON')
    if hasattr(db, 'setlimit'):         # Python 3.11
        db.setlimit(LIMIT_LENGTH, LONGEST)


def limit_steps(db: sqlite3.Connection, size: int) -> None:
    """
    Bound what statements cost from now on by the size of the file, bytes.

    sqlite3.OperationalError ('interrupted') ends what goes on for longer.

    """
    left = [(STEPS + STEPS_A_BYTE * size) // PER_CALL]

    def count() -> int:
        left[0] -= 1
        return int(left[0] < 0)

    db.set_progress_handler(count, PER_CALL)


def check_tables(db: sqlite3.Connection, tables: Mapping[str, Sequence[str]]) -> None:
    """
    Refuse (Unsafe) a database whose tables are not plain ones with the given columns.

    Parameters
    ----------
    db : sqlite3.Connection
        An open database.
    tables : mapping of str to sequence of str
        Their names and columns, in order.

    """
    for name, columns in tables.items():
        if columns_of(db, name) != list(columns):
            raise Unsafe(f'table {name} has other columns')


def check_declared(db: sqlite3.Connection, statements: str) -> None:
    """
    Refuse (Unsafe) a database that is declared in any other way than by some statements.

    Who writes obeys more than who reads: triggers, defaults, checks and indices of expressions
    are programs that run with every row.

    """
    expected = {' '.join(statement.split()) for statement in statements.split(';')}
    found = {' '.join(str(sql).split()) for sql, in db.execute(
        'SELECT sql FROM sqlite_master WHERE sql IS NOT NULL')}
    if found | {''} != expected | {''}:
        raise Unsafe('tables that are declared otherwise than persem_ros does')


def check_beside(path: Path) -> None:
    """Refuse (Unsafe) what SQLite would follow out of the folder when it writes a database."""
    for suffix in ('-wal', '-shm', '-journal'):
        beside = Path(f'{path}{suffix}')
        if beside.is_symlink():
            raise Unsafe(f'{beside.name} is a link')
    if (journal := journal_of(path)) is not None:
        with open(journal, 'rb') as file:
            file.seek(max(0, journal.stat().st_size - len(SUPER)))
            if file.read() == SUPER:
                raise Unsafe(f'{journal.name} names other files')


def journal_of(path: Path) -> Path | None:
    """Return the rollback journal beside a database, None where there is none with content."""
    journal = Path(f'{path}-journal')
    return journal if journal.is_file() and journal.stat().st_size else None


def columns_of(db: sqlite3.Connection, table: str) -> list[str]:
    """Return the columns of a plain table, none where there is no such table; else Unsafe."""
    entry = db.execute('SELECT type, sql FROM sqlite_master WHERE name = ?', (table,)).fetchall()
    if not entry:
        return []
    kinds = [kind for kind, _ in entry if kind != 'index']
    words = ' '.join(str(sql) for kind, sql in entry if kind != 'index').upper().split()
    if kinds != ['table'] or words[:2] != ['CREATE', 'TABLE']:
        raise Unsafe(f'{table} is no plain table')
    described = db.execute(f'PRAGMA table_xinfo("{table}")').fetchall()
    if any(row[6] for row in described):
        raise Unsafe(f'table {table} has computed columns')
    return [row[1] for row in described]


def checked(rows: Iterable[Sequence[Any]], kinds: Sequence[type | tuple[type, ...]],
            size: int) -> Iterator[Sequence[Any]]:
    """
    Yield rows with values of the types *kinds*, no more than a file of *size* bytes has room for.

    Raises
    ------
    Unsafe
        For a value of another type (NULL where bytes belong), and where the rows hold more than
        the file they come from.

    """
    held = 0
    for row in rows:
        held += 2
        for value, kind in zip(row, kinds):
            if not isinstance(value, kind):
                raise Unsafe(f'{type(value).__name__} in the place of '
                             f'{getattr(kind, "__name__", "another type")}')
            if isinstance(value, (bytes, str)):
                held += len(value)
        if held > size:
            raise Unsafe('more rows than the file has room for')
        yield row
