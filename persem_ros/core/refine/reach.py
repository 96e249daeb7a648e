"""
What the method geometry is handed: a snapshot of all that a change may reach, and no more.

Evidence counts two rings away, an occupied cell four (two by the shapes around it), the ground in
its columns (spec section 12); to label these, two rings more have to be looked at.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import Columns, columns_of
from persem_ros.core.geometry.ground import Ground
from persem_ros.core.geometry.labelling import SMOOTHED
from persem_ros.core.geometry.occupied import read_bits
from persem_ros.core.geometry.relief import Change, Relief
from persem_ros.core.geometry.shape import RADIUS
from persem_ros.core.geometry.spread import spread
from persem_ros.core.geometry.upright import up_of, upright
from persem_ros.core.jit import split
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.pools import ROWS, SIDE, sparse_zeros
from persem_ros.core.refine import snapshot

NO_BLOCKS = np.empty(0, np.int64)
ASIDE = SMOOTHED + 1    # rings that count: in the last one classes that were seen, no more


@dataclass(frozen=True, eq=False)
class Surroundings:
    """
    What core.geometry.relief.Relief tells of a whole map, around some blocks of one.

    What it takes to tell the ground is found when it is asked for: beside the mapping.

    Attributes
    ----------
    bits : ndarray, shape (blocks, 64), uint8
        As there.
    near : ndarray, shape (b,), int64
        The blocks whose bits these are.
    corners : ndarray, shape (b, 2), int32
        The tiles in which they lie.
    index : ndarray, shape (n, 3), int32
        Upright indices of the snapshot's voxels.
    columns : Columns or None
        Of the whole map; None: the ground does not matter.
    window : int
        Of the opening.

    """

    bits: NDArray[np.uint8]
    near: NDArray[np.int64]
    corners: NDArray[np.int32]
    index: NDArray[np.int32]
    columns: Optional[Columns]
    window: int

    @cached_property
    def own(self) -> Columns:
        """Return the columns of the snapshot."""
        return columns_of(self.index)

    @cached_property
    def around(self) -> Columns:
        """Return all columns that decide on the ground under the blocks."""
        return self.own if self.columns is None else self.columns.around(self.own, self.window)

    @cached_property
    def tile(self) -> NDArray[np.int32]:
        """Return the place, by block number, of a block's tile among those of the ground."""
        tile = sparse_zeros(len(self.bits), np.int32)
        tile[self.near] = self.around.places(self.corners)
        return tile

    @cached_property
    def ground(self) -> Ground:
        """Return the ground."""
        return self.around.ground(self.window)


def reached(memory: Any, settings: Any, everywhere: bool,
            also: NDArray[np.int64] = NO_BLOCKS) -> snapshot.Snapshot:
    """
    Return the Snapshot of a refinement by the method geometry.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        Its relief is brought up to date.
    settings : persem_ros.settings.config.Refine
        Its up and geometry are read.
    everywhere : bool
        The whole map; else what the changes since the last refinement reach.
    also : ndarray, int64
        Numbers of blocks that are labelled besides; they come first.

    """
    if not has_relief(memory, settings):
        memory.relief = Relief(memory, up_of(settings.up), settings.geometry.window)
    change = memory.relief.update(memory)
    if everywhere or change.whole:
        taken = snapshot.take(memory, shares=False)
        near = None if memory.relief.young else _spread(
            memory.m.blocks, memory.n_blocks, change.blocks, change.altered, RADIUS)[0]
        memory.relief.young = False
        return replace(taken, relief=memory.relief, reshaped=_reshaped(near, taken))
    return _part(memory, settings, change, memory.changed_blocks(), also)


def has_relief(memory: Any, settings: Any) -> bool:
    """Return whether there is a relief for the settings, empty or not."""
    relief = memory.relief
    return relief is not None and (relief.up, relief.window) == (
        up_of(settings.up), settings.geometry.window)


def _part(memory: Any, settings: Any, change: Change, dirty: NDArray[np.int64],
          also: NDArray[np.int64]) -> snapshot.Snapshot:
    """Return the Snapshot of what a change reaches, and of *also*."""
    blocks, n, bits = memory.m.blocks, memory.n_blocks, memory.relief.bits
    rings = SMOOTHED if settings.geometry.smoothing else 0
    near, by = _spread(blocks, n, change.blocks, change.altered, RADIUS)
    stale = sparse_zeros((n, ROWS), np.uint8)
    stale[by] = near[by]
    stale[dirty] |= blocks['changed'][dirty]
    stale[change.risen_blocks] |= change.risen[change.risen_blocks]
    by = _union(n, by, dirty, change.risen_blocks)
    marks, by = _spread(blocks, n, by, stale, rings)
    first, asked = (sparse_zeros((n, ROWS), np.uint8) for _ in range(2))
    asked[by] = marks[by]
    first[also] = asked[also] = 255
    marks[also] = 0
    by = _union(n, by, also)
    needed, around = _spread(blocks, n, by, asked, rings)
    needed[by] &= ~asked[by]
    size = int(blocks['count'][around].sum())
    lists = [np.empty(size, np.int64) for _ in range(3)]
    end, ends = 0, []
    for numbers, rows in ((also, first), (by, marks), (around, needed)):
        wanted = sparse_zeros((n, ROWS), np.uint8)
        wanted[numbers] = rows[numbers] & bits[numbers]
        end = snapshot.list_marked(blocks, numbers, wanted, *lists, end)
        ends.append(end)
    block, cell, number = (column[:end] for column in lists)
    taken = snapshot.copied(memory, block, cell, number, ends[1], shares=False)
    return replace(taken, relief=memory.relief, swept=ends[0],
                   reshaped=_reshaped(None if memory.relief.young else near, taken))


