"""The satellite fixes of a recording (sensor_msgs/NavSatFix) or of a table in a text file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.messages import BadMessage, stamp_ns
from persem_ros.inputs.recording.source import Source

NAVSATFIX = 'sensor_msgs/msg/NavSatFix'
NO_FIX = -1                 # NavSatStatus.STATUS_NO_FIX
LATEST = 1 << 31            # s since 1970: a header's seconds are int32
COLUMNS = 'stamp,latitude,longitude,altitude'
Table = tuple[NDArray[np.int64], NDArray[np.float64]]
EXPECTED = (f'expected a line a fix with the columns {COLUMNS}: seconds, degrees (WGS 84), metres '
            'above the ellipsoid')


def read_fixes(path: Path | str, topic: str = '') -> Table:
    """
    Return the fixes of a recording, or of a text file with COLUMNS in its first line.

    Parameters
    ----------
    path : str or Path
        A rosbag2 recording, or a file whose name ends in .csv or .txt.
    topic : str
        Where a recording has several of NavSatFix.

    Returns
    -------
    stamps : ndarray, shape (n,), int64
        Nanoseconds.
    values : ndarray, shape (n, 3), float64
        Latitude, longitude (degrees, WGS 84), altitude (metres above the ellipsoid).

    Raises
    ------
    PersemError
        For a recording without fixes or with several topics of them, and a file that is no
        table.

    """
    if Path(path).suffix.lower() in ('.csv', '.txt'):
        return _table(Path(path))
    with Source(path) as source:
        names = [t.name for t in source.topics if t.msgtype == NAVSATFIX]
        wanted = [n for n in names if not topic or n.strip('/') == topic.strip('/')]
        if len(wanted) != 1:
            raise PersemError(
                f'{path}: ' + (f'no topic {topic} of {NAVSATFIX}' if topic else
                               f'several topics of {NAVSATFIX}' if names else
                               f'no topic of {NAVSATFIX}')
                + (f'; there are {", ".join(names)}: choose one with --topic' if names else
                   f'; give a recording with one, or a table ({COLUMNS}) as .csv'))
        rows = []
        for _, kind, _, data in source.messages(wanted):
            try:
                msg = source.decode(data, kind)
            except BadMessage:
                continue
            if msg.status.status != NO_FIX:
                rows.append((stamp_ns(msg), msg.latitude, msg.longitude, msg.altitude))
    return _packed(rows)


def _table(path: Path) -> Table:
    """Return the fixes of a text file."""
    try:
        lines = path.read_text(encoding='utf-8').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PersemError(f'{path}: cannot be read ({error}); {EXPECTED}') from None
    rows = []
    for number, line in enumerate(lines, 1):
        fields = [text.strip() for text in line.split(',')]
        if number == 1 and fields[:4] == COLUMNS.split(',') or not line.strip():
            continue
        try:
            stamp, rest = _nanoseconds(fields[0]), tuple(map(float, fields[1:4]))
            if len(rest) != 3 or not 0 <= stamp < LATEST * 10 ** 9:
                raise ValueError
        except (ValueError, IndexError):
            raise PersemError(f'{path}, line {number}: {line[:60]!r}; {EXPECTED}') from None
        rows.append((stamp, *rest))
    return _packed(rows)


def _nanoseconds(text: str) -> int:
    """Return seconds in decimal digits as nanoseconds, exactly."""
    whole, _, part = text.partition('.')
    return int(whole) * 1_000_000_000 + int((part + '000000000')[:9])


def _packed(rows: list[tuple[int, float, float, float]]) -> Table:
    """Return rows as read_fixes gives them."""
    return (np.array([row[0] for row in rows], np.int64),
            np.array([row[1:] for row in rows], np.float64).reshape(-1, 3))
