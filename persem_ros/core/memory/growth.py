"""A larger hash table, filled beside the one in use a part a frame (spec section 9, *Flat*)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.blocks import insert_block, new_table
from persem_ros.core.memory.pools import BLOCKS

if TYPE_CHECKING:
    from persem_ros.core.memory.pools import Pools

PART = 4096         # blocks that are entered a frame, below a millisecond


class Growth:
    """
    A hash table in the making; new blocks get numbers that it has yet to come to.

    It is of no use any more when a block leaves, or takes the number of one that left.

    """

    def __init__(self, blocks: int) -> None:
        self.table: NDArray[np.uint32] = new_table(blocks)
        self._at = 0

    def step(self, pools: Pools, part: int = PART) -> bool:
        """Enter the next *part* blocks; return whether all are in."""
        stop = min(self._at + part, int(pools.used[BLOCKS]))
        _enter_blocks(pools.blocks, self.table, self._at, stop)
        self._at = stop
        return stop == pools.used[BLOCKS]


@kernel
def _enter_blocks(blocks, table, start, stop):
    """Enter the blocks start .. stop into a table that has room."""
    for b in range(start, stop):
        if blocks[b].near[13] == b + 1:     # not a dropped one
            insert_block(blocks, table, b)
