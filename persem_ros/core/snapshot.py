"""
What a refinement is handed at its start, so that it can compute beside further frames.

The mapping thread takes a Snapshot between two frames: a copy of the evidence of the voxels to be
refined and of all around them, and how long their histories are. What the refinement reads
besides never changes under it: links of histories are only ever filled further, and neighbours
that came later are not in the snapshot. So there is no lock at all.

"""

from dataclasses import dataclass

import numpy as np

from persem_ros.core.append import count_classes, read_evidence
from persem_ros.core.blocks import list_voxels, step
from persem_ros.core.jit import kernel, split
from persem_ros.core.pools import CELLS


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    Evidence of n voxels, the first r of which are to be refined.

    Attributes
    ----------
    block, cell, number : ndarray, shape (n,), int64
        Where each voxel lies.
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

    """

    block: np.ndarray
    cell: np.ndarray
    number: np.ndarray
    refined: int
    row: np.ndarray
    start: np.ndarray
    classes: np.ndarray
    shares: np.ndarray
    majority: np.ndarray
    observations: np.ndarray
    first: np.ndarray
    head: np.ndarray


def take(memory, neighbours=None):
    """
    Return a Snapshot of the whole map or, with the *directions* of neighbours, of what changed.

    With *neighbours* (core.blocks.directions) the voxels to be refined are those whose own or
    neighbouring evidence changed since the last call of settle(); the snapshot holds all voxels
    of their blocks and of the blocks around, which is cheaper to list than the exact ring.

    """
    pools = memory.m
    if neighbours is None:
        block, cell, number = memory.listing()
        refined = len(number)
    else:
        block, cell, number, refined = _changed(memory, neighbours)
    n = len(number)
    row = np.zeros(memory.n_voxels, np.int32)
    row[number] = np.arange(1, n + 1, dtype=np.int32)
    start = np.zeros(n + 1, np.int64)
    split(_count, n, pools.voxels, pools.spills, number, start[1:])
    np.cumsum(start, out=start)
    classes, shares = np.empty(start[-1], np.uint16), np.empty(start[-1])
    majority, observations, first, head = (np.empty(n, t) for t in ('u2', 'u4', 'u4', 'u4'))
    split(_copy, n, pools.voxels, pools.spills, number, start, classes, shares, majority,
          observations, first, head)
    return Snapshot(block, cell, number, refined, row, start, classes, shares, majority,
                    observations, first, head)


def settle(memory):
    """Mark every voxel as unchanged: a refinement has been handed all changes so far."""
    pools = memory.m
    _settle(np.flatnonzero(pools.blocks['dirty'][:memory.n_blocks]), pools.blocks, pools.voxels)


def _changed(memory, neighbours):
    """Return (block, cell, number) of the snapshot's voxels, refined ones first, and how many."""
    blocks, voxels = memory.m.blocks, memory.m.voxels
    dirty = np.flatnonzero(blocks['dirty'][:memory.n_blocks])
    marks = np.zeros(memory.n_voxels, np.uint8)
    _mark(dirty, blocks, voxels, neighbours, marks)
    nearby = _around(blocks, dirty, memory.n_blocks)        # where marked voxels may lie
    further = _around(blocks, nearby, memory.n_blocks)      # and their neighbours
    size = int(blocks['count'][further].sum())
    block, cell, number = (np.empty(size, np.int64) for _ in range(3))
    list_voxels(blocks, further, block, cell, number)
    order = np.argsort(marks[number] == 0, kind='stable')
    return block[order], cell[order], number[order], int(np.count_nonzero(marks[number]))


def _around(blocks, numbers, n_blocks):
    """Return the sorted numbers of the given blocks and of those that touch them."""
    found = np.zeros(n_blocks + 1, bool)
    found[blocks['near'][numbers].reshape(-1)] = True
    found[numbers + 1] = True
    return np.flatnonzero(found[1:])


@kernel
def _mark(numbers, blocks, voxels, neighbours, marks):
    """Mark the changed voxels of the given blocks and their neighbours."""
    for b in numbers:
        block = blocks[b]
        cells = block.cells
        for cell in range(CELLS):
            v = np.int64(cells[cell]) - 1
            if v < 0 or voxels[v].dirty == 0:
                continue
            marks[v] = 1
            for d in neighbours:
                other, place = step(block, cell, d)
                if other > 0:
                    beside = blocks[other - 1].cells
                    u = np.int64(beside[place])
                    if u > 0:
                        marks[u - 1] = 1


@kernel
def _settle(numbers, blocks, voxels):
    """Clear the marks of change in the given blocks."""
    for b in numbers:
        blocks[b].dirty = 0
        cells = blocks[b].cells
        for cell in range(CELLS):
            v = np.int64(cells[cell])
            if v > 0:
                voxels[v - 1].dirty = 0


@kernel
def _count(begin, end, voxels, spills, number, counts):
    """Write how many classes each voxel has seen."""
    for r in range(begin, end):
        counts[r] = count_classes(voxels[number[r]], spills)


@kernel
def _copy(begin, end, voxels, spills, number, start, classes, shares, majority, observations,
          first, head):
    """Copy what the snapshot holds of each voxel."""
    for r in range(begin, end):
        voxel = voxels[number[r]]
        read_evidence(voxel, spills, classes, shares, start[r])
        total = 0.0
        for e in range(start[r], start[r + 1]):
            total += shares[e]
        for e in range(start[r], start[r + 1]):
            shares[e] /= total
        majority[r] = voxel.majority
        observations[r] = voxel.n
        first[r] = voxel.first
        head[r] = voxel.head
