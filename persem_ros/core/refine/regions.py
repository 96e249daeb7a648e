"""Difficult regions, from histories and majority labels alone (spec section 6)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import directions, step
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.refine.snapshot import take

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.core.refine.snapshot import Snapshot

HIGH_SWITCH_RATE = 0.3
HIGH_ENTROPY = 0.5          # nat
LOW_MARGIN = 0.3
REGIONS = {'boundary': 1, 'difficult_core': 2, 'high_switch': 4}     # bits of a region code


def regions(
        memory: VoxelMemory, neighbours: int = 26
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
    """
    Return the regions of every voxel.

    Returns
    -------
    codes : ndarray, shape (voxels,), uint8
        By voxel number, the sum of the bits of REGIONS: *boundary* (a neighbour has another
        majority label), *high switch* (label changes / (N_v - 1) > 0.3), *difficult core* (at
        least two of: entropy of p_v > 0.5 nat, top-two margin of p_v < 0.3, high switch,
        boundary).
    entropy : ndarray, shape (voxels,), float32
        Of p_v, nat.
    switch_rate : ndarray, shape (voxels,), float32

    """
    n = memory.n_numbers
    codes, entropy, rate = np.zeros(n, np.uint8), np.zeros(n, np.float32), np.zeros(n, np.float32)
    classify(memory, take(memory), neighbours, codes, entropy, rate)
    return codes, entropy, rate


def classify(memory: VoxelMemory, taken: Snapshot, neighbours: int, codes: NDArray[np.uint8],
             entropy: NDArray[np.float32], rate: NDArray[np.float32]) -> None:
    """Write what regions() returns of a snapshot's refined rows, by voxel number."""
    split(_classify, taken.refined, memory.m.blocks, memory.m.voxels, taken.block, taken.cell,
          taken.number, taken.start, taken.shares, directions(neighbours), codes, entropy, rate)


def region_image(codes: NDArray[np.uint8], voxels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Return the codes of a voxel image (h, w), -1 for no voxel: (h, w) uint8, 0 for none."""
    image = np.empty(voxels.shape, np.uint8)
    split(_look_up, voxels.size, codes, voxels.reshape(-1), image.reshape(-1), grain=1 << 20)
    return image


@kernel
def _look_up(begin, end, codes, voxels, image):
    """Write the code of each pixel's voxel."""
    for p in range(begin, end):
        image[p] = codes[voxels[p]] if voxels[p] >= 0 else 0


@kernel
def _classify(begin, end, blocks, voxels, block, cell, number, start, shares, neighbours, codes,
              entropy, rate):
    """Classify rows begin .. end of a snapshot."""
    for r in range(begin, end):
        v = number[r]
        nats, top, second, boundary = 0.0, 0.0, 0.0, 0
        for e in range(start[r], start[r + 1]):
            p = shares[e]
            if p > 0.0:
                nats -= p * np.log(p)
            if p > top:
                top, second = p, top
            elif p > second:
                second = p
        for d in neighbours:
            other, place = step(blocks[block[r]], cell[r], d)
            if other == 0:
                continue
            u = np.int64(blocks[other - 1].cells[place])
            if u > 0 and voxels[u - 1].gone == 0 and \
                    voxels[u - 1].majority != voxels[v].majority:
                boundary = 1
                break
        high = 0
        if voxels[v].n > 1:
            switching = voxels[v].switches / (voxels[v].n - 1.0)
            rate[v] = np.float32(switching)
            high = 1 if switching > HIGH_SWITCH_RATE + TIE else 0
        entropy[v] = nats
        cues = boundary + high
        cues += 1 if nats > HIGH_ENTROPY + TIE else 0
        cues += 1 if top - second < LOW_MARGIN - TIE else 0
        codes[v] = boundary + 4 * high + (2 if cues >= 2 else 0)
