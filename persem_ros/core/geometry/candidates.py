"""Which of very many classes a voxel may be given: seen there or beside it, or usual for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.votes import Votes
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.blocks import step

LIKELY = 16         # classes that voxels of a shape are most often


def near_classes(blocks: Any, taken: Any,
                 votes: Votes) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the start (n + 1,) and the list of the classes seen at each voxel or beside it."""
    n, K = len(votes.count), len(votes.classes)
    start = np.zeros(n + 1, np.int64)
    listed = np.empty(0, np.int32)
    for fill in (False, True):
        split(list_near, n, blocks, taken.block, taken.cell, taken.row, votes.start, votes.count,
              votes.place, K, fill, start[1:], start, listed)
        if not fill:
            np.cumsum(start, out=start)
            listed = np.empty(start[-1], np.int32)
    return start, listed


@kernel
def list_near(begin, end, blocks, block, cell, row, start, count, place, K, fill, number,
              own_start, listed):
    """Count (number) or list the classes seen at voxels begin .. end or beside them, ascending."""
    stamp, found = np.full(K, -1, np.int64), np.empty(K, np.int32)
    for r in range(begin, end):
        here, m = blocks[block[r]], 0
        for d in range(27):
            other, at = step(here, cell[r], d)
            if other == 0:
                continue
            v = np.int64(blocks[other - 1].cells[at])
            if v == 0 or v > len(row) or row[v - 1] == 0:
                continue
            u = np.int64(row[v - 1]) - 1
            for e in range(start[u], start[u] + count[u]):
                c = place[e]
                if c < 0 or stamp[c] == r:
                    continue
                stamp[c] = r
                j = m
                while j > 0 and found[j - 1] > c:
                    found[j] = found[j - 1]
                    j -= 1
                found[j] = c
                m += 1
        if fill:
            for j in range(m):
                listed[own_start[r] + j] = found[j]
        else:
            number[r] = m


@inlined
def gather(first, last, near, likely, listed, m):
    """Merge near[first:last] and the likely classes, both ascending, into listed[m:]."""
    k = 0
    while first < last or k < len(likely):
        if k == len(likely) or (first < last and near[first] <= likely[k]):
            c = near[first]
            if k < len(likely) and likely[k] == c:
                k += 1
            first += 1
        else:
            c = likely[k]
            k += 1
        listed[m] = c
        m += 1
    return m


@kernel
def list_candidates(begin, end, wanted, near_start, near, fine, likely, fill, number, start,
                    listed):
    """Count (number) or list the candidates of the rows wanted[begin:end]."""
    most = 0
    for w in range(begin, end):
        most = max(most, near_start[wanted[w] + 1] - near_start[wanted[w]])
    scratch = np.empty(most + likely.shape[1], np.int32)
    for w in range(begin, end):
        r = wanted[w]
        if fill:
            gather(near_start[r], near_start[r + 1], near, likely[fine[r]], listed, start[w])
        else:
            number[w] = gather(near_start[r], near_start[r + 1], near, likely[fine[r]], scratch, 0)
