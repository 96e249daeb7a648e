"""The frame table: when, by what and from where the map was looked at (spec section 2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
import hashlib
from typing import Any
import uuid

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import sparse_zeros

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


@dataclass(frozen=True, eq=False)
class Session:
    """
    One flight in the map.

    Attributes
    ----------
    uuid : str
        Made of what its first frame saw: the same flight has the same one wherever it is mapped.
    mounts : dict of str to ndarray, shape (4, 4), float64
        By sensor, T_body_sensor: from the sensor to what the pose topic places.

    """

    uuid: str
    mounts: dict[str, NDArray[np.float64]] = field(default_factory=dict)


class FrameTable:
    """
    All frames that were integrated, as arrays; row f is the f-th.

    It grows at its end only, so that a copy shares what it holds (copy()).

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

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, f: int) -> FrameRecord:
        f = range(self._n)[f]
        return FrameRecord(
            int(self._t[f]), int(self._session[f]), self.sensors[self._sensor[f]],
            int(self._stamp[f]), self._placed[f].copy(), self.best[f].copy())

    def __iter__(self) -> Iterator[FrameRecord]:
        return (self[f] for f in range(self._n))

    @property
    def t(self) -> NDArray[np.int32]:
        """Return t of every frame, shape (n,), int32."""
        return self._t[:self._n]

    @property
    def session(self) -> NDArray[np.int64]:
        """Return the session of every frame, shape (n,), int64."""
        return self._session[:self._n]

    @property
    def sensor(self) -> NDArray[np.uint16]:
        """Return the code (place in sensors) of every frame's sensor, shape (n,), uint16."""
        return self._sensor[:self._n]

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Return the stamp of every frame, shape (n,), int64, nanoseconds."""
        return self._stamp[:self._n]

    @property
    def placed(self) -> NDArray[np.float64]:
        """Return where every frame's observations lie from, T_map_sensor, shape (n, 4, 4)."""
        return self._placed[:self._n]

    @property
    def best(self) -> NDArray[np.float64]:
        """Return the best poses known, shape (n, 4, 4), float64."""
        return (self._placed if self._best is None else self._best)[:self._n]

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
            self._best = _longer(self.placed, len(self._placed))
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
            self._best = _longer(self.placed, len(self._placed))
        if self._best is not None:
            self._best[f:end] = placed if best is None else best
        self._n = end

    def note_best(self, T_map_best: NDArray[np.float64]) -> None:
        """Enter what is known of the pose of the last frame; nobody has a copy with it yet."""
        if self._best is None:
            self._best = _longer(self.placed, len(self._placed))
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
        self._placed, self._best = placed.copy(), best.copy()
        self._freeze()

    def nbytes(self) -> int:
        """Return the bytes that the rows in use take."""
        rows = self._t, self._session, self._sensor, self._stamp, self._placed, self._best
        return sum(a[:self._n].nbytes for a in rows if a is not None)

    def _freeze(self) -> None:
        """Let the next frame begin new arrays."""
        n = self._n
        self._t, self._session, self._sensor, self._stamp, self._placed = (
            self._t[:n], self._session[:n], self._sensor[:n], self._stamp[:n], self._placed[:n])
        if self._best is not None:
            self._best = self._best[:n]

    def _grow(self, rows: int) -> None:
        """Make room for *rows* frames, and for many more, in new arrays."""
        rows = max(rows, ROOM)
        self._t = _longer(self._t, rows)
        self._session = _longer(self._session, rows)
        self._sensor = _longer(self._sensor, rows)
        self._stamp = _longer(self._stamp, rows)
        self._placed = _longer(self._placed, rows)
        if self._best is not None:
            self._best = _longer(self._best, rows)


class Stamps:
    """The distinct stamps of one session, each with its t; usually they come in order."""

    def __init__(self, stamps: NDArray[np.int64] | None = None,
                 t: NDArray[np.int32] | None = None) -> None:
        """Start with none, or with those of a session's frames."""
        self._stamp, self._t, self._n = np.empty(FEW, np.int64), np.empty(FEW, np.int32), 0
        if stamps is not None and t is not None and len(stamps):
            self._stamp, first = np.unique(stamps, return_index=True)
            self._t, self._n = t[first].astype(np.int32), len(first)

    def find(self, stamp: int) -> int | None:
        """Return t of a stamp, None for a new one."""
        at = self._place(stamp)
        known = at < self._n and self._stamp[at] == stamp
        return int(self._t[at]) if known else None

    def add(self, stamp: int, t: int) -> None:
        """Enter a new stamp."""
        n, at = self._n, self._place(stamp)
        if n == len(self._t):
            self._stamp, self._t = _longer(self._stamp, 2 * n), _longer(self._t, 2 * n)
        for column, value in ((self._stamp, stamp), (self._t, t)):
            column[at + 1:n + 1] = column[at:n]
            column[at] = value
        self._n = n + 1

    def _place(self, stamp: int) -> int:
        """Return the first place whose stamp is not below *stamp*."""
        if self._n and self._stamp[self._n - 1] < stamp:
            return self._n
        return int(np.searchsorted(self._stamp[:self._n], stamp))


def session_uuid(*content: object) -> str:
    """Return a UUID that depends on *content* alone: arrays, bytes, texts and numbers."""
    digest = hashlib.sha256()
    for part in content:
        data = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        digest.update(data)
    return str(uuid.UUID(bytes=digest.digest()[:16], version=5))


def _longer(column: NDArray[Any], rows: int) -> NDArray[Any]:
    """Return a copy of a column with room for *rows* rows."""
    fresh = sparse_zeros((max(rows, FEW), *column.shape[1:]), column.dtype)
    fresh[:len(column)] = column
    return fresh
