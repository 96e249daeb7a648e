"""
What a refinement is handed at its start, so that it can compute beside further frames.

The mapping thread takes a Snapshot between two frames: a copy of the evidence of the voxels to be
refined and of all around them, and how long their histories are. What the refinement reads
besides never changes under it: links of histories are only ever filled further, and neighbours
that came later are not in the snapshot. So there is no lock at all.

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.evidence import count_classes, read_evidence
from persem_ros.core.memory.history import TOGETHER
from persem_ros.core.memory.pools import CLOCK, ROWS, SIDE, sparse_zeros

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    Evidence of n voxels, the first r of which are to be refined.

    Attributes
    ----------
    block, cell, number : ndarray, shape (n,), int64
        Where each voxel lies.
    index : ndarray, shape (n, 3), int32
        The voxels.
    refined : int
        r.
    row : ndarray, shape (voxels of the map,), int32
        Row + 1 of a voxel number; 0: not in the snapshot.
    start : ndarray, shape (n + 1,), int64
        Row i's evidence is at start[i] : start[i + 1] of classes and shares.
    classes : ndarray, uint16
    shares : ndarray, float64
        p_v(c) = h_v(c) / sum of h_v.
    majority : ndarray, shape (n,), uint16
    observations, first, head : ndarray, shape (n,), uint32
        Length of the history, number of its first link's first observation, that link + 1.
    frame_t : ndarray, shape (frames,), int32
        t of every frame.
    placed : ndarray, shape (frames, 4, 4), float64
        Where the observations of every frame lie from, T_map_sensor.
    relief : core.geometry.relief.Relief, or None
        For the method geometry, of the same moment; the next two are of use with it alone.
    reshaped : ndarray, int64
        Rows whose shape changed.
    swept : int
        So many of the refined rows, the first, are of the blocks that a sweep had reached.

    """

    block: np.ndarray
    cell: np.ndarray
    number: np.ndarray
    index: np.ndarray
    refined: int
    row: np.ndarray
    start: np.ndarray
    classes: np.ndarray
    shares: np.ndarray
    majority: np.ndarray
    observations: np.ndarray
    first: np.ndarray
    head: np.ndarray
    frame_t: np.ndarray
    placed: np.ndarray
    relief: Any = None
    reshaped: Any = None
    swept: int = 0


def take(memory: VoxelMemory, neighbours: int | None = None, also: Any = (),
         shares: bool = True) -> Snapshot:
    """
    Return a Snapshot of the whole map or, with a neighbourhood, of what changed.

    With *neighbours* (6, 18 or 26) the voxels to be refined are those whose own or neighbouring
    evidence changed since the last call of settle(), and those of the blocks *also* (numbers);
    the snapshot holds these and the ring around them. shares: as of copied().

    """
    if neighbours is None:
        block, cell, number = memory.listing()
        refined = len(number)
    else:
        block, cell, number, refined = _changed(memory, neighbours, np.asarray(also, np.int64))
    if memory.n_gone:
        present = memory.m.voxels['gone'][number] == 0
        refined = int(np.count_nonzero(present[:refined]))
        block, cell, number = block[present], cell[present], number[present]
    return copied(memory, block, cell, number, refined, shares)


def copied(memory: VoxelMemory, block: NDArray[np.int64], cell: NDArray[np.int64],
           number: NDArray[np.int64], refined: int, shares: bool = True) -> Snapshot:
    """
    Return the Snapshot of the given voxels, the first *refined* of which are to be refined.

    Without *shares* its classes and shares have room, but no content.

    """
    pools, n = memory.m, len(number)
    row = sparse_zeros(memory.n_numbers, np.int32)
    row[number] = np.arange(1, n + 1, dtype=np.int32)
    start = np.zeros(n + 1, np.int64)
    majority, observations, first, head = (np.empty(n, t) for t in ('u2', 'u4', 'u4', 'u4'))
    split(_copy, n, pools.voxels, pools.spills, number, start[1:], majority, observations, first,
          head)
    np.cumsum(start, out=start)
    index = np.empty((n, 3), np.int32)
    split(_place, n, pools.blocks, block, cell, index)
    classes, p = np.empty(start[-1], np.uint16), np.empty(start[-1])
    if shares:
        split(_share, n, pools.voxels, pools.spills, number, start, classes, p)
    return Snapshot(block, cell, number, index, refined, row, start, classes, p, majority,
                    observations, first, head, memory.frames.here('t'),
                    memory.frames.here('placed'))


def settle(memory: VoxelMemory) -> None:
    """Mark every voxel as unchanged: a refinement has been handed all changes so far."""
    changed = memory.changed_blocks()
    memory.m.blocks['changed'][changed] = 0
    memory.settled = memory.clock
    memory.m.used[CLOCK] += 1
    memory.m.stamps['stored'][changed] = memory.clock


def settle_blocks(memory: VoxelMemory, numbers: NDArray[np.int64]) -> None:
    """Mark every voxel of some blocks as unchanged."""
    marked = numbers[memory.m.blocks['changed'][numbers].any(axis=1)]
    memory.m.used[CLOCK] += 1
    memory.m.blocks['changed'][marked] = 0
    memory.m.stamps['stored'][marked] = memory.clock


def nothing(memory: VoxelMemory) -> Snapshot:
    """Return the Snapshot of no voxel."""
    none = np.empty(0, np.int64)
    return copied(memory, none, none, none, 0, shares=False)


