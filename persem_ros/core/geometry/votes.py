"""One vote per viewing direction: what a history says once repeated looks are thinned out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.history import fetch, link_of, links_after, oldest, TOGETHER
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


def take_votes(memory: Any, taken: Any, directions: int, keep: bool = False,
               known: Optional[NDArray[np.uint16]] = None) -> Votes:
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
    keep : bool
        Take what memory.store.voted holds of voxels that were not observed since, and leave
        there what was counted: for one refinement at a time.
    known : ndarray, uint16, optional
        The classes to number by; place is -1 for votes for others. None: all that occur.

    """
    n, voted = len(taken.number), memory.store.voted
    if keep and memory.voted_by != directions:
        voted['n'][:memory.n_numbers] = 0
        memory.voted_by = directions
    ids, share = np.zeros(len(taken.classes), np.uint16), np.empty(len(taken.classes))
    count, seen = np.zeros(n, np.int32), np.zeros(65536, np.uint8)
    total, agreement = np.zeros(n), np.zeros(n)
    from_where = np.ascontiguousarray(taken.placed[:, :3, 3]).reshape(-1, 3)
    split(count_votes, n, memory.m.links, taken.number, taken.index, taken.start,
          taken.observations, taken.first, taken.head, from_where, np.array(memory.origin),
          memory.voxel_size, int(directions), memory.max_history, voted, keep, ids, share, count,
          total, agreement, seen)
    classes = np.flatnonzero(seen).astype(np.uint16) if known is None else known
    place_of = np.full(65536, -1, np.int32)
    place_of[classes] = np.arange(len(classes))
    return Votes(classes, taken.start, count, place_of[ids], share, total, agreement)


@kernel
def count_votes(begin, end, links, number, index, start, observations, first, head, from_where,
                origin, size, directions, max_history, voted, keep, ids, share, count, total,
                agreement, seen):
    """
    Count the votes of rows begin .. end.

    index (n, 3) are the voxels, from_where (f, 3) is the sensor's place in every frame, size
    metres. seen (65536,) tells which ids occurred at all.

    """
    longest = 1
    for r in range(begin, end):
        longest = max(longest, np.int64(observations[r]) - oldest(observations[r], first[r],
                                                                  max_history))
    side = 2 * directions + 1
    crowd = np.zeros(side * side * side, np.int32)      # observations by direction
    where = np.zeros(longest, np.int32)
    labels, confidences = np.empty(longest, np.int64), np.empty(longest)
    dx, dy, dz, crowded = (np.empty(longest), np.empty(longest), np.empty(longest),
                           np.ones(longest))
    by_class, plain = np.zeros(65536, np.int64), np.zeros(65536, np.int64)
    sums = np.empty(65536, np.int64)
    chains, left = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    for r in range(begin, end):
        if (r - begin) % TOGETHER == 0:
            m = 0
            for q in range(r, min(r + TOGETHER, end)):
                if not (keep and voted[number[q]].n == observations[q]):
                    chains[m], left[m] = head[q], links_after(observations[q], first[q])
                    m += 1
            fetch(links, chains, left, m)
        n = np.int64(observations[r])
        at = oldest(n, first[r], max_history)
        looks, k0 = n - at, start[r]
        kept = voted[number[r]]
        if keep and np.int64(kept.n) == n:
            n_classes, squares = unpack(kept, ids, sums, k0), np.float64(kept.pairs)
        else:
            follow(links, link_of(links, head[r], first[r], at), at, n, from_where,
                   (index[r, 0] + 0.5) * size + origin[0], (index[r, 1] + 0.5) * size + origin[1],
                   (index[r, 2] + 0.5) * size + origin[2], labels, confidences, dx, dy, dz)
            if directions > 0:
                sort_by_direction(looks, dx, dy, dz, np.float64(directions), where)
                for i in range(looks):
                    crowd[where[i]] += 1
                for i in range(looks):
                    crowded[i] = crowd[where[i]]
                for i in range(looks):
                    crowd[where[i]] = 0
            for i in range(looks):
                confidences[i] = np.rint(confidences[i] / crowded[i] * ONE)
            n_classes = 0
            for i in range(looks):
                c = labels[i]
                if plain[c] == 0:
                    k = n_classes
                    while k > 0 and ids[k0 + k - 1] > c:    # keep them ascending
                        ids[k0 + k] = ids[k0 + k - 1]
                        k -= 1
                    ids[k0 + k] = c
                    n_classes += 1
                by_class[c] += np.int64(confidences[i])
                plain[c] += 1
            squares = 0.0
            for k in range(n_classes):
                c = np.int64(ids[k0 + k])
                squares += plain[c] * plain[c]
                sums[k] = by_class[c]
                by_class[c], plain[c] = 0, 0
            if keep:
                pack(kept, n, looks, n_classes, ids, sums, k0, squares)
        whole = np.int64(0)
        for k in range(n_classes):
            whole += sums[k]
            seen[ids[k0 + k]] = 1
        total[r] = whole / ONE
        for k in range(n_classes):
            share[k0 + k] = sums[k] / ONE / total[r]
        count[r] = n_classes
        agreement[r] = -1.0
        if total[r] >= MANY:
            agreement[r] = (squares - looks) / max(looks * (looks - 1.0), 1.0)


