"""One flight in the map: what it is known by, and the stamps of its frames."""

from __future__ import annotations

from dataclasses import dataclass, field
import hashlib
from typing import TYPE_CHECKING
import uuid

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import longer

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.memory.frame_table import FrameTable

FEW = 64            # stamps of fresh arrays
NEWEST = 4096       # stamps of a session that are at hand, at least half of them


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


class Stamps:
    """
    The distinct stamps of one session, each with its t; usually they come in order.

    The newest are at hand; where an older one comes, all are read from the frame table again.

    Parameters
    ----------
    frames : FrameTable, optional
        That of the map; each stamp is entered there, too.
    session : int
        The number of the session.

    """

    def __init__(self, frames: FrameTable | None = None, session: int = 0) -> None:
        self._stamp, self._t, self._n = np.empty(FEW, np.int64), np.empty(FEW, np.int32), 0
        self._frames, self._session = frames, session
        self._left: int | None = None       # the newest of those that are not at hand
        self._limit = NEWEST
        if frames is not None and session in frames.sessions:
            self._recall()
            self._let_go()

    def find(self, stamp: int) -> int | None:
        """Return t of a stamp, None for a new one."""
        if self._left is not None and stamp <= self._left:
            self._recall()
            self._limit = 2 * self._n       # such a stamp seldom comes alone
        at = self._place(stamp)
        known = at < self._n and self._stamp[at] == stamp
        return int(self._t[at]) if known else None

    def add(self, stamp: int, t: int) -> None:
        """Enter a new stamp."""
        self._let_go()
        n, at = self._n, self._place(stamp)
        if n == len(self._t):
            room = max(2 * n, FEW)
            self._stamp, self._t = longer(self._stamp, room), longer(self._t, room)
        for column, value in ((self._stamp, stamp), (self._t, t)):
            column[at + 1:n + 1] = column[at:n]
            column[at] = value
        self._n = n + 1

    def _place(self, stamp: int) -> int:
        """Return the first place whose stamp is not below *stamp*."""
        if self._n and self._stamp[self._n - 1] < stamp:
            return self._n
        return int(np.searchsorted(self._stamp[:self._n], stamp))

    def _let_go(self) -> None:
        """Keep the newest only, where there are many."""
        if self._frames is None or self._n < self._limit:
            return
        kept, self._limit = NEWEST // 2, NEWEST
        first = self._n - kept
        self._left, self._n = int(self._stamp[first - 1]), kept
        self._stamp, self._t = (longer(column[first:first + kept], NEWEST)
                                for column in (self._stamp, self._t))

    def _recall(self) -> None:
        """Read all stamps of the session."""
        assert self._frames is not None
        own = self._frames.session == self._session
        self._stamp, first = np.unique(self._frames.stamp[own], return_index=True)
        self._t, self._n = self._frames.t[own][first], len(first)
        self._left = None


def uuid_of(seen: Observations, origin: tuple[float, float, float], voxel_size: float) -> str:
    """
    Return the UUID of the session whose first frame is that of some Observations.

    Voxels of every second stripe, 16 wide along y, count before the others: so they were once
    observed, and a session keeps its name in maps of any version.

    """
    base = np.floor((seen.T_map_sensor[1, 3] - origin[1]) / voxel_size)
    stripes = (seen.voxels[:, 1].astype(np.int64) - np.int64(base)) >> 4 & 1
    order = np.argsort(stripes, kind='stable')
    return session_uuid(seen.stamp, seen.sensor, seen.T_map_sensor, seen.voxels[order],
                        seen.labels[order], seen.confidences[order])


def session_uuid(*content: object) -> str:
    """Return a UUID that depends on *content* alone: arrays, bytes, texts and numbers."""
    digest = hashlib.sha256()
    for part in content:
        data = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        digest.update(data)
    return str(uuid.UUID(bytes=digest.digest()[:16], version=5))
