"""Records of tiles of 8 x 8 columns, in the order of their keys; new ones move no others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import keys_of, NONE, TILE
from persem_ros.outputs.grid.rule import UNKNOWN_CLASS, UNKNOWN_COST

# Name: type, width, of what nobody knows.
COLUMNS: dict[str, tuple[Any, int, int]] = {
    'tile': (np.int32, 2, 0), 'lowest': (np.int32, TILE, NONE), 'level': (np.int32, TILE, NONE),
    'cost': (np.int8, TILE, UNKNOWN_COST), 'label': (np.uint16, TILE, UNKNOWN_CLASS)}


class Tiles:
    """
    What is kept of tiles.

    A row is a tile's place among all in the order of keys_of; rows hold until new ones are made.
    Only keys and slots are moved then: 16 bytes a tile, of the 700 that its record has.

    """

    def __init__(self) -> None:
        self._keys = np.empty(0, np.int64)      # sorted
        self._slots = np.empty(0, np.int64)     # in the columns, of each key
        self._columns = {name: np.empty((0, width), kind)
                         for name, (kind, width, _) in COLUMNS.items()}

    def __len__(self) -> int:
        """Return the number of tiles."""
        return len(self._keys)

    def rows(self, tiles: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the rows, sorted, of unique tiles (n, 2); what is new gets one."""
        order = np.argsort(keys_of(tiles))
        wanted = keys_of(tiles)[order]
        new = ~self._known(wanted)[1]
        if new.any():
            n, m = len(self), int(new.sum())
            self._reserve(n + m)
            self._columns['tile'][n:n + m] = tiles[order[new]]
            place = np.searchsorted(self._keys, wanted[new])
            self._keys = np.insert(self._keys, place, wanted[new])
            self._slots = np.insert(self._slots, place, np.arange(n, n + m))
        return np.searchsorted(self._keys, wanted)

    def _known(self, keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the rows of keys, and which of them there are."""
        if not len(self):
            return np.zeros(len(keys), np.int64), np.zeros(len(keys), bool)
        rows = np.searchsorted(self._keys, keys).clip(max=len(self) - 1)
        return rows, self._keys[rows] == keys

    def near(self, rows: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
        """Return the rows, sorted, of all known tiles within *reach* tiles."""
        steps = np.arange(-reach, reach + 1, dtype=np.int64)
        found = self._keys[rows]
        for unit in (1, 1 << 32):       # along j, then along i
            found = np.unique(found[:, None] + steps * unit)
        rows, known = self._known(found)
        return np.unique(rows[known])

    def get(self, name: str, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of a column's rows, shape (len(rows), its width)."""
        return self._columns[name][self._slots[rows]]

    def put(self, name: str, rows: NDArray[np.int64], values: NDArray[Any]) -> None:
        """Enter values into a column's rows."""
        self._columns[name][self._slots[rows]] = values

    def _reserve(self, n: int) -> None:
        """Have room for *n* tiles; doubles, so that each is copied once or twice in all."""
        have = len(self._columns['tile'])
        if n <= have:
            return
        for name, (kind, width, unknown) in COLUMNS.items():
            wider = np.full((max(n, 2 * have, 64), width), unknown, kind)
            wider[:have] = self._columns[name]
            self._columns[name] = wider
