"""What a refinement by the method geometry visits where a store holds the rest of the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Optional

import numpy as np
from persem_ros.core.geometry.columns import columns_of
from persem_ros.core.geometry.kept import filled, Tally, with_cells
from persem_ros.core.geometry.upright import up_of, upright
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.reach import ASIDE, surrounded, Surroundings
from persem_ros.core.refine.sweep import next_blocks, Sweep


def part(memory: Any, settings: Any, news: bool) -> snapshot.Snapshot:
    """
    Return the Snapshot of the refinement that is next in turn.

    What changed, what lies around it, and the next blocks of a sweep are labelled by the kept
    parameters, where all around is in memory. Sweeps estimate these anew from what is there.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        It has a pager. Its columns are brought up to date by learn(), beside the mapping; here
        only where there are none.
    settings : persem_ros.settings.config.Refine
        up, geometry and sweep.
    news : bool
        There are no parameters to go by: they are to be fitted to all that is in memory.

    """
    pager = memory.pager
    if news or pager.columns is None:
        taken = snapshot.take(memory, shares=False)
        if news:
            memory.sweep, memory.tally, memory.rho_of = None, None, memory.n_observations
            return taken
        learn(pager, taken, settings)
    changed = pager.need_changed()
    also = pager.ringed(next_blocks(memory.sweep, memory.m.blocks, memory.table, settings.sweep))
    near = snapshot.blocks_around(memory.m.blocks, changed, memory.n_blocks)
    near = np.setdiff1d(pager.ringed(near), also)
    taken = surrounded(memory, settings, np.concatenate([also, near]), ASIDE, pager.columns)
    swept = np.isin(taken.block[:taken.refined], also)      # they come first
    return replace(taken, swept=int(np.count_nonzero(swept)))


def learn(pager: Any, taken: snapshot.Snapshot, settings: Any) -> None:
    """Note the lowest voxels of the columns of a snapshot; any thread may, one at a time."""
    news = taken.relief.own if isinstance(taken.relief, Surroundings) else \
        columns_of(upright(taken.index, up_of(settings.up)))
    pager.columns = news if pager.columns is None else pager.columns.and_those(news)


def next_sweep(memory: Any, constants: Any) -> Optional[Callable[[], Any]]:
    """
    Begin a sweep where one has ended and something was seen since.

    Return what finds the parameters that follow from the last one, beside the mapping; None where
    those in force stay.

    """
    under_way = memory.sweep is not None and not memory.sweep.ended
    if under_way or memory.n_observations == memory.rho_of:
        return None
    renewed = partial(_renewed, memory.geometry, memory.tally, memory.pager, constants)
    memory.sweep, memory.tally = Sweep(memory.m.blocks, memory.n_blocks), Tally()
    memory.rho_of, memory.since_rho = memory.n_observations, 0
    return renewed


def _renewed(known: Any, tally: Optional[Tally], pager: Any, constants: Any) -> Any:
    """Return the parameters that a sweep came to; of cells that it did not see, those in force."""
    if tally is not None:
        known = filled(tally.parameters(known, constants.shrink), known)
    return with_cells(known, pager.columns.cells(constants.cell))
