"""The rows of a map file: a MemoryDump as tables, and back (docs/map_file.md)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import chain
import struct
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.capture import Parts
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import CELLS
from persem_ros.core.memory.session import Session
from persem_ros.frames import MAX_ID
from persem_ros.outputs.map import schema1
from persem_ros.outputs.map.checks import check_about, check_dump, check_head
from persem_ros.outputs.map.habits import from_blob, to_blob
from persem_ros.outputs.map.tables import AXES, COLUMNS, COUNTS, EVIDENCE, HISTORY, SPARSE, VOXEL


def to_rows(saved: MemoryDump | Parts, texts: dict[str, str]) -> dict[str, Any]:
    """
    Return {table: iterable of rows} of a map file, in the order of ORDER.

    Parameters
    ----------
    saved : MemoryDump or Parts
        The map; parts of it are copied as their rows are asked for.
    texts : dict
        settings, map_frame and legend, for the table about.

    """
    if isinstance(saved, Parts):
        head = saved.head
        blocks: Iterable[tuple[Any, ...]] = chain.from_iterable(map(block_rows, saved))
        sizes = saved.blocks, saved.voxels, saved.observations
    else:
        head, blocks = saved, block_rows(saved)
        sizes = (len(saved.block_index), len(saved.cell),
                 int(saved.observations.sum(dtype=np.int64)))
    about = {**texts, 'session': head.session,
             **dict(zip(('blocks', 'voxels', 'observations'), sizes))}
    return whole_rows(head, about, list(frame_rows(head.frames)), blocks)


def whole_rows(saved: MemoryDump, about: dict[str, Any], frames: Iterable[Any],
               blocks: Iterable[Any]) -> dict[str, Any]:
    """
    Return to_rows() of a map whose frames and blocks need not be in memory.

    Parameters
    ----------
    saved : persem_ros.core.memory.dump.MemoryDump
        All of it but these.
    about : dict
        What to_rows() has in its texts, and session, blocks, voxels and observations.
    frames, blocks : iterable of rows
        In their order; *frames* can be gone through twice.

    """
    about = {**about, 'origin': struct.pack('<3d', *saved.origin),
             'voxel_size': saved.voxel_size, 'max_history': saved.max_history,
             'refined': int(saved.rho is not None)}
    if saved.habits and saved.fitted_by is not None:
        about['habits'] = to_blob(saved.habits, saved.fitted_by)
    small = small_rows(saved)
    about['frames_crc'] = crc_of(frames)
    about['crc'] = crc_of(about_rows(about, small))
    return {'about': sorted(about.items()), **small, 'frames': frames, 'blocks': blocks}


def small_rows(saved: MemoryDump) -> dict[str, Any]:
    """Return {table: rows} of the smallest tables but 'about'."""
    return {'sessions': [(number, session.uuid)
                         for number, session in sorted(saved.frames.sessions.items())],
            'mounts': list(_mount_rows(saved)), 'classes': list(_class_rows(saved))}


def about_rows(about: dict[str, Any], tables: dict[str, Any]) -> list[Any]:
    """
    Return the rows that about's 'crc' covers: about's own and those of the smallest tables.

    The frame table has a checksum of its own, 'frames_crc', which goes on where rows are added.

    """
    return [*sorted((name, value) for name, value in about.items() if name != 'crc'),
            *(row for name in ('sessions', 'mounts', 'classes') for row in tables[name])]


def _mount_rows(saved: MemoryDump) -> Iterator[tuple[int, str, bytes]]:
    """Yield the rows of the table mounts."""
    for number, session in sorted(saved.frames.sessions.items()):
        for sensor, mount in sorted(session.mounts.items()):
            yield number, sensor, _matrix(mount)


def frame_rows(table: FrameTable, first: int = 0) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the table frames from row *first* on, in the order of integration."""
    for row in range(first, len(table)):
        frame = table[row]
        placed, best = _matrix(frame.T_map_sensor), _matrix(frame.T_map_best)
        yield (row, frame.t, frame.session, frame.sensor, frame.stamp, placed,
               None if best == placed else best)


def _matrix(T: NDArray[np.float64]) -> bytes:
    """Return a 4x4 matrix as bytes."""
    return np.ascontiguousarray(T, '<f8').tobytes()


