"""
Rows of a frame table that left memory, for a store has them (spec section 9).

A column keeps its place in the address space; pages of it go back to the operating system and
are filled again where a row of theirs is needed, so that row f is always the f-th.
"""

from __future__ import annotations

from collections.abc import Callable
import mmap
from typing import Any, TYPE_CHECKING
import zlib

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from persem_ros.core.memory.dump import Blocks

PAGE = 1024         # rows that leave and come back together: 150 kB
Columns = list[NDArray[Any]]
# fetch(first, end) gives t, session, sensor names, stamp, placed and best (None: as placed).
Fetch = Callable[[int, int], tuple[Any, ...]]


class FramePages:
    """
    Which pages of a frame table's columns are away.

    Copies of a table share its columns, hence this, too.

    Parameters
    ----------
    fetch : callable
        fetch(first, end) reads rows first : end of the table from the store.

    """

    def __init__(self, fetch: Fetch) -> None:
        self.fetch = fetch
        self._away: dict[int, int] = {}     # page: checksum of what left

    def __len__(self) -> int:
        return len(self._away)

    def apart(self) -> FramePages:
        """Return the same for columns of their own, which hold what these hold."""
        other = FramePages(self.fetch)
        other._away = dict(self._away)
        return other

    def missing(self, rows: NDArray[np.int32]) -> list[int]:
        """Return the pages that are away of some rows."""
        if not self._away:
            return []
        return [page for page in np.flatnonzero(np.bincount(rows // PAGE)).tolist()
                if page in self._away]

    def all_missing(self) -> list[int]:
        """Return the pages that are away."""
        return sorted(self._away)

    def bring(self, columns: Columns, sensors: list[str], pages: list[int]) -> None:
        """Fill pages of columns (t, session, sensor, stamp, placed and, where kept, best)."""
        for page in pages:
            first, end = page * PAGE, (page + 1) * PAGE
            t, session, names, stamp, placed, best = self.fetch(first, end)
            codes = [sensors.index(name) if name in sensors else -1 for name in names]
            found = t, session, np.array(codes), stamp, placed, placed if best is None else best
            for column, values in zip(columns, found):
                column[first:end] = values
            if _checksum(columns, first, end) != self._away[page]:
                raise PersemError(f'the map file has other frames {first} to {end - 1} than it '
                                  'was given: it is damaged, restore it from a copy')
            del self._away[page]

    def release(self, columns: Columns, pages: list[int]) -> None:
        """Let go of pages of columns, which the store has."""
        new = [page for page in pages if page not in self._away]
        for page in new:
            self._away[page] = _checksum(columns, page * PAGE, (page + 1) * PAGE)
        away = np.array(self.all_missing() if new else [], np.int64)
        ends = np.flatnonzero(np.diff(away) > 1) + 1    # of runs: a narrow column's page is less
        for run in np.split(away, ends) if new else []:     # than one of the system's
            for column in columns:
                _give_back(column, int(run[0]) * PAGE, int(run[-1] + 1) * PAGE)

    def copied(self, column: NDArray[Any], fresh: NDArray[Any]) -> None:
        """Copy a column into a longer one, but for what is away."""
        for first in range(0, len(column), PAGE):
            if first // PAGE not in self._away:
                fresh[first:min(first + PAGE, len(column))] = column[first:first + PAGE]


def pages_of(saved: Blocks) -> NDArray[np.bool_]:
    """Return which pages hold frames that observed each of some blocks, (blocks, pages)."""
    ends = saved.history_start[saved.block_start]
    marks = np.zeros((len(ends) - 1, int(saved.history_frame.max(initial=0)) // PAGE + 1), bool)
    _mark(np.ascontiguousarray(saved.history_frame), ends, PAGE, marks)
    return marks


@kernel
def _mark(frames, ends, rows, marks):
    """Write pages_of()."""
    for b in range(len(marks)):
        for i in range(ends[b], ends[b + 1]):
            marks[b, frames[i] // rows] = True


def _checksum(columns: Columns, first: int, end: int) -> int:
    """Return the CRC-32 of some rows of all columns."""
    crc = 0
    for column in columns:
        crc = zlib.crc32(np.ascontiguousarray(column[first:end]).data, crc)
    return crc


def _give_back(column: NDArray[Any], first: int, end: int) -> None:
    """Give the memory of rows first : end back to the system, as far as it is whole pages."""
    space: Any = column
    while not isinstance(space, mmap.mmap):
        space = space.obj if isinstance(space, memoryview) else space.base
        if space is None:
            return          # a short column, which is no mapping
    row = column.strides[0]
    begin = -(-first * row // mmap.PAGESIZE) * mmap.PAGESIZE
    stop = end * row // mmap.PAGESIZE * mmap.PAGESIZE
    if stop > begin:
        space.madvise(mmap.MADV_DONTNEED, begin, stop - begin)
