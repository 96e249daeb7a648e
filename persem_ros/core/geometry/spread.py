"""
Cells within some cells of marked ones, along every axis: how far a change reaches.

A block's marks are 64 rows of 8 bits along z, or 8 slabs of 64: bit 8 y + z of slab x. Whole slabs
are moved at once, which takes a third of the time that rows take.

"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.pools import SIDE

MOST = SIDE         # cells: as far as the blocks that touch one reach
EACH_ROW = 0x0101010101010101
# Bits z >= k of every row, k = 0 .. 8.
FROM = np.array([EACH_ROW * (255 << k & 255) for k in range(SIDE + 1)], np.uint64)


def spread(blocks: NDArray[np.void], numbers: NDArray[np.int64], marks: NDArray[np.uint8],
           reach: int, out: NDArray[np.uint8]) -> None:
    """
    Mark, in some blocks, the cells within *reach* of marked ones.

    Parameters
    ----------
    blocks : ndarray, core.memory.pools.BLOCK
        The map's blocks.
    numbers : ndarray, int64
        Those to be looked at.
    marks, out : ndarray, shape (blocks, 64), uint8
        A bit per cell, in rows of 8 along z; the second receives marks and keeps its own.
    reach : int
        Cells, 8 at most, along every axis.

    """
    # Byte y of a slab is its row y, as numbers lie on all machines that ROS runs on.
    slabs, found = (a.view('<u8') for a in (marks, out))
    split(spread_slabs, len(numbers), blocks, numbers, slabs, reach, FROM, found, grain=256)


@kernel
def spread_slabs(begin, end, blocks, numbers, slabs, reach, from_bit, out):
    """Do spread() for numbers[begin:end]; from_bit is FROM."""
    planes = np.zeros(3 * SIDE, np.uint64)
    for p in range(begin, end):
        near, some = blocks[numbers[p]].near, np.uint64(0)
        for x in range(SIDE - reach, 2 * SIDE + reach):
            plane = np.uint64(0)
            for part in range(3):
                first = ((x >> 3) * 3 + part) * 3
                moved = along_z(np.int64(near[first]), np.int64(near[first + 1]),
                                np.int64(near[first + 2]), slabs, x & 7, reach, from_bit)
                plane |= along_y(moved, part, reach)
            planes[x] = plane
            some |= plane
        if some == 0:
            continue
        for x in range(SIDE):
            found = np.uint64(0)
            for d in range(-reach, reach + 1):
                found |= planes[SIDE + x + d]
            out[numbers[p], x] |= found


@inlined
def along_z(below, own, above, slabs, x, reach, from_bit):
    """Return slab x of a block, spread along z, with what comes from below and above."""
    bits = slabs[own - 1, x] if own > 0 else np.uint64(0)
    low = slabs[below - 1, x] if below > 0 else np.uint64(0)
    high = slabs[above - 1, x] if above > 0 else np.uint64(0)
    found = bits
    if bits | low | high:
        for k in range(1, reach + 1):
            up, down = np.uint64(k), np.uint64(SIDE - k)
            found |= bits << up & from_bit[k] | bits >> up & ~from_bit[SIDE - k]
            found |= low >> down & ~from_bit[k] | high << down & from_bit[SIDE - k]
    return found


@inlined
def along_y(bits, part, reach):
    """Return what a slab (part 1), or the one before (0) or after it (2), marks along y."""
    found = bits if part == 1 else np.uint64(0)
    if bits:
        for k in range(1, reach + 1):
            near, far = np.uint64(SIDE * k), np.uint64(SIDE * (SIDE - k))
            if part == 0:
                found |= bits >> far
            elif part == 2:
                found |= bits << far
            elif k < SIDE:          # a shift by 64 is none
                found |= bits << near | bits >> near
    return found
