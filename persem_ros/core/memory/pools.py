"""
Where the map's bytes are: pools of blocks, voxels, observations and spilt evidence.

A pool reserves address space for as much as fits the machine's memory; the operating system
gives it a page when it is first written. So pools grow without copying, nothing ever moves, and
a refinement can read the histories it was handed while the next frame is being added.

"""

from __future__ import annotations

from collections import namedtuple
import mmap
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError

# Address space is not memory: without this flag a process with a map could not fork.
NORESERVE = getattr(mmap, 'MAP_NORESERVE', 0x4000 if sys.platform == 'linux' else 0)
SIDE = 8                    # voxels along a block's edge
CELLS = SIDE ** 3
ROWS = SIDE ** 2            # rows of 8 cells along z
CHUNK = 6                   # observations in a link of a history
INLINE = 3                  # classes whose evidence lies in the voxel's own record
CENTRE = 128                # offset of a voxel's middle, 256ths of its edge

# Voxels and links fill one cache line each: adding an observation touches three, its voxel, its
# link and its block's cell, and costs half of what it did with 72 and 84 bytes.
VOXEL = np.dtype([
    ('sums', 'f8', INLINE),         # evidence h_v of classes[k]; 0 where the place is free
    ('n', 'u4'),                    # observations N_v
    ('switches', 'u4'),             # label changes between consecutive observations
    ('head', 'u4'), ('tail', 'u4'),     # first and last link of the history, + 1
    ('first', 'u4'),                # number of the oldest observation in the history
    ('more', 'u4'),                 # first link of spilt evidence, + 1; 0: none
    ('classes', 'u2', INLINE),
    ('majority', 'u2'),             # c_M
    ('label', 'u2'),                # after refinement
    ('last', 'u2'),                 # label of the newest observation
    ('source', 'u1'),               # what decided (outputs.map.cloud.SOURCES)
    ('gone', 'u1'),                 # 1: what stood there moved away
    ('first_label', 'u2')])         # label of the oldest observation, kept or not
# Observation number i lies at place i % CHUNK of its link: label, confidence, frame. Its t is the
# frame's. Where its points lay in the voxel is in a pool of its own, for links are cache lines.
LINK = np.dtype([('c', 'u2', CHUNK), ('s', 'f4', CHUNK), ('f', 'i4', CHUNK), ('next', 'u4')])
OFFSETS = np.dtype([('xyz', 'u1', 3 * CHUNK)])
# Beside the voxels, by their numbers, for the method geometry: no page of it is used without.
BELIEF = np.dtype([('posterior', 'f4'), ('label', 'u2'),   # of this label
                   ('shape', 'u1'), ('pad', 'u1')])        # core.geometry.shape
# What a history of n observations comes to once looks from one direction are thinned out, for
# voxels of at most two classes (core.geometry.votes); n = 0: nothing is kept.
VOTED = np.dtype([('low', 'u4', 2), ('high', 'u2', 2),      # H_v(c) in units of 2^-32, 48 bits
                  ('classes', 'u2', 2),
                  ('n', 'u4'),
                  ('pairs', 'u4')])                         # sum of the squares of plain counts
# Looks through a voxel since its last observation (core.frame.clear); of use where its N_v is
# still *n*, so that adding an observation need not touch it.
PASSED = np.dtype([('second', 'i8'),        # of the newest one's stamp
                   ('n', 'u4'), ('count', 'u4')])
SPILL = np.dtype([('sums', 'f8', INLINE), ('classes', 'u2', INLINE), ('pad', 'u2'),
                  ('next', 'u4'), ('pad2', 'u4')])
BLOCK = np.dtype([
    ('index', 'i4', 3),
    ('cells', 'u4', CELLS),         # voxel number + 1 of each cell, x slowest; 0: never seen
    ('near', 'u4', 27),             # block number + 1 of the 27 blocks around, itself included
    ('changed', 'u1', ROWS),        # a bit per cell: evidence changed since a refinement began
    ('count', 'u4')])
# When a block last changed, in ticks of used[CLOCK]. A pool of its own: whoever wants to know what
# changed since it last looked reads 24 bytes a block and not the blocks.
STAMP = np.dtype([('evidence', 'i8'),   # observed, or a neighbour was let go
                  ('shown', 'i8'),      # that, or a label: what a viewer sees
                  ('stored', 'i8')])    # anything that a map file holds

# What kernels are handed. Records rather than an array per field: numba counts a reference each
# time an array is taken out of a tuple, which made adding an observation 30 times slower.
Pools = namedtuple('Pools', [
    'blocks', 'voxels', 'links', 'spills',      # records of the types above
    'offsets',                                  # OFFSETS of the links, by the same number
    'stamps',                                   # STAMP of the blocks, by the same number
    'free', 'retired',                          # numbers of links: unused, unused soon
    'used',                                     # how much of each pool is in use, see below
    'starts', 'changes'])                       # class volatility's counters, (65536,) int64

# Places in Pools.used
BLOCKS, VOXELS, LINKS, SPILLS, FREE, RETIRED, OBSERVATIONS, STORED = range(8)
CLOCK = 14          # grows with everything that changes the map; the time of STAMP
# Dropped records: how many, and the first one, + 1, of a list that runs through their own fields
# (blocks: 'count', voxels: 'head', spills: 'next').
FREE_BLOCKS, FREE_VOXELS, FREE_SPILLS, FIRST_BLOCK, FIRST_VOXEL, FIRST_SPILL = range(8, 14)