def _changed(
        memory: VoxelMemory, neighbours: int, also: Any
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], int]:
    """Return (block, cell, number) of the snapshot's voxels, refined ones first, and how many."""
    blocks, n = memory.m.blocks, memory.n_blocks
    dirty = memory.changed_blocks()
    reach = {6: 0, 18: 1, 26: 2}[neighbours]
    marks, needed, changed = (sparse_zeros((n, ROWS), np.uint8) for _ in range(3))
    changed[dirty] = blocks['changed'][dirty]
    nearby = blocks_around(blocks, dirty, n)
    dilate(blocks, nearby, changed, reach, marks)
    marks[also] = 255
    nearby = np.union1d(nearby, also)
    further = blocks_around(blocks, nearby, n)
    dilate(blocks, further, marks, reach, needed)
    size = int(blocks['count'][further].sum())
    block, cell, number = (np.empty(size, np.int64) for _ in range(3))
    refined = list_marked(blocks, nearby, marks, block, cell, number, 0)
    needed[nearby] &= ~marks[nearby]
    total = list_marked(blocks, further, needed, block, cell, number, refined)
    return block[:total], cell[:total], number[:total], refined


def blocks_around(
        blocks: NDArray[np.void], numbers: NDArray[np.int64], n_blocks: int) -> NDArray[np.int64]:
    """Return the sorted numbers of the given blocks and of those that touch them."""
    found = np.zeros(n_blocks + 1, bool)
    found[blocks['near'][numbers].reshape(-1)] = True
    found[numbers + 1] = True
    return np.flatnonzero(found[1:])


@kernel
def dilate(blocks, numbers, rows, reach, out):
    """
    Write the cells of the given blocks that are marked or neighbours of a marked cell.

    A block's marks are 64 rows of 8 bits, along z. reach is 0, 1, 2 for 6, 18, 26 neighbours:
    a step along both x and y may then go on along z (26), or not (18), or is none (6).

    """
    padded = np.zeros((10, 10), np.uint16)      # bits 1 .. 8 are the block's own z
    for b in numbers:
        near = blocks[b].near
        for x in range(10):
            for y in range(10):
                column = (((x + 7) >> 3) * 3 + ((y + 7) >> 3)) * 3
                row = ((x + 7) & 7) * SIDE + ((y + 7) & 7)
                below, own, above = near[column], near[column + 1], near[column + 2]
                bits = np.uint16(0)
                if own:
                    bits |= np.uint16(rows[own - 1, row]) << np.uint16(1)
                if below:
                    bits |= np.uint16(rows[below - 1, row]) >> np.uint16(7)
                if above:
                    bits |= np.uint16(rows[above - 1, row] & 1) << np.uint16(9)
                padded[x, y] = bits
        for x in range(SIDE):
            for y in range(SIDE):
                own = padded[x + 1, y + 1]
                cross = padded[x, y + 1] | padded[x + 2, y + 1] | padded[x + 1, y] \
                    | padded[x + 1, y + 2]
                corners = padded[x, y] | padded[x, y + 2] | padded[x + 2, y] \
                    | padded[x + 2, y + 2]
                still = own | cross
                if reach >= 1:
                    still |= corners
                moved = own
                if reach >= 1:
                    moved |= cross
                if reach == 2:
                    moved |= corners
                still |= moved << np.uint16(1) | moved >> np.uint16(1)
                out[b, x * SIDE + y] = np.uint8(still >> np.uint16(1) & np.uint16(255))


@kernel
def list_marked(blocks, numbers, rows, block_of, cell_of, voxel_of, n):
    """List the marked voxels of the given blocks from place n on; return the end."""
    for b in numbers:
        cells = blocks[b].cells
        for row in range(ROWS):
            bits = np.int64(rows[b, row])
            if bits == 0:
                continue
            for z in range(SIDE):
                if bits >> z & 1:
                    cell = row * SIDE + z
                    v = np.int64(cells[cell])
                    if v > 0:
                        block_of[n], cell_of[n], voxel_of[n] = b, cell, v - 1
                        n += 1
    return n


@kernel
def _place(begin, end, blocks, block, cell, index):
    """Write the index of each voxel."""
    for r in range(begin, end):
        corner = blocks[block[r]].index
        index[r, 0] = corner[0] * SIDE + (cell[r] >> 6)
        index[r, 1] = corner[1] * SIDE + (cell[r] >> 3 & 7)
        index[r, 2] = corner[2] * SIDE + (cell[r] & 7)


@kernel
def _copy(begin, end, voxels, spills, number, counts, majority, observations, first, head):
    """Copy what the snapshot holds of each voxel's record, and how many classes it has seen."""
    fetched = np.int64(0)       # returned, so that it is done: several records are awaited at once
    for r in range(begin, end):
        if (r - begin) % TOGETHER == 0:
            for q in range(r, min(r + TOGETHER, end)):
                fetched += voxels[number[q]].n
        voxel = voxels[number[r]]
        counts[r] = count_classes(voxel, spills)
        majority[r] = voxel.majority
        observations[r] = voxel.n
        first[r] = voxel.first
        head[r] = voxel.head
    return fetched


@kernel
def _share(begin, end, voxels, spills, number, start, classes, shares):
    """Copy the classes and shares of the evidence of each voxel."""
    for r in range(begin, end):
        read_evidence(voxels[number[r]], spills, classes, shares, start[r])
        total = 0.0
        for e in range(start[r], start[r + 1]):
            total += shares[e]
        for e in range(start[r], start[r + 1]):
            shares[e] /= total
