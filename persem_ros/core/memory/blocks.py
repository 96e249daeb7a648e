"""Finding voxels: the hash over blocks, and a voxel's neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.pools import BLOCKS, CELLS, FIRST_BLOCK, FREE_BLOCKS, SIDE

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory


@inlined
def hash3(i, j, k):
    """Return a well mixed unsigned 64-bit hash of three integers."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(k) * np.uint64(0x165667B19E3779F9)
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return h ^ (h >> np.uint64(32))


@inlined
def find_block(blocks, table, bi, bj, bk):
    """Return the number of the block at (bi, bj, bk), or -1."""
    mask = np.uint64(len(table) - 1)
    place = hash3(bi, bj, bk) & mask
    while table[place] != 0:
        b = np.int64(table[place]) - 1
        index = blocks[b].index
        if index[0] == bi and index[1] == bj and index[2] == bk:
            return b
        place = (place + np.uint64(1)) & mask
    return -1


@inlined
def insert_block(blocks, table, b):
    """Enter block *b* into the hash table, which has room."""
    mask = np.uint64(len(table) - 1)
    i, j, k = blocks[b].index
    place = hash3(np.int64(i), np.int64(j), np.int64(k)) & mask
    while table[place] != 0:
        place = (place + np.uint64(1)) & mask
    table[place] = b + 1


@inlined
def remove_block(blocks, table, b):
    """Take block *b* out of the hash table and close the gap that it leaves."""
    mask = np.uint64(len(table) - 1)
    i, j, k = blocks[b].index
    gap = hash3(np.int64(i), np.int64(j), np.int64(k)) & mask
    while np.int64(table[gap]) != b + 1:
        gap = (gap + np.uint64(1)) & mask
    place = (gap + np.uint64(1)) & mask
    while table[place] != 0:
        i, j, k = blocks[np.int64(table[place]) - 1].index
        home = hash3(np.int64(i), np.int64(j), np.int64(k)) & mask
        # An entry may move up to the gap where that is not before the place it was made for.
        if (place - home) & mask >= (place - gap) & mask:
            table[gap] = table[place]
            gap = place
        place = (place + np.uint64(1)) & mask
    table[gap] = 0


@inlined
def make_block(blocks, used, table, bi, bj, bk):
    """Add an empty block, tie it to its neighbours and return its number."""
    if used[FIRST_BLOCK] > 0:       # one that was dropped
        b = used[FIRST_BLOCK] - 1
        used[FIRST_BLOCK] = blocks[b].count
        used[FREE_BLOCKS] -= 1
        blocks[b].count = 0
    else:
        b = used[BLOCKS]
        used[BLOCKS] = b + 1
    blocks[b].index[0] = bi
    blocks[b].index[1] = bj
    blocks[b].index[2] = bk
    insert_block(blocks, table, b)
    for d in range(27):
        other = find_block(blocks, table, bi + d // 9 - 1, bj + d // 3 % 3 - 1, bk + d % 3 - 1)
        if other >= 0:
            blocks[b].near[d] = other + 1
            blocks[other].near[26 - d] = b + 1
    return b


@kernel
def find_voxels(start, stop, blocks, table, voxels, out):
    """Write the voxel number of each row of voxels (n, 3) int32 to out (n,) int64; -1: none."""
    seen = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(start, stop):
        i, j, k = np.int64(voxels[p, 0]), np.int64(voxels[p, 1]), np.int64(voxels[p, 2])
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:    # most follow one of the same block
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            seen = find_block(blocks, table, oi, oj, ok)
        if seen < 0:
            out[p] = -1
        else:
            out[p] = np.int64(blocks[seen].cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)]) - 1


@kernel
def find_blocks(blocks, table, index, numbers):
    """Write the number of each block, -1 for none."""
    for p in range(len(index)):
        numbers[p] = find_block(blocks, table, np.int64(index[p, 0]), np.int64(index[p, 1]),
                                np.int64(index[p, 2]))


@inlined
def step(block, cell, d):
    """
    Return (block number + 1 or 0, cell) of the neighbour of a block's cell in direction d.

    d = ((dx + 1) * 3 + dy + 1) * 3 + dz + 1, so 0 .. 26 in lexicographic (dx, dy, dz) order.

    """
    x = (cell >> 6) + d // 9 - 1
    y = (cell >> 3 & 7) + d // 3 % 3 - 1
    z = (cell & 7) + d % 3 - 1
    near = block.near
    other = near[(((x >> 3) + 1) * 3 + (y >> 3) + 1) * 3 + (z >> 3) + 1]
    return np.int64(other), ((x & 7) * SIDE + (y & 7)) * SIDE + (z & 7)


@kernel
def list_voxels(blocks, numbers, block_of, cell_of, voxel_of):
    """List the voxels of the given blocks in (block, cell) order; returns how many."""
    n = 0
    for b in numbers:
        if blocks[b].near[13] != b + 1:     # dropped
            continue
        cells = blocks[b].cells
        for cell in range(CELLS):
            v = np.int64(cells[cell])
            if v:
                block_of[n] = b
                cell_of[n] = cell
                voxel_of[n] = v - 1
                n += 1
    return n


def block_numbers(memory: VoxelMemory, index: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the numbers of the blocks with the given indices (n, 3), -1 for those not here."""
    numbers = np.empty(len(index), np.int64)
    find_blocks(memory.m.blocks, memory.table, np.require(index, np.int32, 'C'), numbers)
    return numbers


def directions(neighbours: int) -> NDArray[np.int64]:
    """Return the directions of the 6, 18 or 26 neighbours, lexicographic, as int64."""
    most = {6: 1, 18: 2, 26: 3}[neighbours]
    return np.array([d for d in range(27) if 0 < sum(
        abs(x - 1) for x in (d // 9, d // 3 % 3, d % 3)) <= most], np.int64)


def new_table(blocks: int) -> NDArray[np.uint32]:
    """Return an empty hash table with room for *blocks* blocks, at most half full."""
    return np.zeros(1 << max(10, int(2 * blocks - 1).bit_length()), np.uint32)