def surrounded(memory: Any, settings: Any, numbers: NDArray[np.int64], rings: int,
               columns: Optional[Columns] = None) -> snapshot.Snapshot:
    """
    Return the Snapshot of the voxels of blocks that are there, and of rings around these.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        It holds all blocks around them.
    settings : persem_ros.settings.config.Refine
        Its up and geometry are read.
    numbers : ndarray, int64
        The blocks.
    rings : int
        8 at most, less the radius of shapes where these are wanted in the rings.
    columns : core.geometry.columns.Columns, optional
        Of the whole map; None: the ground does not matter.

    """
    blocks, n, up = memory.m.blocks, memory.n_blocks, up_of(settings.up)
    near = snapshot.blocks_around(blocks, numbers, n)
    now = np.zeros((len(near), ROWS), np.uint8)
    split(read_bits, len(near), blocks, memory.m.voxels, near, memory.n_gone > 0, now, grain=256)
    bits, marks = (sparse_zeros((n, ROWS), np.uint8) for _ in range(2))
    bits[near], marks[numbers] = now, 255
    wide, around = _spread(blocks, n, numbers, marks, rings)
    wide[numbers] = 0
    size = int(blocks['count'][near].sum())
    lists = [np.empty(size, np.int64) for _ in range(3)]
    end, ends = 0, []
    for some, rows in ((numbers, marks), (around, wide)):
        rows[some] &= bits[some]
        end = snapshot.list_marked(blocks, some, rows, *lists, end)
        ends.append(end)
    block, cell, number = (column[:end] for column in lists)
    taken = snapshot.copied(memory, block, cell, number, ends[0], shares=False)
    return replace(taken, reshaped=np.arange(end), relief=Surroundings(
        bits, near, upright(blocks['index'][near], up)[:, :2], upright(taken.index, up), columns,
        settings.geometry.window))


def at_hand(memory: Any, voxel: NDArray[np.int32],
            settings: Any) -> Optional[snapshot.Snapshot]:
    """
    Return the Snapshot of one voxel and two rings around it, by the relief of the last refinement.

    Nothing is brought up to date, so that a refinement may be under way. None where there is no
    relief for the settings, or the voxel is newer than it.

    """
    relief, pager = memory.relief, memory.pager
    if pager is not None and pager.columns is not None:
        block = block_numbers(memory, np.asarray(voxel, np.int32)[None] >> 3)
        return surrounded(memory, settings, block, ASIDE, pager.columns)
    if not has_relief(memory, settings) or relief.empty:
        return None
    reach = np.arange(-SMOOTHED, SMOOTHED + 1)
    steps = np.stack(np.meshgrid(reach, reach, reach, indexing='ij'), axis=-1).reshape(-1, 3)
    index = (np.asarray(voxel) + steps).astype(np.int32)
    block = block_numbers(memory, index >> 3)
    place = index & 7
    cell = (place[:, 0] * SIDE + place[:, 1]) * SIDE + place[:, 2].astype(np.int64)
    known = (block >= 0) & (relief.bits[block, cell >> 3] >> (cell & 7) & 1 > 0)
    if not known[len(steps) // 2]:
        return None
    order = np.flatnonzero(known)
    order = order[np.lexsort((cell[order], block[order]))]      # as the whole map has them
    taken = snapshot.copied(memory, block[order], cell[order], memory.find(index[order]), 0,
                            shares=False)
    return replace(taken, relief=relief, reshaped=NO_BLOCKS)


def _spread(blocks: Any, n: int, numbers: NDArray[np.int64], rows: NDArray[np.uint8],
            reach: int) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return cells within *reach* of marked ones of the given blocks, and blocks around these."""
    out = sparse_zeros((n, ROWS), np.uint8)
    if reach == 0:
        out[numbers] = rows[numbers]
        return out, numbers
    around = snapshot.blocks_around(blocks, numbers, n)
    spread(blocks, around, rows, reach, out)
    return out, around


def _union(n: int, *numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted distinct block numbers, below n."""
    found = np.zeros(n, bool)
    for some in numbers:
        found[some] = True
    return np.flatnonzero(found)


def _reshaped(near: Optional[NDArray[np.uint8]], taken: snapshot.Snapshot) -> NDArray[np.int64]:
    """Return the rows whose shape has to be found anew: cells near new ones; None: all."""
    if near is None:
        return np.arange(len(taken.number))
    return np.flatnonzero(near[taken.block, taken.cell >> 3] >> (taken.cell & 7) & 1)
