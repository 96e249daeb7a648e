"""Names are identity: ids of tables that change become the map's ids (spec section 11)."""

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import IGNORED, MAX_ID, UNKNOWN
from persem_ros.inputs.decode.legends import Table
from persem_ros.inputs.naming import difference, outdated
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_class import LegendClass

KEPT = 1000     # tables: some publish one with every image


class _Known(NamedTuple):
    """A table and what becomes of its ids."""

    table: Table
    ids: dict[int, int] | None      # the map's id of each, None: they are the map's already
    used: frozenset[int]            # ids that were another class's of the map

    def new(self) -> NDArray[np.int32] | None:
        """Return the map's id of every id, (65536,), -1 for none; None: they are the map's."""
        if self.ids is None:
            return None
        new = np.arange(UNKNOWN + 1, dtype=np.int32)
        new[sorted(self.used)] = IGNORED
        new[list(self.ids)] = list(self.ids.values())
        return new


class Names:
    """
    The classes of the map, by name.

    The first table gives the map its ids; where labels.legend is set, that does. Whatever comes
    later is renamed by name. An id that a table does not name keeps its number where the map has
    no class of that number, and is no label otherwise.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
        The ids of memory.ignore_labels and memory.dynamic_labels are given to no new class.
    legend : Legend, optional
        That of labels.legend, or of the map to go on with: its ids are the map's.
    strict : bool
        Whether a first table that only calls ids otherwise than *legend* is renamed, too: names
        of a map to go on with say what its ids are, labels.legend is how the user calls them.
    whose : str
        What *legend* is to the user; '': labels.legend where that is set, else the map's.

    Attributes
    ----------
    legend : Legend
        Of the map, grows with new names; without classes before the first table.

    """

    def __init__(self, config: Config, legend: Legend | None = None,
                 strict: bool = False, whose: str = '') -> None:
        """Start without tables."""
        self.legend = legend or Legend()
        self._given, self._strict = bool(legend and legend.classes), strict
        self._whose = whose or ('labels.legend' if config.labels.legend else "the map's legend")
        self._said, self._memory = '', config.memory
        self._reserved = {*config.memory.ignore_labels, *config.memory.dynamic_labels, UNKNOWN}
        self._ignored = {*config.memory.ignore_labels, UNKNOWN}
        self._stamped: list[_Known] = []        # by stamp
        self._arrived: list[_Known] = []        # in order of arrival
        self._gone = 0                          # of these, forgotten
        self._last: tuple[_Known, NDArray[np.int32] | None] | None = None

    def add(self, table: Table) -> None:
        """Take a table that came on a topic."""
        stamp, tables = table.stamp, self._arrived if table.stamp is None else self._stamped
        at = len(tables) if stamp is None else bisect_right(tables, stamp, key=_stamp)
        if at and tables[at - 1].table.legend == table.legend:
            return
        first, given = self._given and not (self._stamped or self._arrived), self.legend
        tables.insert(at, _Known(table, *self._renamed(table.legend)))
        if first and not self._strict:
            ids = tables[at].ids
            said = (difference(given, table.legend, ids, self._ignored, self._whose),
                    outdated(self._memory, given, table.legend, ids or {}))
            self._said = '; '.join(filter(None, said))
        if len(tables) > KEPT:
            del tables[0]
            self._gone += stamp is None

    def under(self, config: Config, legend: Legend) -> 'Names':
        """Return what these tables mean for a map whose classes are those of *legend*."""
        other = Names(config, legend)
        for known in (*self._stamped, *self._arrived):
            other.add(known.table)
        other._gone = self._gone
        return other

    @property
    def arrived(self) -> int:
        """Return how many different tables without a stamp have come."""
        return self._gone + len(self._arrived)

    @property
    def changes(self) -> bool:
        """Return whether any id has another number in the map than where it came from."""
        return any(one.ids is not None for one in (*self._stamped, *self._arrived))

    def at(self, stamp: int, arrived: int) -> tuple[Legend, NDArray[np.int32] | None]:
        """
        Return what holds for an image.

        Parameters
        ----------
        stamp : int
            Its header stamp, ns.
        arrived : int
            How many tables without a stamp had come before it.

        Returns
        -------
        Legend
            Whose colours the image may have; its ids are the image's.
        ndarray, shape (65536,), int32, or None
            The map's id of each of the image's, -1 for none; None: they are the map's.

        """
        if self._stamped:
            known = self._stamped[max(bisect_right(self._stamped, stamp, key=_stamp), 1) - 1]
        elif self._arrived:
            place = max(arrived - self._gone, 1) - 1
            known = self._arrived[min(place, len(self._arrived) - 1)]
        else:
            return self.legend, None
        if known.ids is None and self._given and not self._strict:
            return self.legend, None
        if self._last is None or self._last[0] is not known:
            self._last = known, known.new()
        return known.table.legend, self._last[1]

    def difference(self) -> str:
        """Return how the first table and the given legend differ, '' where they do not."""
        return self._said

    def moved(self) -> dict[str, tuple[int, int]]:
        """Return {name: (id where it came from, the map's)} of classes whose ids differ."""
        return {item.name: (item.id, known.ids[item.id])
                for known in (*self._stamped, *self._arrived) if known.ids is not None
                for item in known.table.legend.classes
                if known.ids.get(item.id, item.id) != item.id}

    def _renamed(self, theirs: Legend) -> tuple[dict[int, int] | None, frozenset[int]]:
        """Return the map's ids of a table's and those of other classes; learn new names."""
        ours = {item.name: item.id for item in self.legend.classes}
        if not ours:
            self.legend = theirs
            return None, frozenset()
        first = not self._stamped and not self._arrived
        fits = all(ours.get(item.name, item.id) == item.id for item in theirs.classes)
        if first and self._given and fits and not self._strict:     # only called otherwise
            return None, frozenset()
        used, learned = set(ours.values()), []
        free = (i for i in range(MAX_ID + 1) if i not in used and i not in self._reserved)
        ids = {i: i for i in self._ignored if 0 <= i <= UNKNOWN}
        for item in theirs.classes:
            if item.id in self._ignored:
                continue
            if item.name not in ours:
                if (number := next(free, None)) is None:    # 65 535 names are all that there are
                    ids[item.id] = IGNORED
                    continue
                ours[item.name] = number
                used.add(number)
                learned.append(_numbered(item, number))
            ids[item.id] = ours[item.name]
        if learned:
            self.legend = Legend(self.legend.title, (*self.legend.classes, *learned))
        same = all(i == n for i, n in ids.items()) and used <= set(ids)
        return (None if same else ids), frozenset(used)


def renamed(labels: NDArray[np.int32], new: NDArray[np.int32] | None) -> NDArray[np.int32]:
    """Return *labels* (H, W) under the ids of Names.at(); what is out of range is no label."""
    if new is None:
        return labels
    inside = (labels >= 0) & (labels <= UNKNOWN)
    return np.where(inside, new[np.where(inside, labels, 0)], IGNORED)


def filled(config: Config, legend: Legend | None, tables: Iterable[Table],
           strict: bool = False, whose: str = '') -> Names:
    """Return Names with tables that are all known: those with stamps first, as in a replay."""
    names, tables = Names(config, legend, strict, whose), list(tables)
    for table in sorted(tables, key=lambda one: one.stamp is None):
        names.add(table)
    return names


def _stamp(known: _Known) -> int:
    return known.table.stamp or 0


def _numbered(item: LegendClass, number: int) -> LegendClass:
    return replace(item, id=number)