def _class_rows(saved: MemoryDump) -> Iterator[tuple[float, ...]]:
    """Yield the rows of the table classes: ids that were ever counted."""
    rho = np.zeros(len(saved.starts)) if saved.rho is None else np.asarray(saved.rho)
    for c in np.flatnonzero((saved.starts != 0) | (saved.changes != 0) | (saved.seen_ids != 0)):
        yield (int(c), int(saved.starts[c]), int(saved.changes[c]), int(saved.seen_ids[c]),
               float(rho[c]))


def block_rows(saved: MemoryDump) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the table blocks, sorted by index: integers, then views."""
    arrays = {field.name: getattr(saved, field.name) for field in fields(saved)}
    arrays['evidence_count'] = np.diff(saved.evidence_start)
    arrays['history_count'] = np.diff(saved.history_start)
    columns = [np.ascontiguousarray(arrays[name], kind) for name, kind in COLUMNS]
    views = [column.reshape(-1).view(np.uint8).data for column in columns]
    sizes = [column.itemsize * AXES.get(name, 1) for column, (name, _) in zip(columns, COLUMNS)]
    borders = saved.block_start, saved.evidence_start[saved.block_start], \
        saved.history_start[saved.block_start]
    which = [borders[0]] * (len(VOXEL) + len(COUNTS)) + [borders[1]] * len(EVIDENCE) + \
        [borders[2]] * len(HISTORY) + [borders[0]] * len(SPARSE)
    edges = [(border * size).tolist() for border, size in zip(which, sizes)]
    index, rows = saved.block_index.tolist(), np.diff(saved.block_start).tolist()
    looks = np.diff(np.concatenate([[0], np.cumsum(saved.passed > 0)])[saved.block_start])
    for b, (x, y, z) in enumerate(index):
        data: list[bytes | memoryview] = [
            view[edge[b]:edge[b + 1]] for view, edge in zip(views, edges)]
        if not looks[b]:
            data[-len(SPARSE):] = [b''] * len(SPARSE)
        key = x, y, z, rows[b]
        yield (*key, crc_of([(*key, *data)]), *data)


def from_rows(rows: dict[str, Any], part: bool = False,
              ) -> tuple[dict[str, Any], MemoryDump]:
    """
    Return what the rows of a map file say.

    Parameters
    ----------
    rows : dict
        {table: list of rows}, sorted as ORDER says; of schema 1, where there are no sessions;
        without blocks, where there is no such table.
    part : bool
        Whether the rows of blocks are some of them only.

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
    about = about_of(rows)
    frames, classes, blocks = rows['frames'], rows['classes'], rows.get('blocks', [])
    first = 'sessions' not in rows      # of schema 1
    columns = _columns(blocks, first)
    table = schema1.frame_table(frames) if first else \
        _frame_table(frames, rows['sessions'], rows['mounts'])
    if first:
        columns |= schema1.added(columns, columns['history_start'], table)
        del columns['history_t']
    habits: dict[str, Any] = {} if 'habits' not in about else dict(zip(
        ('habits', 'fitted_by'), from_blob(about['habits'])))
    saved = MemoryDump(
        **columns, voxel_size=about['voxel_size'], origin=struct.unpack('<3d', about['origin']),
        max_history=about['max_history'], session=about['session'],
        **_counters(classes, about['refined']), frames=table, **habits)
    if 'blocks' in rows:
        check_dump(saved, None if part else about)
    else:
        check_head(saved)
    return about, saved


def blocks_of(rows: list[Any]) -> Blocks:
    """Return what some rows of the table blocks hold; ValueError where a checksum differs."""
    return Blocks(**_columns(rows, False))


def _columns(blocks: list[Any], first: bool) -> dict[str, Any]:
    """Return the columns of a MemoryDump that are in rows of the table blocks."""
    columns = columns_of(blocks, first)
    return {'block_index': np.array([row[:3] for row in blocks], np.int32).reshape(-1, 3),
            'block_start': _starts([row[3] for row in blocks]),
            'evidence_start': _starts(columns.pop('evidence_count')),
            'history_start': _starts(columns.pop('history_count')), **columns}


