"""One .db3 file, whole or damaged: what is in it, and any message by its place."""

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
import os
from pathlib import Path
import shutil
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from persem_ros.guard.database import columns_of, harden, limit_steps, Unsafe
from persem_ros.inputs.recording.channels import Channel
from persem_ros.inputs.recording.packing import ZSTD
from persem_ros.inputs.recording.stamps import HEAD

NEEDED = {'topics': {'id', 'name', 'type', 'serialization_format'},
          'messages': {'id', 'topic_id', 'timestamp', 'data'}}
# Only bytes: of a text or NULL in their place nothing is read.
ONE = """SELECT data FROM messages WHERE id = ? AND typeof(data) = 'blob'"""
SIZES = """SELECT CASE typeof(data) WHEN 'blob' THEN length(data) ELSE 0 END FROM messages"""

LEAST_ROW = 8           # bytes of a message with what SQLite keeps of it
CUT = 64                # times what is left of a file that its messages may have been


class SqliteFile:
    """
    An open .db3 file.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    damage : list of str
        What is wrong with it, a few words each.
    journal : int
        Messages that were only in the write-ahead log beside it.
    channels : list of Channel
        With the numbers of their messages that can be read.

    Raises
    ------
    ValueError, sqlite3.Error
        Where it is no such file.

    """

    profile = 'ros2'

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []
        self.journal = 0
        self._copy: TemporaryDirectory[str] | None = None
        log = path.with_name(f'{path.name}-wal')
        self._base = self._beside_log(log) if log.exists() and log.stat().st_size \
            else _opened(path, 'immutable=1')
        try:
            if self._is_short():
                self._note('cut off')
            self.channels = self._described()
            if log.exists() and log.stat().st_size:
                self._count_log()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; a copy of it goes."""
        self._base.close()
        if self._copy is not None:
            self._copy.cleanup()

    def heads(self, numbers: Collection[int]) -> Iterator[tuple[int, int, int, bytes]]:
        """Walk over the messages of some channels as McapFile.heads does."""
        wanted = set(numbers)
        partly = hasattr(self._base, 'blobopen')    # Python 3.11; else whole messages are read
        for number, time, place, data in self._rows(
                'topic_id, timestamp, id, ' + ('NULL' if partly else 'data')):
            if number not in wanted or not isinstance(time, int):
                continue
            if partly:
                data = self._head(place)
            yield number, time, place, data

    def read(self, place: int) -> bytes:
        """Return the serialized message of a row, b'' where it cannot be read."""
        try:
            row = self._base.execute(ONE, (place,)).fetchone()
        except sqlite3.ProgrammingError:
            raise           # a mistake of ours, not damage
        except sqlite3.Error:
            self._note('damaged')
            return b''
        return row[0] if row and isinstance(row[0], bytes) else b''

    def _head(self, place: int) -> bytes:
        """Return the first bytes of a message; all of one that is compressed."""
        try:
            # Asked for on Python 3.11 and later only, see heads().
            with self._base.blobopen(       # type: ignore[attr-defined]
                    'messages', 'data', place, readonly=True) as blob:
                head = bytes(blob.read(HEAD))
        except sqlite3.Error:
            return b''
        return self.read(place) if head[:4] == ZSTD else head

    def _described(self) -> list[Channel]:
        # Without this SQLite refuses a file that is shorter than its header says.
        self._base.execute('PRAGMA writable_schema=ON')
        self._check_tables()
        topics = self._base.execute(
            'SELECT id, name, type, serialization_format FROM topics').fetchall()
        counts = Counter(row[0] for row in self._rows('topic_id'))
        return [Channel(number, str(name), str(kind), counts[number], str(form))
                for number, name, kind, form in topics]

    def _check_tables(self) -> None:
        """Refuse (ValueError) what no recorder makes: views, computed columns, shared pages."""
        for table, needed in NEEDED.items():
            columns = columns_of(self._base, table)
            if not needed <= set(columns):
                raise Unsafe(f'no table {table} with {", ".join(sorted(needed))}')
        # Rows are asked for by id, which must not mean a walk over the whole table each time.
        keys = [(row[1], row[2].upper()) for row in self._base.execute(
            'PRAGMA table_info(messages)') if row[5]]
        if keys != [('id', 'INTEGER')]:
            raise Unsafe('messages without a key')
        # A file that is cut off speaks of more than is left of it.
        held, room = 0, max(self._size(), min(self._stated(), CUT * self._size()))
        with suppress(sqlite3.Error):       # as far as it goes
            for size, in self._base.execute(SIZES):
                held += size
                if held > room:
                    raise Unsafe('messages of more bytes than the file has')

    def _size(self) -> int:
        """Return the bytes of the file and of its log."""
        folder = self.path.parent if self._copy is None else Path(self._copy.name)
        names = [self.path] if self._copy is None else list(folder.iterdir())
        return sum(name.stat().st_size for name in names)

    def _rows(self, columns: str) -> Iterator[tuple[Any, ...]]:
        # By row id, not by time: the index on time is the first thing that a cut destroys.
        limit_steps(self._base, self._size())
        rows = self._base.execute(f'SELECT {columns}, id FROM messages ORDER BY id')
        before = -1 << 63
        # In a damaged file pages may lead back to themselves: more rows than bytes.
        for _ in range(self._size() // LEAST_ROW):
            try:
                row = rows.fetchone()
            except sqlite3.ProgrammingError:
                raise
            except sqlite3.Error:
                self._note('cut off')
                return
            if row is None:
                return
            if row[-1] > before:
                before = row[-1]
                yield row[:-1]
            else:
                self._note('damaged')
        self._note('damaged')

    def _is_short(self) -> bool:
        """Whether the file has fewer pages than it says; one with a log need not be whole."""
        return self._copy is None and self.path.stat().st_size < self._stated()

    def _stated(self) -> int:
        """Return the bytes that the file's header speaks of."""
        with self.path.open('rb') as stream:
            head = stream.read(100)
        page = int.from_bytes(head[16:18], 'big')
        pages = int.from_bytes(head[28:32], 'big') if head[24:28] == head[92:96] else 0
        return pages * (65536 if page == 1 else page)

    def _beside_log(self, log: Path) -> sqlite3.Connection:
        """
        Return the file open with its write-ahead log; of both a copy, lest anything be changed.

        A recorder that was killed leaves the newest messages there, and SQLite would move them
        into the file, or, where it may not write, read without them.

        """
        self._copy = TemporaryDirectory(prefix='persem-')
        copy = Path(self._copy.name) / 'recording.db3'
        try:
            shutil.copyfile(self.path, copy)
            shutil.copyfile(log, copy.with_name(f'{copy.name}-wal'))
            base = _opened(copy, 'mode=rw')
            base.execute('SELECT count(*) FROM sqlite_master').fetchone()
            return base
        except (OSError, sqlite3.Error):
            self._copy.cleanup()
            self._copy = None
            self._note(f'beside {log.name}, which cannot be read')
            return _opened(self.path, 'immutable=1')

    def _count_log(self) -> None:
        """Count the messages that the file itself does not have."""
        alone = 0
        with suppress(sqlite3.Error), closing(_opened(self.path, 'immutable=1')) as base:
            alone = base.execute('SELECT count(*) FROM messages').fetchone()[0]
        self.journal = max(0, sum(channel.count for channel in self.channels) - alone)

    def _note(self, text: str) -> None:
        if text not in self.damage:
            self.damage.append(text)


def _opened(path: Path, mode: str) -> sqlite3.Connection:
    base = sqlite3.connect(f'file:{quote(os.fsencode(path.absolute()))}?{mode}', uri=True,
                           check_same_thread=False)
    harden(base)
    limit_steps(base, path.stat().st_size)
    return base
