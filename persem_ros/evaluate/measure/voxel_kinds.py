"""
Kinds of voxels: those that all methods label alike and that lie in the same regions.

Metrics cannot tell two voxels of one kind apart, so a frame is counted by kind, once for all
methods: a map of some 100 000 voxels has a few thousand kinds.

"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.outputs.results.counting import CODES

NOWHERE = 0         # the kind of pixels whose voxel is unknown


@dataclass(frozen=True, eq=False)
class Kinds:
    """
    The kinds of a map's voxels.

    Attributes
    ----------
    of : ndarray, shape (voxels,)
        Kind by voxel number.
    classes : ndarray, shape (kinds, methods)
        Class by kind and method.
    codes : ndarray, shape (kinds,)
        Bits of the regions.
    moving : ndarray, shape (65536,)
        Kind, but for its voxel's code to be added, of a pixel whose own label is a dynamic id;
        -1 for all other ids.

    """

    of: NDArray[np.int32]
    classes: NDArray[np.uint16]
    codes: NDArray[np.uint8]
    moving: NDArray[np.int32]


def kinds_of(labels: NDArray[np.uint16], codes: NDArray[np.uint8], index: NDArray[np.uint16],
             dynamic: tuple[int, ...] = ()) -> Kinds:
    """
    Return the Kinds of a map.

    Parameters
    ----------
    labels : ndarray, shape (methods, voxels), uint16
        Class ids by method and voxel number.
    codes : ndarray, shape (voxels,), uint8
        Bits of core.refine.regions.REGIONS.
    index : ndarray, shape (65536,), uint16
        Counted class of each id; 0: none. It knows all ids of the map and all dynamic ones.
    dynamic : sequence of int
        Ids that pass through unchanged.

    """
    labels = np.ascontiguousarray(labels.T)
    n, methods = labels.shape
    of = np.empty(n, np.int32)
    first = group(labels, codes, index, of)
    rows = index[labels[first]]
    unknown = np.zeros((1, methods), np.uint16)
    passing = sorted({c for c in dynamic if c >= 0})
    moving = np.full(len(index), -1, np.int32)
    moving[passing] = 1 + len(first) + CODES * np.arange(len(passing))
    passed = np.repeat(index[passing], CODES)[:, None].repeat(methods, axis=1)
    codes = np.concatenate([[0], codes[first], np.tile(np.arange(CODES), len(passing))])
    return Kinds(of, np.concatenate([unknown, rows, passed]), codes.astype(np.uint8), moving)


def group(labels: NDArray[np.uint16], codes: NDArray[np.uint8], index: NDArray[np.uint16],
          of: NDArray[np.int32]) -> NDArray[np.int64]:
    """Write the kind of each voxel, from 1 on; return the first voxel of each, (kinds,)."""
    table = np.zeros(1 << max(10, int(2 * len(labels)).bit_length()), np.int32)
    first = np.empty(len(labels), np.int64)
    return first[:gather(labels, codes, index, table, first, of)].copy()


@kernel
def gather(labels, codes, index, table, first, of):
    """Group rows of classes and a code through a hash table; return how many there are."""
    n, mask = 0, np.uint64(len(table) - 1)
    for v in range(len(labels)):
        key = np.uint64(codes[v])
        for m in range(labels.shape[1]):
            key = (key ^ np.uint64(index[labels[v, m]])) * np.uint64(0x9E3779B97F4A7C15)
            key ^= key >> np.uint64(29)
        place = key & mask
        while table[place] != 0:
            u = first[table[place] - 1]
            same = codes[u] == codes[v]
            for m in range(labels.shape[1]):
                same &= index[labels[u, m]] == index[labels[v, m]]
            if same:
                break
            place = (place + np.uint64(1)) & mask
        if table[place] == 0:
            first[n] = v
            n += 1
            table[place] = n
        of[v] = table[place]
    return n
