"""Telling a clock that went back from a single stamp that is off; no clock in here."""

from __future__ import annotations

from collections import deque
from typing import Any

ONWARD, ODD, BACK = 'onward', 'odd', 'back'
REMEMBERED = 3      # stamps; their median is not moved by one that is hours off


class Timeline:
    """
    The stamps of one topic in the order of arrival.

    A clock that went back (a recording that loops) shows as two stamps in a row that lie far
    before the recent ones and near each other; one alone is a message with a bad stamp.

    Parameters
    ----------
    tolerance : int
        Nanoseconds that a stamp may lie before earlier ones: messages overtake each other.

    """

    def __init__(self, tolerance: int) -> None:
        """Start without stamps."""
        self._tolerance = tolerance
        self._recent: deque[int] = deque(maxlen=REMEMBERED)
        self._odd: int | None = None

    @property
    def now(self) -> Any:
        """Return the median of the recent stamps, None before the first."""
        return sorted(self._recent)[len(self._recent) // 2] if self._recent else None

    def judge(self, stamp: Any) -> Any:
        """Return `ONWARD`, `ODD` (too early, but alone so far) or `BACK` (the second one)."""
        if self.now is None or stamp >= self.now - self._tolerance:
            self._recent.append(stamp)
            self._odd = None
            return ONWARD
        if self._odd is not None and abs(stamp - self._odd) <= self._tolerance:
            self.restart(self._odd, stamp)
            return BACK
        self._odd = stamp
        return ODD

    def restart(self, *stamps: int) -> None:
        """Forget what was before *stamps*."""
        self._recent.clear()
        self._recent.extend(stamps)
        self._odd = None
