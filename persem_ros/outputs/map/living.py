"""
A map file that is written while it is mapped: the store of core.memory.paging (spec section 9).

SQLite's write-ahead log lets readers go on beside the one writer, who adds what changed in one
transaction: after whatever end the file holds one state whole. At a clean end the log is gone.

"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import logging
import os
from pathlib import Path
import sqlite3
import threading
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.loading import take_over
from persem_ros.core.memory.pools import OBSERVATIONS
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.guard.database import check_declared, checked, harden, held_by
from persem_ros.outputs.map import store
from persem_ros.outputs.map.checks import check_blocks, FARTHEST_BLOCK
from persem_ros.outputs.map.habits import to_blob
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.rows import (
    about_rows, block_rows, blocks_of, crc_of, frame_columns, frame_rows, small_rows)
from persem_ros.outputs.map.tables import COLUMNS, KINDS, NAMES, TABLES
from persem_ros.settings import config_file
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)
DAMAGED = ValueError, TypeError, IndexError, OverflowError
PLACE = 'x = ? AND y = ? AND z = ?'
OBSERVED = [name for name, _ in COLUMNS].index('observations')


class LivingMap:
    """
    The writer of a map file.

    read() and index() belong to one thread, write() may be called by another.

    Parameters
    ----------
    path : Path
        The file; made where there is none.
    config : Config
        Settings in force; refused where voxels of these would not fit the map's.
    legend : callable
        legend() gives names and colours of the classes.
    durable : bool
        Have each write on the disk before it counts as done; else only a process may be killed.

    Attributes
    ----------
    stored_legend : Legend
        The file's own when it was opened.
    damaged : set
        Indices of blocks that could not be read; they count as never observed.

    """

    _writer: sqlite3.Connection
    _reader: sqlite3.Connection

    def __init__(self, path: Path, config: Config, legend: Callable[[], Legend],
                 durable: bool = True) -> None:
        self.path, self.config, self.legend = path, config, legend
        self._durable = durable
        self.damaged: set[tuple[int, ...]] = set()
        self._said: tuple[Config | None, str] = None, ''
        self._writing = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = WriterLock(path)
        try:
            self._begin()
            self._checked([])       # its kernel is there before the first frame waits for it
        except BaseException:
            self._lock.close()
            raise

    def memory(self) -> VoxelMemory:
        """
        Return a memory without blocks that goes on, in a new session, where the map stands.

        Once.

        """
        saved = self._state
        del self._state
        memory = VoxelMemory(saved.voxel_size, saved.origin, self.config.memory.max_history)
        memory.keeps_all = True
        take_over(memory, saved)
        self._frames = memory.frames
        self._frames.attach(self.frames)
        memory.m.used[OBSERVATIONS] = self._about['observations']
        memory.new_session()
        return memory

    @property
    def voxels(self) -> int:
        """Return how many voxels the file holds."""
        return self.counts['voxels']

    @property
    def counts(self) -> dict[str, int]:
        """Return how many blocks, voxels and observations the file holds, by these names."""
        return {name: int(self._about[name]) for name in ('blocks', 'voxels', 'observations')}

    def index(self) -> NDArray[np.int32]:
        """Return the indices of all blocks, (n, 3) int32, ascending."""
        # What is no place of a block is passed over: numbers beyond int32, text, fractions.
        ours = ' AND '.join(f"{x} BETWEEN ?1 AND ?2 AND typeof({x}) = 'integer'" for x in 'xyz')
        rows = self._reader.execute(
            f'SELECT DISTINCT x, y, z FROM blocks WHERE {ours} ORDER BY x, y, z',
            (-FARTHEST_BLOCK, FARTHEST_BLOCK)).fetchall()
        return np.array(rows, np.int32).reshape(-1, 3)

    def read(self, index: NDArray[np.int32]) -> Blocks:
        """Return those of the blocks with the given, ascending, indices (n, 3) that are there."""
        try:
            found = [self._reader.execute(f'SELECT * FROM blocks WHERE {PLACE}', key).fetchall()
                     for key in index.tolist() if tuple(key) not in self.damaged]
        except sqlite3.Error as error:
            raise PersemError(f'{self.path} cannot be read ({error})') from error
        for several in (rows for rows in found if len(rows) > 1):
            self._leave_out(several[0], 'a block twice')
        rows = [rows[0] for rows in found if len(rows) == 1]
        try:
            return self._checked(rows)
        except DAMAGED:
            return self._checked([row for row in rows if self._whole(row)])

    def frames(self, first: int, end: int) -> tuple[Any, ...]:
        """Return rows of the frame table, as core.memory.frame_pages.Fetch says."""
        try:
            rows = self._reader.execute('SELECT * FROM frames WHERE row >= ? AND row < ? '
                                        'ORDER BY row', (first, end)).fetchall()
            return frame_columns(list(checked(rows, KINDS['frames'], held_by(self.path))))
        except (sqlite3.Error, *DAMAGED) as error:
            raise PersemError(f'{self.path} cannot be read ({error})') from error

    def write(self, changed: MemoryDump) -> None:
        """
        Take the blocks, counters and frames of a dump over, in one transaction.

        Raises
        ------
        PersemError
            When that is not possible; the file is as it was.

        """
        with self._writing:
            db = self._writer
            try:
                db.execute('BEGIN IMMEDIATE')
                about, crc = self._enter(db, changed)
                db.execute('COMMIT')
            except (sqlite3.Error, *DAMAGED) as error:
                with suppress(sqlite3.Error):
                    db.execute('ROLLBACK')
                raise PersemError(f'{self.path} cannot be written ({error})') from error
            self.damaged -= set(map(tuple, changed.block_index.tolist()))   # mapped anew
            self._about, self._frames_crc, self._n_frames = about, crc, len(changed.frames)
            self._frames, self._seen = changed.frames, changed.seen_ids

    def close(self) -> None:
        """Leave one whole file without a log beside it, where the disk allows that."""
        try:
            for statement in ('PRAGMA wal_checkpoint(TRUNCATE)', 'PRAGMA journal_mode = DELETE'):
                self._reader.close()
                self._writer.execute(statement).fetchall()
        except sqlite3.Error as error:
            log.warning('%s: its log stays beside it (%s); keep the two together', self.path,
                        error)
        self._writer.close()
        self._lock.close()

    def _begin(self) -> None:
        """Open the file, or a new one; read all but its blocks."""
        path = self.path
        if not path.exists():
            empty = VoxelMemory(self.config.memory.voxel_size, self.config.map.origin)
            store.save(path, empty, self.config)
        store.declared_as_ours(path)
        head = store.head(path)
        head.stored.check_fits(self.config)
        self._state, self._about = head.stored.saved, head.about
        self.stored_legend = head.stored.legend
        self._n_frames = len(self._state.frames)
        self._frames_crc = self._about['frames_crc']
        self._frames, self._seen = self._state.frames, self._state.seen_ids
        try:
            self._writer = _connected(path)
            self._writer.execute('PRAGMA journal_mode = WAL').fetchall()
            self._writer.execute(f'PRAGMA synchronous = {"FULL" if self._durable else "OFF"}')
            self._reader = _connected(path)
        except (sqlite3.Error, ValueError) as error:
            raise PersemError(f'{path} cannot be attached ({error}); copy it to a disk that can '
                              'be written, or go without map.attached') from error

    def _enter(self, db: sqlite3.Connection, changed: MemoryDump) -> tuple[dict[str, Any], int]:
        """Write all rows; return the new table about and the frame table's checksum."""
        counts = self.counts
        places, mended = ', '.join('?' * len(NAMES['blocks'])), False
        for row in block_rows(changed):
            if row[:3] in self.damaged:     # what lies there is not what was counted
                db.execute(f'DELETE FROM blocks WHERE {PLACE}', row[:3])
                mended = True
            old = db.execute(f'SELECT voxels, observations FROM blocks WHERE {PLACE}',
                             row[:3]).fetchone()
            counts['blocks'] += old is None
            counts['voxels'] += row[3] - (old[0] if old else 0)
            counts['observations'] += _observed(row[5 + OBSERVED]) - (
                _observed(old[1]) if old else 0)
            db.execute(f'INSERT OR REPLACE INTO blocks VALUES ({places})', row)
        if mended:
            counts = _counted(db)
        crc = self._frames_crc
        for row in frame_rows(changed.frames, self._n_frames):
            db.execute(f'INSERT INTO frames VALUES ({", ".join("?" * len(row))})', row)
            crc = crc_of([row], crc)
        small = small_rows(changed)
        for table, rows in small.items():
            db.execute(f'DELETE FROM {table}')
            db.executemany(f'INSERT INTO {table} VALUES ({", ".join("?" * len(NAMES[table]))})',
                           rows)
        about = {**self._about, **counts, 'session': changed.session, 'frames_crc': crc,
                 'refined': int(changed.rho is not None),
                 'settings': self._settings(), 'legend': self.legend().to_yaml()}
        about.pop('habits', None)
        if changed.habits and changed.fitted_by is not None:
            about['habits'] = to_blob(changed.habits, changed.fitted_by)
        about['crc'] = crc_of(about_rows(about, small))
        db.execute("DELETE FROM about WHERE name = 'habits'")
        db.executemany('INSERT OR REPLACE INTO about VALUES (?, ?)', about.items())
        return about, crc

    def _settings(self) -> str:
        """Return the settings in force as YAML, which takes 10 ms, made where they are new."""
        if self._said[0] is not self.config:
            self._said = self.config, config_file.to_yaml(self.config)
        return self._said[1]

    def _checked(self, rows: list[Any]) -> Blocks:
        """Return what rows hold; raise one of DAMAGED where they are not as they were written."""
        for row in rows:
            if not all(isinstance(value, kind) for value, kind in zip(row, KINDS['blocks'])):
                raise TypeError('a value of another type')
        blocks = blocks_of(rows)
        f = blocks.history_frame
        self._frames.bring(f[(f >= 0) & (f < len(self._frames))])
        check_blocks(blocks, self._frames.here('t'), self._seen)
        return blocks

    def _whole(self, row: tuple[Any, ...]) -> bool:
        """Return whether a block is as it was written; say so once where it is not."""
        try:
            self._checked([row])
            return True
        except DAMAGED as error:
            self._leave_out(row, error)
            return False

    def _leave_out(self, row: tuple[Any, ...], why: object) -> None:
        """Read the block of this row no more."""
        self.damaged.add(tuple(row[:3]))
        log.warning('%s: block %s is damaged (%s) and left out; the rest of the map lives',
                    self.path, row[:3], why)


def _connected(path: Path) -> sqlite3.Connection:
    """Return a connection that may write."""
    db = sqlite3.connect(f'file:{quote(os.fsencode(path.resolve()))}?mode=rw', uri=True,
                         isolation_level=None, check_same_thread=False)
    harden(db)
    check_declared(db, TABLES)
    return db


def _counted(db: sqlite3.Connection) -> dict[str, int]:
    """Return what the table about has of the blocks, from the blocks."""
    rows = db.execute('SELECT voxels, observations FROM blocks')
    counts = dict.fromkeys(('blocks', 'voxels', 'observations'), 0)
    for voxels, column in rows:
        if type(voxels) is not int or type(column) is not bytes or len(column) % 4:
            continue            # another damaged one
        for name, value in zip(counts, (1, voxels, _observed(column))):
            counts[name] += value
    return counts


def _observed(column: bytes) -> int:
    """Return the sum of a block's column 'observations'."""
    return int(np.frombuffer(column, '<u4').sum(dtype=np.int64))
