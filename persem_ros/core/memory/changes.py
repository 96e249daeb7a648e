"""What changed in a map since somebody last looked, a slice at a time (spec section 9, *Flat*)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.pools import SIDE, sparse_zeros
from persem_ros.core.memory.voxel_memory import VoxelMemory


@dataclass(frozen=True, eq=False)
class Changed:
    """
    The blocks that changed.

    Attributes
    ----------
    index : ndarray, shape (b, 3), int32
        Indices of the blocks.
    counts : ndarray, shape (b,), int64
        How many voxels lie in each, those left out whose content moved away.
    columns : dict
        As VoxelMemory.columns() returns them, of the voxels of these blocks, block after block.
    forgotten, left : ndarray, shape (., 3), int32
        Indices of blocks that are no more, and of those that left memory for a file; they may
        have come back since.
    anew : bool
        What was handed over before is of no use: it came of another map.
    complete : bool
        Nothing that changed was left for the next time.

    """

    index: NDArray[np.int32]
    counts: NDArray[np.int64]
    columns: dict[str, NDArray[Any]]
    forgotten: NDArray[np.int32]
    left: NDArray[np.int32]
    anew: bool
    complete: bool


class Changes:
    """
    Knows which state of each block it has handed over; a reader each has one of its own.

    Only the thread that owns the map may call take(). What it costs grows with what changed; of
    each block in memory it reads 16 bytes, a tenth of a millisecond for 5 million voxels.

    """

    def __init__(self) -> None:
        self._memory: VoxelMemory | None = None
        self._told = sparse_zeros(0, np.int64)
        self.gone: list[tuple[bool, NDArray[np.int32]]] = []    # what drop() reports

    def take(self, memory: VoxelMemory, centre: ArrayLike = (0.0, 0.0, 0.0),
             most: int = 100_000) -> Changed:
        """
        Return what changed since the last time.

        Parameters
        ----------
        memory : VoxelMemory
            The map.
        centre : sequence of 3 floats
            Where there are more voxels than *most*, the blocks nearest to this point go first.
            Metres in the map frame.
        most : int
            Voxels at a time; the last block may exceed it.

        """
        anew = memory is not self._memory
        if anew:
            self.close()
            self._memory, self._told = memory, sparse_zeros(4096, np.int64)
            memory.viewers.add(self)
        n = memory.n_blocks
        if n > len(self._told):
            told = sparse_zeros(2 * n, np.int64)
            told[:len(self._told)] = self._told
            self._told = told
        found = np.flatnonzero(memory.m.stamps['shown'][:n] > self._told[:n])
        counts, away = np.empty(len(found), np.int64), np.empty(len(found))
        _measure(memory.m.blocks, found, SIDE * memory.voxel_size,
                 np.asarray(centre, float) - memory.origin, counts, away)
        self._told[found[counts == 0]] = memory.clock       # they left memory
        found, away, counts = found[counts > 0], away[counts > 0], counts[counts > 0]
        complete = int(counts.sum()) <= most
        if not complete:
            order = np.argsort(away, kind='stable')
            order = order[:int(np.searchsorted(np.cumsum(counts[order]), most)) + 1]
            found, counts = found[order], counts[order]
        self._told[found] = memory.clock
        listed = memory.listing(found, present=True)
        if memory.n_gone:
            place = sparse_zeros(n, np.int64)
            place[found] = np.arange(len(found))
            counts = np.bincount(place[listed[0]], minlength=len(found))
        gone, self.gone = self.gone, []
        forgotten, left = (
            np.concatenate([np.empty((0, 3), np.int32), *(index for kept, index in gone
                                                          if kept == wanted)])
            for wanted in (False, True))
        return Changed(memory.m.blocks['index'][found], counts, memory.columns_of(*listed),
                       forgotten, left, anew, complete)

    def close(self) -> None:
        """Begin anew with the next take()."""
        if self._memory is not None:
            self._memory.viewers.discard(self)
        self._memory, self.gone = None, []


@kernel
def _measure(blocks, numbers, edge, centre, counts, away):
    """Write how many voxels each block holds, 0 where it left, and its squared distance."""
    for p in range(len(numbers)):
        block = blocks[numbers[p]]
        if block.near[13] == 0:
            counts[p] = 0
            away[p] = 0.0
            continue
        counts[p] = block.count
        away[p] = 0.0
        for axis in range(3):
            d = (block.index[axis] + 0.5) * edge - centre[axis]
            away[p] += d * d
