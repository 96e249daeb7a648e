"""Difficult regions, from histories and majority labels alone (spec section 6)."""

import numpy as np

from persem_ros.core.blocks import directions, neighbour
from persem_ros.core.jit import kernel, split
from persem_ros.core.snapshot import take

HIGH_SWITCH_RATE = 0.3
HIGH_ENTROPY = 0.5          # nat
LOW_MARGIN = 0.3
NAMES = ('boundary', 'difficult_core', 'high_switch')


def regions(memory, neighbours=26):
    """
    Return the regions of every voxel.

    Returns
    -------
    dict
        'boundary' (a neighbour has another majority label), 'high_switch' (label changes /
        (N_v - 1) > 0.3), 'difficult_core' (at least two of: entropy of p_v > 0.5 nat, top-two
        margin of p_v < 0.3, high switch, boundary): bool (voxels,), by voxel number; besides
        'entropy' (nat) and 'switch_rate', float32.

    """
    taken, n = take(memory), memory.n_voxels
    boundary, core, high = (np.zeros(n, np.uint8) for _ in range(3))
    entropy, rate = np.zeros(n, np.float32), np.zeros(n, np.float32)
    split(_classify, taken.refined, memory.m.blocks, memory.m.voxels, taken.block, taken.cell,
          taken.number, taken.start, taken.shares, directions(neighbours), boundary, core, high,
          entropy, rate)
    return {'boundary': boundary.astype(bool), 'difficult_core': core.astype(bool),
            'high_switch': high.astype(bool), 'entropy': entropy, 'switch_rate': rate}


@kernel
def _classify(begin, end, blocks, voxels, block, cell, number, start, shares, neighbours,
              boundary, core, high, entropy, rate):
    """Classify rows begin .. end of a snapshot."""
    for r in range(begin, end):
        v = number[r]
        nats, top, second = 0.0, 0.0, 0.0
        for e in range(start[r], start[r + 1]):
            p = shares[e]
            nats -= p * np.log(p)
            if p > top:
                top, second = p, top
            elif p > second:
                second = p
        for d in neighbours:
            u = neighbour(blocks, block[r], cell[r], d)
            if u > 0 and voxels[u - 1].majority != voxels[v].majority:
                boundary[v] = 1
                break
        if voxels[v].n > 1:
            rate[v] = np.float32(voxels[v].switches / (voxels[v].n - 1.0))
            high[v] = voxels[v].switches > HIGH_SWITCH_RATE * (voxels[v].n - 1.0)
        entropy[v] = nats
        cues = np.int64(nats > HIGH_ENTROPY) + np.int64(top - second < LOW_MARGIN) \
            + np.int64(high[v]) + np.int64(boundary[v])
        core[v] = cues >= 2
