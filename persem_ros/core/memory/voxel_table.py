"""The map as a table, a row a voxel: its records copied to columns, sorted by place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.memory.evidence import read_evidence


def ordered(columns: dict[str, Any]) -> dict[str, Any]:
    """Return columns of voxels sorted by voxel index."""
    order = sort_order(columns['voxel'])
    return {name: column[order] for name, column in columns.items()}


def sort_order(index: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the order that sorts voxel indices (n, 3) lexicographically."""
    if not len(index):
        return np.empty(0, np.int64)
    low = index.min(axis=0).astype(np.int64)
    span = index.max(axis=0).astype(np.int64) - low + 1
    if float(span[0]) * float(span[1]) * float(span[2]) < 2.0 ** 62:
        shifted = index - low       # one key sorts 4 times as fast as three
        return np.argsort((shifted[:, 0] * span[1] + shifted[:, 1]) * span[2] + shifted[:, 2],
                          kind='stable')
    return np.lexsort((index[:, 2], index[:, 1], index[:, 0]))


@kernel
def copy_columns(start, stop, blocks, voxels, spills, beliefs, block, cell, number, index, label,
                 majority, confidence, observations, switches, source):
    """
    Copy each voxel's record to the columns.

    Confidence is the posterior of its label where there is one, else p_v of it, 0 for none.

    """
    classes = np.empty(65536, np.uint16)
    sums = np.empty(65536)
    for p in range(start, stop):
        corner = blocks[block[p]].index
        index[p, 0] = corner[0] * 8 + (cell[p] >> 6)
        index[p, 1] = corner[1] * 8 + (cell[p] >> 3 & 7)
        index[p, 2] = corner[2] * 8 + (cell[p] & 7)
        voxel = voxels[number[p]]
        label[p] = voxel.label
        majority[p] = voxel.majority
        observations[p] = voxel.n
        switches[p] = voxel.switches
        source[p] = voxel.source
        belief = beliefs[number[p]]
        if belief.posterior > 0.0 and belief.label == voxel.label:
            confidence[p] = belief.posterior
            continue
        n = read_evidence(voxel, spills, classes, sums, 0)
        total, own = 0.0, 0.0
        for k in range(n):
            total += sums[k]
            if classes[k] == voxel.label:
                own = sums[k]
        confidence[p] = own / total
