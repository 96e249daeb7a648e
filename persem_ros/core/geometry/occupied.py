"""Occupied cells as bits, 64 rows of 8 along z a block, and columns below them. Kernels only."""

import numpy as np
from persem_ros.core.jit import kernel
from persem_ros.core.memory.pools import ROWS, SIDE


@kernel
def read_bits(begin, end, blocks, voxels, numbers, look, bits):
    """Write which cells of the blocks numbers[begin:end] hold a voxel that is not gone."""
    for b in range(begin, end):
        cells = blocks[numbers[b]].cells
        for row in range(ROWS):
            found = 0
            for z in range(SIDE):
                v = np.int64(cells[row * SIDE + z])
                if v > 0 and not (look and voxels[v - 1].gone > 0):
                    found |= 1 << z
            bits[b, row] = found


@kernel
def lower_columns(numbers, tile, came, corner, up, lowest, changed):
    """Lower the columns of the cells that came, bits (b, 64); mark the tiles where one changed."""
    place = np.zeros(3, np.int64)
    for b in range(len(numbers)):
        t = tile[numbers[b]]
        for row in range(ROWS):
            if came[b, row] == 0:
                continue
            for z in range(SIDE):
                if came[b, row] >> z & 1 == 0:
                    continue
                place[0], place[1], place[2] = row >> 3, row & 7, z
                i, j, k = place[up[0]], place[up[1]], place[up[2]]
                if up[3]:
                    k = 7 - k
                column = i * SIDE + j
                height = corner[b, 2] * SIDE + k
                if height < lowest[t, column]:
                    lowest[t, column] = height
                    changed[t] = 1


@kernel
def mark_columns(numbers, tile, bits, changed, i_axis, j_axis, marks):
    """Mark the occupied cells of blocks in the columns that changed, (t, 64), tile (b,) of it."""
    place = np.zeros(3, np.int64)
    for p in range(len(numbers)):
        b, columns = numbers[p], changed[tile[p]]
        for row in range(ROWS):
            if bits[b, row] == 0:
                continue
            found = 0
            for z in range(SIDE):
                place[0], place[1], place[2] = row >> 3, row & 7, z
                if columns[place[i_axis] * SIDE + place[j_axis]]:
                    found |= 1 << z
            marks[b, row] = bits[b, row] & found