def _counters(classes: list[Any], refined: int) -> dict[str, Any]:
    """Return the class counters of a MemoryDump."""
    counts = {name: np.zeros(MAX_ID + 2, kind) for name, kind in (
        ('starts', np.int64), ('changes', np.int64), ('seen_ids', np.uint8),
        ('rho', np.float64))}
    ids = [row[0] for row in classes]
    if ids and not 0 <= min(ids) <= max(ids) <= MAX_ID:
        raise ValueError('ids of the classes')
    for k, column in enumerate(counts.values(), 1):
        column[ids] = [row[k] for row in classes]
    return counts if refined else {**counts, 'rho': None}


def about_of(rows: dict[str, Any]) -> dict[str, Any]:
    """Return {name: value} of the table about; ValueError where a small table is damaged."""
    about, first = dict(rows['about']), 'sessions' not in rows
    covered = [*sorted((name, value) for name, value in about.items() if name != 'crc'),
               *rows['frames'], *rows['classes']] if first else about_rows(about, rows)
    if about.pop('crc') != crc_of(covered):
        raise ValueError('checksum of the small tables')
    if not first and about.pop('frames_crc') != crc_of(rows['frames']):
        raise ValueError('checksum of the frame table')
    check_about(about)
    return about


def columns_of(blocks: list[Any], first: bool) -> dict[str, NDArray[Any]]:
    """Return the columns of blocks (of schema 1: *first*); ValueError for a damaged one."""
    for row in blocks:
        if row[4] != crc_of([(*row[:4], *row[5:])]):
            raise ValueError(f'checksum of block {row[:3]}')
        if not 0 < row[3] <= CELLS:
            raise ValueError('number of voxels')
    columns = {name: np.frombuffer(bytearray().join(row[5 + k] for row in blocks), kind)
               for k, (name, kind) in enumerate(
                   schema1.COLUMNS if first else COLUMNS[:-len(SPARSE)])}
    for k, (name, kind) in enumerate(() if first else SPARSE, len(columns)):
        columns[name] = np.frombuffer(bytearray().join(
            b''.join(row[5 + k:6 + k]) or bytes(row[3] * np.dtype(kind).itemsize)
            for row in blocks), kind)
    for name, axes in AXES.items():
        if name in columns:
            columns[name] = columns[name].reshape(-1, axes)
    return columns


def _frame_table(frames: list[Any], sessions: list[Any], mounts: list[Any]) -> FrameTable:
    """Return the FrameTable in the rows of three tables."""
    table = FrameTable()
    if [row[0] for row in frames] != list(range(len(frames))):
        raise ValueError('rows of the frame table')
    table.extend(*frame_columns(frames))
    table.sessions.update((number, Session(uuid, {})) for number, uuid in sessions)
    for number, name, mount in mounts:
        table.sessions[number].mounts[name] = matrices([mount])[0]
    return table


def frame_columns(frames: list[Any]) -> tuple[Any, ...]:
    """Return t, session, sensor names, stamp, placed and best (None: as placed) of rows."""
    _, t, session, sensor, stamp, placed, best = zip(*frames) if frames else [()] * 7
    moved = [b if b is not None else p for p, b in zip(placed, best)] if any(best) else None
    return (np.array(t, np.int32), np.array(session, np.int64), list(sensor),
            np.array(stamp, np.int64), matrices(placed),
            None if moved is None else matrices(moved))


def matrices(blobs: Sequence[bytes]) -> NDArray[np.float64]:
    """Return the n 4x4 matrices that are in *blobs*."""
    return np.frombuffer(b''.join(blobs), '<f8').reshape(len(blobs), 4, 4).copy()


def crc_of(rows: Iterable[Iterable[Any]], crc: int = 0) -> int:
    """Return the CRC-32 of rows of numbers, texts and bytes, which goes on from *crc*."""
    for row in rows:
        for value in row:
            data = value if isinstance(value, (bytes, memoryview)) else f'{value!r};'.encode()
            crc = zlib.crc32(data, crc)
    return crc


def _starts(counts: NDArray[np.uint32] | list[int]) -> NDArray[np.int64]:
    """Return 0 and the running sums of counts, int64."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64)