# Address space for the records of each pool, as one part in so many of the machine's memory.
SHARES = {'blocks': (BLOCK, 2), 'voxels': (VOXEL, 1), 'links': (LINK, 1), 'spills': (SPILL, 2),
          'offsets': (OFFSETS, 2), 'stamps': (STAMP, 150), 'free': (np.dtype('u4'), 16),
          'retired': (np.dtype('u4'), 16), 'beliefs': (BELIEF, 8), 'voted': (VOTED, 4),
          'passed': (PASSED, 4)}
LEAST = 1 << 26         # bytes of memory that the pools are made for, at least


class Store:
    """
    The pools of one map.

    Attributes
    ----------
    arrays : Pools
        They stay valid and in place for the store's life.
    beliefs : ndarray, BELIEF
        By voxel number.
    voted : ndarray, VOTED
        By voxel number; only refinements read and write it.
    passed : ndarray, PASSED
        By voxel number.
    capacity : dict
        Largest number of blocks, voxels, links and spills.

    """

    def __init__(self) -> None:
        pools = _reserved(os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES'))
        self.beliefs, self.voted, self.passed = (
            pools[name] for name in ('beliefs', 'voted', 'passed'))
        n = {name: len(pool) for name, pool in pools.items()}
        self.capacity = {
            'blocks': min(n['blocks'], n['stamps']),
            'voxels': min(n[name] for name in ('voxels', 'beliefs', 'voted', 'passed')),
            'links': min(n[name] for name in ('links', 'offsets', 'free', 'retired')),
            'spills': n['spills']}
        self.arrays = Pools(
            **{name: pools[name] for name in Pools._fields if name in pools},
            used=np.zeros(15, np.int64), starts=np.zeros(65536, np.int64),
            changes=np.zeros(65536, np.int64))

    def check_room(self, voxels: int) -> None:
        """Refuse to add up to *voxels* new voxels where the machine's memory would not do."""
        used = self.arrays.used
        for name, place in (('blocks', BLOCKS), ('voxels', VOXELS), ('links', LINKS),
                            ('spills', SPILLS)):
            if used[place] + voxels > self.capacity[name]:
                raise PersemError(
                    f'the map is full: {used[VOXELS]} voxels fill the memory of this machine; '
                    'choose a larger memory.voxel_size, a smaller memory.max_depth or max_history')

    def nbytes(self) -> dict[str, int]:
        """Return {pool: bytes in use}."""
        used = self.arrays.used
        free = used[FREE] + used[RETIRED]
        return {'blocks': int(used[BLOCKS] - used[FREE_BLOCKS]) * (
                    BLOCK.itemsize + STAMP.itemsize),
                'voxels': int(used[VOXELS] - used[FREE_VOXELS]) * VOXEL.itemsize,
                'histories': int(used[LINKS] - free) * LINK.itemsize,
                'offsets': int(used[LINKS] - free) * OFFSETS.itemsize,
                'spilt evidence': int(used[SPILLS] - used[FREE_SPILLS]) * SPILL.itemsize}


def sparse_zeros(shape: Any, dtype: Any) -> Any:
    """Return a zeroed array that costs memory and time only where it is written."""
    dtype, n = np.dtype(dtype), int(np.prod(shape))
    if n * dtype.itemsize < 1 << 16:
        return np.zeros(shape, dtype)
    space = mmap.mmap(-1, n * dtype.itemsize,
                      flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NORESERVE)
    return np.frombuffer(space, dtype, n).reshape(shape)


def longer(column: NDArray[Any], n: int) -> NDArray[Any]:
    """Return a copy of a column with n rows, the new ones zero."""
    fresh: NDArray[Any] = sparse_zeros((n, *column.shape[1:]), column.dtype)
    fresh[:len(column)] = column
    return fresh


def _reserved(memory: int) -> dict[str, NDArray[Any]]:
    """
    Return zeroed pools by name over address space for a machine with so many bytes of memory.

    Where the system limits it (strict overcommit, ulimit -v) they are smaller, all in the same
    measure, and leave as much as they take to whatever else the process does.

    """
    share = 1
    while True:
        try:
            pools = {name: _reserve(dtype, memory // part // share)
                     for name, (dtype, part) in SHARES.items()}
            break
        except OSError:
            share *= 2
            if memory // share < LEAST:
                raise PersemError('no memory for a map: the limit on address space '
                                  '(ulimit -v) is too small; raise it, such as by ulimit -v '
                                  'unlimited') from None
    if share == 1:
        return pools
    pools.clear()
    return {name: _reserve(dtype, memory // part // (2 * share))
            for name, (dtype, part) in SHARES.items()}


def _reserve(dtype: np.dtype[Any], nbytes: int) -> NDArray[Any]:
    """Return a zeroed array over *nbytes* of address space; OSError where there is none."""
    count = max(1, min(nbytes // dtype.itemsize, 2 ** 32 - 2))
    space = mmap.mmap(-1, count * dtype.itemsize,
                      flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NORESERVE)
    if hasattr(mmap, 'MADV_HUGEPAGE'):
        space.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(space, dtype)


def ranges(start: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers start[i] .. start[i] + counts[i] - 1 of all i in a row."""
    ends = np.cumsum(counts)
    return np.repeat(start - ends + counts, counts) + np.arange(ends[-1] if len(ends) else 0)


def taken(records: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
    """Return records[rows] of a column or of records in one piece; numpy is slow at the latter."""
    if records.dtype.names is None:
        return records.take(rows, 0)
    wide = records.view(np.uint8).reshape(len(records), records.itemsize)
    return wide.take(rows, 0).view(records.dtype).reshape(-1)
