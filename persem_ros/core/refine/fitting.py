"""The parameters of the method geometry for a map of which a store holds the rest."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import Columns
from persem_ros.core.geometry.looks import look, Looks
from persem_ros.core.memory.reading import evidence_of_voxels
from persem_ros.core.refine.gathered import beside_wanted, Gathered, Steps
from persem_ros.core.refine.reach import surrounded

KEPT = 1 << 28      # bytes of looks that stay for the rounds; others are taken again in each


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

    """

    def __init__(self, memory: Any, settings: Any, index: NDArray[np.int32], at_once: int,
                 max_voxels: int, saves: bool = True) -> None:
        self._memory, self._settings, self._index = memory, settings, index
        self._at_once, self._how = at_once, (at_once, max_voxels, saves)
        self._beside = beside_wanted(memory)
        self._gathered = Gathered(settings.geometry)
        self._kept: list[Any] = []      # of each step the looks, later the model; None: not kept

    @property
    def columns(self) -> Optional[Columns]:
        """Return the Columns of the map, when the parameters are fitted."""
        return self._gathered.columns

    def parameters(self) -> Steps:
        """Yield 0 after each step; return the parameters, None for an empty map."""
        room = KEPT
        for numbers in self._memory.pager.visit(self._index, *self._how):
            looks = self._look(numbers)
            if looks is not None:
                self._gathered.add(looks)
                room -= looks.nbytes()
            self._kept.append(looks if room > 0 else None)
            number = self._memory.listing(numbers)[2]
            self._memory.voted_ids[evidence_of_voxels(self._memory, number)[1]] = 1
            yield 0
        return (yield from self._gathered.fit(self._models))

    def _models(self) -> Any:
        """Yield the model of each step, None where nothing is there."""
        for k, kept in enumerate(self._kept):
            if isinstance(kept, Looks):
                kept = self._kept[k] = self._gathered.model(kept)
            if kept is not None:
                yield kept
                continue
            part = self._index[k * self._at_once:(k + 1) * self._at_once]
            for numbers in self._memory.pager.visit(part, *self._how):
                looks = self._look(numbers)
                yield None if looks is None else self._gathered.model(looks)

    def _look(self, numbers: NDArray[np.int64]) -> Optional[Looks]:
        """Return the Looks of blocks, None where nothing is there."""
        taken = surrounded(self._memory, self._settings, numbers, int(self._beside))
        if not taken.refined:
            return None
        return look(self._memory, taken, self._settings, self._beside)
