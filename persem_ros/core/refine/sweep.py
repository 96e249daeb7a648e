"""Which blocks have yet to see the present class volatility (spec section 9, *Flat*)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.blocks import find_block
from persem_ros.core.memory.voxel_table import sort_order

AT_ONCE = 4096      # blocks that the mapping thread may sort itself


class Sweep:
    """
    The blocks of a map in ascending index, and how far refinements have come.

    Blocks that come later need no place here: they are new, hence visited as changed.

    Parameters
    ----------
    blocks : ndarray
        The pool of blocks.
    n_blocks : int
        All block numbers are below this.
    pressing : bool
        Whether labels of blocks that it has not come to go by what is out of date.

    Attributes
    ----------
    order : ndarray, shape (n, 3), int32, or None
        Indices of the blocks; None before prepare().
    at : int
        Those before this place were handed to a refinement.

    """

    def __init__(self, blocks: NDArray[np.void], n_blocks: int, pressing: bool = False) -> None:
        self._blocks, self._n_blocks, self.pressing = blocks, n_blocks, pressing
        self.order: NDArray[np.int32] | None = None
        self.at = 0
        if n_blocks <= AT_ONCE:
            self.prepare()

    @property
    def ended(self) -> bool:
        """Return whether every block has been handed to a refinement."""
        return self.order is not None and self.at >= len(self.order)

    def prepare(self) -> None:
        """
        Sort the blocks; any thread may do so, beside the mapping.

        An index never changes while a refinement is under way, for no block leaves then.

        """
        if self.order is None:
            live = np.flatnonzero(self._blocks['near'][:self._n_blocks, 13])
            index = self._blocks['index'][live]
            self.order = index[sort_order(index)]


def next_blocks(sweep: Sweep | None, blocks: NDArray[np.void], table: NDArray[np.uint32],
                voxels: int) -> NDArray[np.int64]:
    """Return the numbers of the next blocks of a sweep, with *voxels* voxels or a few more."""
    if sweep is None or sweep.order is None:
        return np.empty(0, np.int64)
    numbers = np.empty(min(voxels, len(sweep.order) - sweep.at), np.int64)
    n, sweep.at = _collect(blocks, table, sweep.order, sweep.at, voxels, numbers)
    return numbers[:n]


@kernel
def _collect(blocks, table, order, at, voxels, numbers):
    """Write the numbers of blocks order[at:] until they hold enough; return how many, and at."""
    n, held = 0, 0
    while at < len(order) and held < voxels and n < len(numbers):
        b = find_block(blocks, table, np.int64(order[at, 0]), np.int64(order[at, 1]),
                       np.int64(order[at, 2]))
        at += 1
        if b >= 0:          # else it was let go
            numbers[n] = b
            n += 1
            held += np.int64(blocks[b].count)
    return n, at