@inlined
def follow(links, link, at, n, from_where, x, y, z, labels, confidences, dx, dy, dz):
    """Write labels, confidences and ways from the sensor of observations at .. n of a voxel."""
    i = at
    while i < n:
        record = links[link - 1]
        c, s, f = record.c, record.s, record.f
        link = np.int64(record.next)
        for p in range(i % CHUNK, min(CHUNK, i % CHUNK + n - i)):
            frame, k = f[p], i - at
            labels[k], confidences[k] = c[p], s[p]
            dx[k] = x - from_where[frame, 0]
            dy[k] = y - from_where[frame, 1]
            dz[k] = z - from_where[frame, 2]
            i += 1


@inlined
def sort_by_direction(n, dx, dy, dz, directions, where):
    """
    Write the bins of n directions.

    A loop of its own without branches, which the compiler turns into vector instructions.

    """
    side = 2.0 * directions + 1.0
    for k in range(n):
        length = np.sqrt(dx[k] * dx[k] + dy[k] * dy[k] + dz[k] * dz[k])
        ratio = directions / length
        ratio = ratio if length > 0.0 else 0.0
        b = np.floor(dx[k] * ratio + 1e-9) + directions
        b = b * side + (np.floor(dy[k] * ratio + 1e-9) + directions)
        b = b * side + (np.floor(dz[k] * ratio + 1e-9) + directions)
        where[k] = np.int32(b)      # whole numbers far below 2^53: exact


@inlined
def unpack(kept, ids, sums, k0):
    """Write the classes and votes of a VOTED; return how many classes."""
    low, high, classes, n = kept.low, kept.high, kept.classes, 0
    for k in range(2):
        sums[n] = np.int64(low[k]) | np.int64(high[k]) << 32
        if sums[n] > 0:
            ids[k0 + n] = classes[k]
            n += 1
    return n


@inlined
def pack(kept, n, looks, n_classes, ids, sums, k0, squares):
    """Keep the votes of a voxel where they fit a VOTED."""
    low, high, classes = kept.low, kept.high, kept.classes
    fits = n_classes <= 2 and looks < 65536
    for k in range(min(n_classes, 2)):
        fits = fits and 0 < sums[k] and sums[k] >> 48 == 0
    kept.n = n if fits else 0
    if not fits:
        return
    kept.pairs = np.int64(squares)
    for k in range(2):
        value = sums[k] if k < n_classes else np.int64(0)
        low[k], high[k] = value & 0xFFFFFFFF, value >> 32
        classes[k] = ids[k0 + k] if k < n_classes else 0
