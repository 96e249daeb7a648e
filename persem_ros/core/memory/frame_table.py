"""The frame table: when, by what and from where the map was looked at (spec section 2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.frame_pages import Fetch, FramePages, PAGE
from persem_ros.core.memory.pools import longer, sparse_zeros

if TYPE_CHECKING:
    from persem_ros.core.memory.session import Session

FEW = 64            # rows of fresh tables
ROOM = 1 << 18      # rows of the frame table for which there is address space, seven hours


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """
    A row of the frame table.

    Attributes
    ----------
    t : int
        The number of its stamp.
    session : int
    sensor : str
    stamp : int
        Nanoseconds.
    T_map_sensor : ndarray, shape (4, 4), float64
        The pose *placed*: where its observations lie.
    T_map_best : ndarray, shape (4, 4), float64
        The best that is known of the pose by now (spec section 10); the same until a corrected
        trajectory says otherwise.

    """

    t: int
    session: int
    sensor: str
    stamp: int
    T_map_sensor: NDArray[np.float64]
    T_map_best: NDArray[np.float64]


class FrameTable:
    """
    All frames that were integrated, as arrays; row f is the f-th.

    It grows at its end only, so that a copy shares what it holds (copy()). Where a store has the
    map (attach()), rows that no observation in memory refers to may be away: here() is for those
    who look at rows of observations in memory; whoever asks for a whole column gets it whole.

    Attributes
    ----------
    sensors : list of str
        Names by code.
    sessions : dict of int to Session
        Those that have a frame.

    """

    def __init__(self) -> None:
        self.sensors: list[str] = []
        self.sessions: dict[int, Session] = {}
        self._n = 0
        self._t = np.empty(FEW, np.int32)
        self._session = np.empty(FEW, np.int64)
        self._sensor = np.empty(FEW, np.uint16)
        self._stamp = np.empty(FEW, np.int64)
        self._placed = np.empty((FEW, 4, 4))
        self._best: NDArray[np.float64] | None = None      # None: the same
        self._pages: FramePages | None = None               # None: all rows are in memory

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, f: int) -> FrameRecord:
        f = range(self._n)[f]
        self.bring(np.array([f], np.int32))
        best = self._placed if self._best is None else self._best
        return FrameRecord(
            int(self._t[f]), int(self._session[f]), self.sensors[self._sensor[f]],
            int(self._stamp[f]), self._placed[f].copy(), best[f].copy())

    def __iter__(self) -> Iterator[FrameRecord]:
        return (self[f] for f in range(self._n))

    @property
    def t(self) -> NDArray[np.int32]:
        """Return t of every frame, shape (n,), int32."""
        self._bring_all()
        return self._t[:self._n]

    @property
    def session(self) -> NDArray[np.int64]:
        """Return the session of every frame, shape (n,), int64."""
        self._bring_all()
        return self._session[:self._n]

    @property
    def sensor(self) -> NDArray[np.uint16]:
        """Return the code (place in sensors) of every frame's sensor, shape (n,), uint16."""
        self._bring_all()
        return self._sensor[:self._n]

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Return the stamp of every frame, shape (n,), int64, nanoseconds."""
        self._bring_all()
        return self._stamp[:self._n]

    @property
    def placed(self) -> NDArray[np.float64]:
        """Return where every frame's observations lie from, T_map_sensor, shape (n, 4, 4)."""
        self._bring_all()
        return self._placed[:self._n]

    @property
    def best(self) -> NDArray[np.float64]:
        """Return the best poses known, shape (n, 4, 4), float64."""
        self._bring_all()
        return (self._placed if self._best is None else self._best)[:self._n]

    def here(self, name: str) -> NDArray[Any]:
        """
        Return a column (t, session, sensor, stamp or placed) as it is in memory.

        Rows of observations in memory, and the last one, hold; others may not.
        """
        column: NDArray[Any] = getattr(self, '_' + name)
        return column[:self._n]

    def attach(self, fetch: Fetch) -> None:
        """Have rows come from a store, which has them by now, where release() lets them go."""
        self._pages = FramePages(fetch)

    def bring(self, rows: NDArray[np.int32]) -> None:
        """Have some rows, 0 to n - 1, in memory."""
        if self._pages:
            self._pages.bring(self._columns(), self.sensors, self._pages.missing(rows))

    def release(self, pages: list[int]) -> None:
        """Let go of pages of rows (frame_pages.PAGE each), of which a store has all."""
        if self._pages is not None:
            self._pages.release(self._columns(), pages)

    @property
    def moved(self) -> bool:
        """Return whether any best pose was ever told from the placed one."""
        return self._best is not None

    def append(self, t: int, session: int, sensor: str, stamp: int,
               T_map_sensor: NDArray[np.float64],
               T_map_best: NDArray[np.float64] | None = None) -> int:
        """Enter a frame; return its row f."""
        f = self._n
        if f == len(self._t):
            self._grow(2 * f)
        if sensor not in self.sensors:
            self.sensors.append(sensor)
        self._t[f], self._session[f], self._stamp[f] = t, session, stamp
        self._sensor[f] = self.sensors.index(sensor)
        self._placed[f] = T_map_sensor
        if T_map_best is not None and self._best is None:
            self._best = longer(self.placed, len(self._placed))
        if self._best is not None:
            self._best[f] = T_map_sensor if T_map_best is None else T_map_best
        self._n = f + 1
        return f

    def extend(self, t: NDArray[np.int32], session: NDArray[np.int64], sensor: list[str],
               stamp: NDArray[np.int64], placed: NDArray[np.float64],
               best: NDArray[np.float64] | None) -> None:
        """Enter many frames, column by column; *best* None: as placed."""
        f, end = self._n, self._n + len(t)
        if end > len(self._t):
            self._grow(end + FEW)
        self.sensors = list(dict.fromkeys([*self.sensors, *sensor]))
        code = {name: k for k, name in enumerate(self.sensors)}
        self._t[f:end], self._session[f:end], self._stamp[f:end] = t, session, stamp
        self._sensor[f:end] = [code[name] for name in sensor]
        self._placed[f:end] = placed
        if best is not None and self._best is None:
            self._best = longer(self.placed, len(self._placed))
        if self._best is not None:
            self._best[f:end] = placed if best is None else best
        self._n = end

    def note_best(self, T_map_best: NDArray[np.float64]) -> None:
        """Enter what is known of the pose of the last frame; nobody has a copy with it yet."""
        if self._best is None:
            self._best = longer(self.placed, len(self._placed))
        self._best[self._n - 1] = T_map_best

    def copy(self) -> FrameTable:
        """Return the table as it is now; rows are shared, for none is ever changed in place."""
        other = FrameTable()
        other.__dict__.update(self.__dict__, sensors=list(self.sensors),
                              sessions=dict(self.sessions))
        other._freeze()         # the room behind the rows is ours
        return other

    def replace_poses(self, placed: NDArray[np.float64], best: NDArray[np.float64]) -> None:
        """Take other poses for all rows, (n, 4, 4) each; earlier copies keep theirs."""
        self._bring_all()       # the other columns stay
        self._pages = None
        self._placed, self._best = placed.copy(), best.copy()
        self._freeze()

    def nbytes(self) -> int:
        """Return the bytes that the rows in use and in memory take."""
        rows = self._n - (PAGE * len(self._pages) if self._pages else 0)
        return sum(column[:rows].nbytes for column in self._columns())

    def _columns(self) -> list[NDArray[Any]]:
        """Return the columns, the best poses last where there are any."""
        all_of = self._t, self._session, self._sensor, self._stamp, self._placed, self._best
        return [column for column in all_of if column is not None]

    def _bring_all(self) -> None:
        """Have all rows in memory."""
        if self._pages:
            self._pages.bring(self._columns(), self.sensors, self._pages.all_missing())

    def _freeze(self) -> None:
        """Let the next frame begin new arrays."""
        n = self._n
        self._t, self._session, self._sensor, self._stamp, self._placed = (
            self._t[:n], self._session[:n], self._sensor[:n], self._stamp[:n], self._placed[:n])
        if self._best is not None:
            self._best = self._best[:n]

    def _grow(self, rows: int) -> None:
        """Make room for *rows* frames, and for many more, in new arrays."""
        rows, pages = max(rows, ROOM), self._pages
        self._t = _with_room(self._t, rows, pages)
        self._session = _with_room(self._session, rows, pages)
        self._sensor = _with_room(self._sensor, rows, pages)
        self._stamp = _with_room(self._stamp, rows, pages)
        self._placed = _with_room(self._placed, rows, pages)
        if self._best is not None:
            self._best = _with_room(self._best, rows, pages)
        if pages is not None:
            self._pages = pages.apart()     # earlier copies keep the old columns


def _with_room(column: NDArray[Any], rows: int, pages: FramePages | None) -> NDArray[Any]:
    """Return a copy of a column with room for *rows* rows; pages that are away stay so."""
    if not pages:
        return longer(column, rows)
    fresh: NDArray[Any] = sparse_zeros((rows, *column.shape[1:]), column.dtype)
    pages.copied(column, fresh)
    return fresh
