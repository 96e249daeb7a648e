"""One vote per viewing direction: what a history says once repeated looks are thinned out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.history import link_of, oldest
from persem_ros.core.memory.pools import CHUNK

ONE = 2.0 ** 32         # votes are multiples of 1 / ONE, so that their order is of no account
MANY = 2.0              # votes from which a voxel tells how well its looks agree


@dataclass(frozen=True, eq=False)
class Votes:
    """
    Votes of n voxels by class, in rows as the snapshot has them.

    Attributes
    ----------
    classes : ndarray, shape (K,), uint16
        The distinct ids in the histories, ascending; elsewhere a class is its place here.
    start : ndarray, shape (n + 1,), int64
        Row i's votes begin at start[i] ...
    count : ndarray, shape (n,), int32
        ... and are so many, ascending by class.
    place : ndarray, int32
        The class of a vote, as its place in *classes*.
    share : ndarray, float64
        p_v(c) = H_v(c) / N_v.
    total : ndarray, shape (n,), float64
        N_v.
    agreement : ndarray, shape (n,), float64
        Share of the pairs of looks that agree, from plain counts; -1 where N_v < 2.

    """

    classes: NDArray[np.uint16]
    start: NDArray[np.int64]
    count: NDArray[np.int32]
    place: NDArray[np.int32]
    share: NDArray[np.float64]
    total: NDArray[np.float64]
    agreement: NDArray[np.float64]


def take_votes(memory: Any, taken: Any, directions: int) -> Votes:
    """
    Return the votes of the voxels of a snapshot.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        Its histories are read; a snapshot's stay as they were.
    taken : core.refine.snapshot.Snapshot
        Which voxels, and how long their histories are.
    directions : int
        Bins along half an axis; 0: every observation is a vote of its own.

    """
    n = len(taken.number)
    ids, share = np.zeros(len(taken.classes), np.uint16), np.zeros(len(taken.classes))
    count, seen = np.zeros(n, np.int32), np.zeros(65536, np.uint8)
    total, agreement = np.zeros(n), np.zeros(n)
    split(count_votes, n, memory.m.links, taken.index, taken.start, taken.observations,
          taken.first, taken.head, taken.placed, np.array(memory.origin), memory.voxel_size,
          int(directions), memory.max_history, ids, share, count, total, agreement, seen)
    classes = np.flatnonzero(seen).astype(np.uint16)
    place_of = np.zeros(65536, np.int32)
    place_of[classes] = np.arange(len(classes))
    return Votes(classes, taken.start, count, place_of[ids], share, total, agreement)


@kernel
def count_votes(begin, end, links, index, start, observations, first, head, placed, origin, size,
                directions, max_history, ids, share, count, total, agreement, seen):
    """
    Count the votes of rows begin .. end.

    index (n, 3) are the voxels, placed (f, 4, 4) is T_map_sensor of every frame, size metres.
    seen (65536,) tells which ids occurred at all.

    """
    longest = 1
    for r in range(begin, end):
        longest = max(longest, np.int64(observations[r]) - oldest(observations[r], first[r],
                                                                  max_history))
    side = 2 * directions + 1
    crowd = np.zeros(side * side * side, np.int32)      # observations by direction
    where = np.empty(longest, np.int32)
    sums, plain = np.empty(65536, np.int64), np.empty(65536, np.int64)
    for r in range(begin, end):
        x = (index[r, 0] + 0.5) * size + origin[0]
        y = (index[r, 1] + 0.5) * size + origin[1]
        z = (index[r, 2] + 0.5) * size + origin[2]
        n = np.int64(observations[r])
        at = oldest(n, first[r], max_history)
        head_link = link_of(links, head[r], first[r], at)
        link = head_link
        if directions > 0:
            for i in range(at, n):
                if i > at and i % CHUNK == 0:
                    link = np.int64(links[link - 1].next)
                pose = placed[links[link - 1].f[i % CHUNK]]
                dx, dy, dz = x - pose[0, 3], y - pose[1, 3], z - pose[2, 3]
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                ratio = directions / length if length > 0.0 else 0.0
                b = np.int64(np.floor(dx * ratio + 1e-9)) + directions
                b = b * side + np.int64(np.floor(dy * ratio + 1e-9)) + directions
                b = b * side + np.int64(np.floor(dz * ratio + 1e-9)) + directions
                where[i - at] = b
                crowd[b] += 1
        link = head_link
        k0, n_classes = start[r], 0
        for i in range(at, n):
            if i > at and i % CHUNK == 0:
                link = np.int64(links[link - 1].next)
            c = links[link - 1].c[i % CHUNK]
            s = np.float64(links[link - 1].s[i % CHUNK])
            m = crowd[where[i - at]] if directions > 0 else 1
            k = 0
            while k < n_classes and ids[k0 + k] < c:
                k += 1
            if k == n_classes or ids[k0 + k] != c:      # keep them ascending
                for later in range(n_classes, k, -1):
                    ids[k0 + later] = ids[k0 + later - 1]
                    sums[later], plain[later] = sums[later - 1], plain[later - 1]
                ids[k0 + k], sums[k], plain[k] = c, 0, 0
                n_classes += 1
                seen[c] = 1
            sums[k] += np.int64(np.rint(s / m * ONE))
            plain[k] += 1
        if directions > 0:
            for i in range(n - at):
                crowd[where[i]] = 0
        whole, pairs = np.int64(0), 0.0
        for k in range(n_classes):
            whole += sums[k]
            pairs += plain[k] * plain[k]
        looks = np.float64(n - at)
        total[r] = whole / ONE
        for k in range(n_classes):
            share[k0 + k] = sums[k] / ONE / total[r]
        count[r] = n_classes
        agreement[r] = -1.0
        if total[r] >= MANY:
            agreement[r] = (pairs - looks) / max(looks * (looks - 1.0), 1.0)
