"""What map files of schema 1 did not have yet, and how it follows from what they had."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.pools import CENTRE
from persem_ros.core.memory.session import Session, session_uuid

# Of the table blocks; histories had t where they have the frame now.
COLUMNS = (
    ('cell', '<u2'), ('observations', '<u4'), ('switches', '<u4'), ('label', '<u2'),
    ('majority', '<u2'), ('last', '<u2'), ('source', 'u1'), ('dirty', 'u1'),
    ('evidence_count', '<u4'), ('history_count', '<u4'), ('evidence_class', '<u2'),
    ('evidence_sum', '<f8'), ('history_label', '<u2'), ('history_confidence', '<f4'),
    ('history_t', '<i4'))
# Columns of the tables and the types of their values.
NAMES = {'about': ('name', 'value'),
         'frames': ('row', 't', 'session', 'sensor', 'stamp', 'T_map_sensor'),
         'classes': ('id', 'starts', 'changes', 'seen', 'rho'),
         'blocks': ('x', 'y', 'z', 'voxels', 'crc', *(name for name, _ in COLUMNS))}
KINDS: dict[str, Sequence[type | tuple[type, ...]]] = {
    'about': (str, (int, float, str, bytes)), 'frames': (int, int, int, str, int, bytes),
    'classes': (int, int, int, int, float), 'blocks': (int,) * 5 + (bytes,) * len(COLUMNS)}


def frame_table(rows: list[tuple[int, int, int, str, int, bytes]]) -> FrameTable:
    """Return the FrameTable of the rows; the UUID of a session follows from its frames."""
    table = FrameTable()
    for _, t, session, sensor, stamp, pose in rows:
        table.append(t, session, sensor, stamp, np.frombuffer(pose, '<f8').reshape(4, 4))
    for number in np.unique(table.session).tolist():
        own = table.session == number
        table.sessions[number] = Session(
            session_uuid(table.stamp[own], table.sensor[own], table.placed[own]),
            {table.sensors[code]: np.eye(4) for code in np.unique(table.sensor[own])})
    return table


def added(columns: dict[str, NDArray[Any]], history_start: NDArray[np.int64],
          table: FrameTable) -> dict[str, NDArray[Any]]:
    """
    Return the columns that schema 2 adds.

    An observation's frame is the first with its t, its offset the voxel's middle; a voxel's
    first label is that of its oldest observation, where that was kept.

    Parameters
    ----------
    columns : dict
        Those of COLUMNS, of all voxels.
    history_start : ndarray, shape (n + 1,)
        Where each voxel's history begins.
    table : FrameTable
        The frames of the file.

    Raises
    ------
    ValueError
        Where an observation's t is in no frame.

    """
    times, rows = np.unique(table.t, return_index=True)
    t = columns['history_t']
    place = np.searchsorted(times, t).clip(0, max(0, len(times) - 1))
    if len(t) and (not len(times) or (times[place] != t).any()):
        raise ValueError('times')
    first = history_start[:-1]
    if len(first) and (first >= len(t)).any():
        raise ValueError('length of a column')
    return {'history_frame': rows[place].astype(np.int32) if len(t) else t,
            'history_offset': np.full((len(t), 3), CENTRE, np.uint8),
            'first_label': columns['history_label'][first],
            'gone': np.zeros(len(first), np.uint8),
            'posterior': np.zeros(len(first), np.float32),
            'passed': np.zeros(len(first), np.uint32),
            'passed_at': np.zeros(len(first), np.int64)}
