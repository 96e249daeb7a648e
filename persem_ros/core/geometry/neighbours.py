"""Who is beside whom: the rows of a snapshot around each voxel, found once for all rounds."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.pools import SIDE

WIDE = SIDE + 2     # a block with a cell more on every side
TOGETHER = 4        # neighbours that are added up in one pass
AROUND = 26 + 2     # places in a list: as many as there can be neighbours, in whole passes


@kernel
def list_neighbours(begin, end, wanted, blocks, block, cell, row, where, listed, beside):
    """
    List the neighbours of the rows wanted[begin:end], at where[row].

    Parameters
    ----------
    begin, end : int
        Which of *wanted*.
    wanted : ndarray, int64
        Rows of a snapshot, those of a block together.
    blocks, block, cell, row
        The map's blocks, and of the snapshot as there; row is its row + 1 of a voxel number.
    where : ndarray, int32
        Place of a row among those that are labelled; -1: it is not.
    listed : ndarray, shape (n, AROUND), int32
        Receives places in lexicographic order, and the place n up to a whole pass: nobody's.
    beside : ndarray, shape (n,), uint8
        Receives how many there are.

    """
    near, here = np.zeros((WIDE, WIDE, WIDE), np.int32), np.int64(-1)
    nobody = len(listed)
    for w in range(begin, end):
        r = wanted[w]
        if block[r] != here:
            here = block[r]
            places_around(blocks, here, row, where, near)
        x, y, z = cell[r] >> 6, cell[r] >> 3 & 7, cell[r] & 7
        own, around = where[r], 0
        for dx in range(3):
            for dy in range(3):
                for dz in range(3):
                    place_of = near[x + dx, y + dy, z + dz]
                    listed[own, around] = place_of - 1
                    around += place_of != 0 and not (dx == 1 and dy == 1 and dz == 1)
        beside[own] = around
        for k in range(around, (around + TOGETHER - 1) // TOGETHER * TOGETHER):
            listed[own, k] = nobody


@inlined
def places_around(blocks, b, row, where, near):
    """Write where[row] + 1 of a block's voxels and of those around it; 0: none."""
    for x in range(WIDE):
        for y in range(WIDE):
            column = (((x + 7) >> 3) * 3 + ((y + 7) >> 3)) * 3
            at = (((x + 7) & 7) * SIDE + ((y + 7) & 7)) * SIDE
            for part in range(3):
                first, last = (0, 1) if part == 0 else (1, 9) if part == 1 else (9, 10)
                other = np.int64(blocks[b].near[column + part])
                if other == 0:
                    for z in range(first, last):
                        near[x, y, z] = 0
                    continue
                cells = blocks[other - 1].cells
                for z in range(first, last):
                    v = np.int64(cells[at + ((z + 7) & 7)])
                    found = np.int64(0)
                    if 0 < v <= len(row) and row[v - 1] > 0:
                        found = np.int64(where[np.int64(row[v - 1]) - 1]) + 1
                    near[x, y, z] = found
