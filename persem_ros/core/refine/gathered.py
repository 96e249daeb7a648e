"""What was looked at of a map, part by part, and the parameters that the schedule makes of it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import Any, Optional

import numpy as np
from persem_ros.core.geometry.columns import Columns, columns_of, merged
from persem_ros.core.geometry.groups import cells_listed
from persem_ros.core.geometry.kept import within
from persem_ros.core.geometry.looks import Looks, model_of, Pairs, pairs_of
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.schedule import Schedule
from persem_ros.core.geometry.totals import Totals, Whole

Steps = Generator[int, None, Any]


class Gathered:
    """
    What goes by the whole map, of the parts that were looked at so far.

    Parameters
    ----------
    constants : persem_ros.settings.config.Geometry
        refine.geometry.

    Attributes
    ----------
    columns : Columns or None
        Of the map, from fit() on.

    """

    def __init__(self, constants: Any) -> None:
        self._constants = constants
        self._parts: list[Columns] = []
        self._classes, self._pairs, self._n = np.zeros(65536, bool), Pairs(0, 0, 0), 0
        self.columns: Optional[Columns] = None

    def add(self, looks: Looks) -> None:
        """Take in what goes by the whole map of the Looks of a part; these are not kept."""
        self._parts.append(columns_of(looks.index))
        self._classes[looks.votes.classes] = True
        self._pairs = self._pairs.and_those(pairs_of(looks.votes))
        self._n += len(looks.shape)

    def fit(self, models: Callable[[], Iterator[Any]]) -> Steps:
        """
        Run the schedule of section 12.5 from its start, when all parts were added.

        Parameters
        ----------
        models : callable
            Gives the model() of each part, None for an empty one; it is called once a round.

        Yields
        ------
        int
            0 after each part; at the end the parameters are returned, None for an empty map.

        """
        if not self._n:
            return None
        self.columns, constants = merged(self._parts), self._constants
        ids = np.flatnonzero(self._classes).astype(np.uint16)
        self._pairs.check(len(ids))
        self._whole = Whole(ids, self.columns.cells(constants.cell), self._n, constants.shrink)
        schedule = Schedule(constants.rounds, self._whole.estimate)
        while not schedule.ended:
            totals, known = Totals(self._whole.cells), None
            if schedule.parameters is not None:
                known = schedule.parameters.arrays()
            for model in models():
                if model is not None:
                    sums = model.start(schedule.rho) if known is None else \
                        model.round(within(known, model.cells))
                    totals.add(sums, (cells_listed(model.cells[0]), cells_listed(model.cells[1])))
                yield 0
            schedule.take(totals.sums())
        return schedule.parameters

    def model(self, looks: Looks) -> Any:
        """Return the model of a part, while fit() is under way."""
        assert self.columns is not None, 'fit() has put them together'
        return model_of(looks, self.columns, self._whole.classes, self._constants)


def beside_wanted(memory: Any) -> bool:
    """Return whether looks have to list the classes beside each voxel: there may be many."""
    return bool(np.count_nonzero(memory.seen_ids) > MOST_DENSE)
