"""The parameters of the method geometry for a map of which a store holds the rest."""

from __future__ import annotations

from collections.abc import Generator
from functools import reduce
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import Columns, columns_of, merged
from persem_ros.core.geometry.groups import cells_listed
from persem_ros.core.geometry.kept import within
from persem_ros.core.geometry.looks import look, Looks, model_of, Pairs, pairs_of
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.schedule import Schedule
from persem_ros.core.geometry.totals import Totals, Whole
from persem_ros.core.memory.dump import evidence_of_voxels
from persem_ros.core.refine.reach import surrounded

KEPT = 1 << 28      # bytes of looks that stay for the rounds; others are taken again in each
Steps = Generator[int, None, Any]


class Fitting:
    """
    The schedule of section 12.5 over a map, some blocks at a time.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        It has a pager.
    settings : persem_ros.settings.config.Refine
        up and geometry.
    index : ndarray, shape (n, 3), int32
        All blocks.
    at_once, max_voxels, saves : int, int, bool
        As of Pager.visit.

    Attributes
    ----------
    columns : Columns or None
        Of the map, when the parameters are fitted.

    """

    def __init__(self, memory: Any, settings: Any, index: NDArray[np.int32], at_once: int,
                 max_voxels: int, saves: bool = True) -> None:
        self._memory, self._settings, self._index = memory, settings, index
        self._at_once, self._how = at_once, (at_once, max_voxels, saves)
        self._beside = bool(np.count_nonzero(memory.seen_ids) > MOST_DENSE)
        self._kept: list[Any] = []      # of each step the looks, later the model; None: not kept
        self.columns: Optional[Columns] = None

    def parameters(self) -> Steps:
        """Yield 0 after each step; return the parameters, None for an empty map."""
        columns, classes, pairs, n, room = [], np.zeros(65536, bool), [], 0, KEPT
        for numbers in self._steps():
            looks = self._look(numbers)
            if looks is not None:
                columns.append(columns_of(looks.index))
                classes[looks.votes.classes] = True
                pairs.append(pairs_of(looks.votes))
                n += len(looks.shape)
                room -= looks.nbytes()
            self._kept.append(looks if room > 0 else None)
            number = self._memory.listing(numbers)[2]
            self._memory.voted_ids[evidence_of_voxels(self._memory, number)[1]] = 1
            yield 0
        if not n:
            return None
        self.columns = merged(columns)
        ids = np.flatnonzero(classes).astype(np.uint16)
        reduce(Pairs.and_those, pairs).check(len(ids))
        constants = self._settings.geometry
        whole = Whole(ids, self.columns.cells(constants.cell), n, constants.shrink)
        schedule = Schedule(constants.rounds, whole.estimate)
        while not schedule.ended:
            schedule.take((yield from self._sums(schedule, whole)))
        return schedule.parameters

    def _sums(self, schedule: Schedule, whole: Whole) -> Steps:
        """Yield 0 after each step; return the sums over the map that are wanted."""
        totals, known = Totals(whole.cells), None
        if schedule.parameters is not None:
            known = schedule.parameters.arrays()
        for model in self._models(whole):
            if model is not None:
                sums = model.start(schedule.rho) if known is None else \
                    model.round(within(known, model.cells))
                totals.add(sums, (cells_listed(model.cells[0]), cells_listed(model.cells[1])))
            yield 0
        return totals.sums()

    def _models(self, whole: Whole) -> Any:
        """Yield the model of each step, None where nothing is there."""
        for k, kept in enumerate(self._kept):
            if isinstance(kept, Looks):
                kept = self._kept[k] = self._model(kept, whole)
            if kept is not None:
                yield kept
                continue
            part = self._index[k * self._at_once:(k + 1) * self._at_once]
            for numbers in self._memory.pager.visit(part, *self._how):
                looks = self._look(numbers)
                yield None if looks is None else self._model(looks, whole)

    def _model(self, looks: Looks, whole: Whole) -> Any:
        assert self.columns is not None
        return model_of(looks, self.columns, whole.classes, self._settings.geometry)

    def _steps(self) -> Any:
        return self._memory.pager.visit(self._index, *self._how)

    def _look(self, numbers: NDArray[np.int64]) -> Optional[Looks]:
        """Return the Looks of blocks, None where nothing is there."""
        taken = surrounded(self._memory, self._settings, numbers, int(self._beside))
        if not taken.refined:
            return None
        return look(self._memory, taken, self._settings, self._beside)
