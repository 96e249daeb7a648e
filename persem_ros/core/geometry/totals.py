"""The sums of a round over a whole map, put together from those of its parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.entries import merged
from persem_ros.core.geometry.ground import keys_of
from persem_ros.core.geometry.groups import Cells, cells_listed, KINDS
from persem_ros.core.geometry.parameters import estimate, Sums
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.sparse_parameters import estimate_sparse, SparseSums

Any_Sums = Union[Sums, SparseSums]
DENSE = 'fine', 'coarse', 'shifted'
TABLES = 'confusion', 'coarse', 'shifted'       # of the sparse form
MANY = 64       # parts whose sparse tables are merged at once


class Numbers:
    """
    The numbers of a map's cells.

    Parameters
    ----------
    listed : ndarray, shape (n, 2), int32
        core.geometry.groups.cells_listed.

    """

    def __init__(self, listed: NDArray[np.int32]) -> None:
        keys = keys_of(listed)
        self._order = np.argsort(keys)
        self._keys = keys[self._order]

    def of(self, cells: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the numbers (m,) of cells (m, 2), -1 for those that are none."""
        keys = keys_of(cells)
        if not len(self._keys):
            return np.full(len(keys), -1, np.int64)
        place = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return np.where(self._keys[place] == keys, self._order[place], -1)


class Totals:
    """
    The sums of the parts that were added so far, by the cells of the whole map.

    Whole numbers of 2^-30: neither the order of parts nor their borders change a bit.

    Parameters
    ----------
    cells : pair of core.geometry.groups.Cells
        Of the whole map.

    """

    def __init__(self, cells: tuple[Cells, Cells]) -> None:
        self._sizes = [known.number for known in cells]
        self._numbers = [Numbers(cells_listed(known)) for known in cells]
        self._sum: Any = None
        self._waiting: list[SparseSums] = []

    def add(self, sums: Any_Sums, cells: tuple[NDArray[np.int32], NDArray[np.int32]]) -> None:
        """Add the sums of a part, whose own *cells* are listed; of others nothing is added."""
        numbers = [known.of(own) for known, own in zip(self._numbers, cells)]
        if isinstance(sums, Sums):
            self._add(sums, numbers)
            return
        self._waiting.append(_renumbered(sums, numbers))
        if len(self._waiting) == MANY:
            self._merge()

    def sums(self) -> Any_Sums:
        """Return the sums of all parts, of one at least."""
        if self._waiting:
            self._merge()
        found: Any_Sums = self._sum
        return found

    def _add(self, sums: Sums, numbers: list[NDArray[np.int64]]) -> None:
        K = len(sums.mass)
        if self._sum is None:
            self._sum = Sums(np.zeros((K, K), np.int64), np.zeros(K, np.int64), [
                np.zeros_like(sums.groups[0]),
                *(np.zeros((n * KINDS + 1, K), np.int64) for n in self._sizes)],
                np.zeros(K, np.int64), 0)
        for whole, part, number in zip(self._sum.groups[1:], sums.groups[1:], numbers):
            known = number >= 0
            whole[:-1].reshape(-1, KINDS, K)[number[known]] += \
                part[:-1].reshape(-1, KINDS, K)[known]
        self._sum.add(Sums(sums.confusion, sums.mass, sums.groups[:1], sums.share,
                           sums.agreement))

    def _merge(self) -> None:
        parts = self._waiting if self._sum is None else [self._sum, *self._waiting]
        self._waiting = []
        fields: dict[str, Any] = {
            name: merged([getattr(part, name) for part in parts]) if name in TABLES else
            sum(getattr(part, name) for part in parts)
            for name in SparseSums.__dataclass_fields__}
        self._sum = SparseSums(**fields)


@dataclass(frozen=True, eq=False)
class Whole:
    """What estimates depend on besides sums: classes, cells and number of voxels of the map."""

    classes: NDArray[np.uint16]
    cells: tuple[Cells, Cells]
    voxels: int
    shrink: float

    def estimate(self, sums: Any, rho: float) -> Any:
        """Return the parameters that follow from the sums over the map."""
        form: Any = estimate if len(self.classes) <= MOST_DENSE else estimate_sparse
        return form(sums, self.voxels, self.classes, self.cells, rho, self.shrink)


def arrays_of(sums: Any_Sums) -> dict[str, NDArray[Any]]:
    """Return sums as plain arrays, by name; sums_from() takes them."""
    found = {'mass': sums.mass, 'share': sums.share, 'agreement': np.array([sums.agreement])}
    if isinstance(sums, Sums):
        return {**found, 'confusion': sums.confusion, **dict(zip(DENSE, sums.groups))}
    for name in TABLES:
        found[f'{name}_keys'], found[f'{name}_values'] = getattr(sums, name)
    return {**found, 'fine': sums.fine}


def sums_from(arrays: Any) -> Any_Sums:
    """Return the sums that arrays_of() was given."""
    mass, share, agreement = arrays['mass'], arrays['share'], int(arrays['agreement'][0])
    if 'confusion' in arrays:
        return Sums(arrays['confusion'], mass, [arrays[name] for name in DENSE], share, agreement)
    tables = {name: (arrays[f'{name}_keys'], arrays[f'{name}_values']) for name in TABLES}
    return SparseSums(mass=mass, share=share, fine=arrays['fine'], agreement=agreement, **tables)


def _renumbered(sums: SparseSums, numbers: list[NDArray[np.int64]]) -> SparseSums:
    """Return sums by other numbers of the cells."""
    size, tables = KINDS * len(sums.mass), []
    for (keys, values), number in zip((sums.coarse, sums.shifted), numbers):
        of = np.append(number, -1)[keys // size]        # the last: of unknown cells
        tables.append(((of * size + keys % size)[of >= 0], values[of >= 0]))
    return SparseSums(sums.confusion, sums.mass, sums.fine, tables[0], tables[1], sums.share,
                      sums.agreement)
