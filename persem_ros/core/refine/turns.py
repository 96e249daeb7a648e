"""Whose turn it is: how refinements begin, between two frames (spec section 9, *Flat*)."""

from __future__ import annotations

from functools import partial
from typing import Any, TYPE_CHECKING

from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.kept import in_cells, Tally
from persem_ros.core.refine import paged, snapshot
from persem_ros.core.refine.job import Job
from persem_ros.core.refine.labelled import number_of_ids
from persem_ros.core.refine.reach import reached
from persem_ros.core.refine.rules import due, news, rules_of, take_rho
from persem_ros.core.refine.sweep import next_blocks, Sweep

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Refine


def begin(memory: VoxelMemory, settings: Refine, full: bool = True) -> Job:
    """Return the Job of a refinement; call it on the mapping thread, between two frames."""
    if settings.method == 'geometry' and memory.pager is not None:
        return _begin_paged(memory, settings)
    if full or memory.rho is None:
        take_rho(memory)
    rules = rules_of(memory, settings)
    everywhere = memory.refined_with != rules
    memory.refined_with = rules
    memory.since_rho += 1
    if everywhere:
        memory.sweep = None
    if settings.method == 'geometry':
        everywhere |= news(memory, settings)
        taken = reached(memory, settings, everywhere)
    else:
        taken = snapshot.take(memory, None if everywhere else settings.neighbours)
    snapshot.settle(memory)
    memory.refinements += 1
    assert memory.rho is not None, 'it was taken above'
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry)


def begin_next(memory: Any, settings: Any, fresh: Any = False) -> Any:
    """
    Return the Job of the refinement that is next in turn (spec section 9, *Flat*).

    It visits what changed and, beside it, the next settings.sweep voxels, until all have seen
    the present class volatility. That is taken anew when settings.volatility_every refinements
    were begun with it and all voxels have seen it, or at once with *fresh*.

    """
    rules = rules_of(memory, settings)
    if settings.method == 'geometry':
        return _begin_paged(memory, settings) if memory.pager is not None else \
            _begin_round(memory, settings, rules, fresh)
    if fresh or memory.rho is None or due(memory, settings):
        take_rho(memory)
    if memory.refined_with != rules:
        memory.sweep = Sweep(memory.m.blocks, memory.n_blocks)
    memory.refined_with = rules
    memory.since_rho += 1
    also = next_blocks(memory.sweep, memory.m.blocks, memory.table, settings.sweep)
    if memory.pager is not None:    # a refinement sees all neighbours, or does not visit
        memory.pager.need_changed()
        also = memory.pager.ringed(also)
    taken = snapshot.take(memory, settings.neighbours, also)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), None, memory.sweep)


def _begin_round(memory: Any, settings: Any, rules: Any, fresh: bool) -> Job:
    """
    Return begin_next()'s Job by the method geometry.

    The schedule is run where parameters are missing or *fresh* ones wanted. Else what changed is
    labelled by those in force, and the next blocks of a sweep, over which they are estimated
    anew (spec section 12.5): the next sweep goes by the new ones.

    """
    if fresh or memory.rho is None or memory.refined_with != rules or news(memory, settings):
        return begin(memory, settings)
    renewed = None
    if (memory.sweep is None or memory.sweep.ended) and memory.n_observations != memory.rho_of:
        renewed = partial(_renewed, memory.geometry, memory.tally, memory.relief,
                          settings.geometry)
        memory.sweep, memory.tally = Sweep(memory.m.blocks, memory.n_blocks), Tally()
        memory.rho_of, memory.since_rho = memory.n_observations, 0
    memory.since_rho += 1
    also = next_blocks(memory.sweep, memory.m.blocks, memory.table, settings.sweep)
    taken = reached(memory, settings, False, also)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry,
               memory.sweep, renewed)


def _renewed(known: Any, tally: Tally | None, relief: Any, constants: Any) -> Any:
    """Return the parameters of a new sweep: by what the last one came to, in today's cells."""
    if tally is not None:
        known = tally.parameters(known, constants.shrink)
    return in_cells(known, cells_at(relief.ground, constants.cell))


def _begin_paged(memory: Any, settings: Any) -> Job:
    """Return begin_next()'s Job by the method geometry where a store holds the rest of the map."""
    rules = rules_of(memory, settings)
    if memory.rho is None:
        memory.rho, memory.rho_of = memory.volatility(), -1
    if memory.refined_with not in (None, rules):        # None also where a block has left
        memory.sweep = None
    memory.refined_with = rules
    memory.since_rho += 1
    if memory.fitted_by is not None and memory.fitted_by[0] != settings.up:
        memory.pager.columns = None
    new = news(memory, settings)
    renewed = None if new else paged.next_sweep(memory, settings.geometry)
    taken = paged.part(memory, settings, new)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry,
               memory.sweep, renewed, learns=True)
