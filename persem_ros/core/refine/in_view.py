"""Labels by other methods, and regions, of a refined map of which memory holds a part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.pools import longer, sparse_zeros
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.labelled import labelled, number_of_ids
from persem_ros.core.refine.regions import classify

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Refine


class InView:
    """
    What the whole map would be labelled, worked out where somebody looks (spec section 9).

    Nothing is observed any more while it is in use: a block is labelled when it is looked at, and
    anew when it has left memory since.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        With a pager, after core.refine.whole.refine_all().
    methods : sequence of str
        Of core.refine.labelled.LOCAL.
    settings : persem_ros.settings.config.Refine

    Attributes
    ----------
    labels : dict of str to ndarray, uint16
        By method, then by voxel number; those of the last look are right.
    codes : ndarray, uint8
        By voxel number, as of core.refine.regions.

    """

    def __init__(self, memory: VoxelMemory, methods: Sequence[str], settings: Refine) -> None:
        self._memory, self._methods, self._settings = memory, methods, settings
        self._done = sparse_zeros(0, np.int64)      # by block number: the turn after it, or 0
        self.codes = sparse_zeros(1, np.uint8)
        self.labels = {method: sparse_zeros(1, np.uint16) for method in methods}

    def look(self, voxels: NDArray[np.int32]) -> None:
        """Have the blocks of voxels (n, 3) in memory, and their voxels labelled."""
        memory, pager = self._memory, self._memory.pager
        assert pager is not None
        pager.need_voxels(voxels)
        numbers = block_numbers(memory, np.unique(voxels >> 3, axis=0))
        numbers = numbers[numbers >= 0]
        if memory.n_blocks > len(self._done):
            self._done = longer(self._done, 2 * memory.n_blocks)
        fresh = numbers[pager.moved_since(numbers, self._done[numbers] - 1)]
        if len(fresh):
            pager.need_around(fresh)
            self._work_out(fresh)
            self._done[fresh] = pager.turn + 1

    def _work_out(self, blocks: NDArray[np.int64]) -> None:
        """Label and classify the voxels of some blocks."""
        memory, settings = self._memory, self._settings
        taken = snapshot.take(memory, settings.neighbours, blocks)
        number = taken.number[:taken.refined]
        if memory.n_numbers > len(self.codes):
            n = 2 * memory.n_numbers
            self.codes = longer(self.codes, n)
            self.labels = {method: longer(own, n) for method, own in self.labels.items()}
        for method, own in self.labels.items():
            own[number] = labelled(memory, taken, method, settings,
                                   memory.volatility(), number_of_ids(memory))[0]
        unused = np.empty(memory.n_numbers, np.float32)
        classify(memory, taken, settings.neighbours, self.codes, unused, unused)
