"""The report of persem info as plain text."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from shlex import join
from typing import TYPE_CHECKING

from persem_ros.preflight.findings import NOTE, of_severity, WARN

if TYPE_CHECKING:
    from persem_ros.inputs.recording.source import Source
    from persem_ros.inputs.recording.topics import Choice
    from persem_ros.preflight.contents import Row
    from persem_ros.preflight.findings import Finding

COLUMNS = ('topic', 'type', 'messages', 'Hz', 'encoding', 'size', 'frame', 'first', 'last', '')
PLAUSIBLE = range(10**17, 10**19)      # ns since 1970 that are dates; others are shown as seconds


def text(source: Source, rows: Sequence[Row], choice: Choice, lacking: Sequence[str],
         found: Sequence[Finding] = (), counts: Sequence[tuple[int, int]] = (),
         words: Sequence[str] = (), warned: Sequence[str] = (),
         ids: Sequence[str] = ()) -> str:
    """
    Return the report.

    Parameters
    ----------
    source, rows, choice
        The source, its survey and the choice of topics.
    lacking
        Why a replay would be refused, sentences with flags.
    found
        What the checks found.
    counts
        How many label images of each camera a replay would use, and of how many.
    words
        The options of the replay, '--set', 'a=b', ….
    warned
        What the warnings propose besides.
    ids
        Lines that name the ids of each camera's labels.

    Returns
    -------
    str
        Lines of plain text.

    """
    # The recorder's clock and that of the headers.
    starts = (min((row.recorded for row in rows if row.recorded is not None), default=0),
              min((row.first for row in rows if row.first and row.stamped), default=0))
    stamped = any(row.stamped and row.first for row in rows)
    start = starts[stamped]
    end = max((row.last for row in rows if row.last and row.stamped == stamped), default=0)
    total = sum(row.count for row in rows)
    lines = [f'{source.path}: {source.storage}, {_bytes(source.size)}, {total} messages',
             f'from {_date(start)} to {_date(end)} ({(end - start) / 1e9:.1f} s)', '']
    lines += _table([COLUMNS, *(_cells(row, starts[row.stamped]) for row in rows)]) + ['']
    lines += [f'note: {note}' for note in source.notes]
    for camera, chosen in choice.cameras.items():
        lines.append(f'a replay would use{f" for camera {camera}" if camera else ""}:')
        lines += [f'  {kind:<12} {topic.name} ({_short(topic.msgtype)})'
                  for kind, topic in chosen.items()]
    lines += [f'  {kind:<12} {topic.name}' for kind, topics in (
        ('tf', choice.tf if 'pose' not in next(iter(choice.cameras.values())) else []),
        ('tf_static', choice.tf_static), ('legend', choice.legends)) for topic in topics]
    lines += ids
    lines += [f'{f.severity}: {f.text()}' for f in of_severity(found, NOTE, WARN)]
    lines += [f'{used} of {total} label images find depth and pose' for used, total in counts]
    lines += [f'missing: {sentence}' for sentence in lacking]
    lines.append('not usable as it is' if lacking else 'usable: ' + join(
        ['persem', 'replay', str(source.path), '--out', 'DIR', *words]))
    if warned and not lacking:
        lines.append('or, where the warnings are right: ' + join(
            ['persem', 'replay', str(source.path), '--out', 'DIR', *words, *warned]))
    return '\n'.join(lines) + '\n'


def _cells(row: Row, start: int) -> Sequence[str]:
    remarks = [f'{n} {what}' for n, what in ((row.back, 'stamps go back'),
                                             (row.repeated, 'stamps repeat')) if n]
    times = [f'{(stamp - start) / 1e9:+.3f}' if stamp is not None else ''
             for stamp in (row.first, row.last)]
    rate = f'{row.rate:.1f}' if row.rate else ''
    return (row.name, _short(row.msgtype), str(row.count), rate, row.encoding, row.size, row.frame,
            *times, ', '.join(remarks))


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the rows as aligned lines; numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    right = {COLUMNS.index(name) for name in ('messages', 'Hz', 'first', 'last')}
    return ['  '.join(cell.rjust(width) if i in right else cell.ljust(width)
                      for i, (cell, width) in enumerate(zip(row, widths))).rstrip()
            for row in rows]


def _short(kind: str) -> str:
    return kind.rpartition('/')[2]


def _bytes(size: float) -> str:
    if size < 1000:
        return f'{size:.0f} bytes'
    for unit in ('kB', 'MB'):
        size /= 1000
        if size < 1000:
            return f'{size:.1f} {unit}'
    return f'{size / 1000:.1f} GB'


def _date(stamp: int) -> str:
    """Return a stamp as UTC; simulated clocks start in 1970 and are shown as seconds."""
    if stamp not in PLAUSIBLE:
        return f'{stamp / 1e9:.3f} s'
    return datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime('%Y-%m-%d %H:%M:%S UTC')
