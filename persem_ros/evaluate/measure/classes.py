"""The counted classes: small numbers for ids, after a taxonomy has been applied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.frames import UNKNOWN


class Classes:
    """
    The counted classes: small numbers for ids, after a taxonomy has been applied.

    Parameters
    ----------
    table : dict, optional
        Many-to-one taxonomy; None: every id stands for itself.

    Attributes
    ----------
    index : ndarray, shape (65536,), uint16
        Class of each id; 0: not counted, or not met yet.
    ids : list of int
        The id that each class stands for; UNKNOWN for class 0.
    outside : ndarray, shape (65536,), int64
        Pixels of true ids outside the taxonomy.

    """

    def __init__(self, table: dict[int, int] | None = None) -> None:
        self.table = table
        self.index = np.zeros(UNKNOWN + 1, np.uint16)
        self.ids = [UNKNOWN]
        self.outside = np.zeros(UNKNOWN + 1, np.int64)
        self._met = np.zeros(UNKNOWN + 1, np.uint8)
        self._met[UNKNOWN] = 1

    def meet(self, image: NDArray[np.int32]) -> bool:
        """Give new ids of an array of int32 or uint16 a class; return whether there were any."""
        new = np.zeros(UNKNOWN + 1, np.uint8)
        if not mark(np.ascontiguousarray(image).reshape(-1), self._met, new):
            return False
        for c in np.flatnonzero(new):
            self._met[c] = 1
            target = int(c) if self.table is None else self.table.get(int(c))
            if target is not None:
                if target not in self.ids:
                    self.ids.append(target)
                self.index[c] = self.ids.index(target)
        return True

    def __len__(self) -> int:
        """Return the number of classes, the unknown one included."""
        return len(self.ids)


@kernel
def mark(image, met, new):
    """Mark the ids of an image that were not met; return whether there are any."""
    found, last = False, np.int64(-1)
    for p in range(len(image)):
        c = np.int64(image[p])
        if c != last and 0 <= c < len(met):
            last = c
            if met[c] == 0:
                new[c] = 1
                found = True
    return found
