"""Whose turn it is: how refinements begin, between two frames (spec section 9, *Flat*)."""

from __future__ import annotations

from functools import partial
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.kept import in_cells, Tally
from persem_ros.core.refine import paged, snapshot
from persem_ros.core.refine.job import Job
from persem_ros.core.refine.labelled import number_of_ids
from persem_ros.core.refine.reach import has_relief, reached
from persem_ros.core.refine.rules import due, fit_anew, news, rules_of, take_rho
from persem_ros.core.refine.survey import Survey
from persem_ros.core.refine.sweep import next_blocks, Sweep

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Refine


def begin(memory: VoxelMemory, settings: Refine, full: bool = True) -> Job:
    """Return the Job of a refinement; call it on the mapping thread, between two frames."""
    if settings.method == 'geometry' and memory.pager is not None:
        return _begin_paged(memory, settings)
    if full or memory.rho is None or memory.survey is not None:
        take_rho(memory)
    rules = rules_of(memory, settings)
    everywhere = memory.refined_with != rules
    memory.refined_with = rules
    memory.since_rho += 1
    if everywhere and memory.sweep is not None:
        snapshot.settle_blocks(memory, np.arange(memory.n_blocks))
        memory.sweep = None
    if settings.method == 'geometry':
        if news(memory, settings):
            fit_anew(memory, settings)
            everywhere = True
        taken = reached(memory, settings, everywhere)
    else:
        taken = snapshot.take(memory, None if everywhere else settings.neighbours)
    snapshot.settle(memory)
    memory.refinements += 1
    assert memory.rho is not None, 'it was taken above'
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry)


def begin_next(memory: Any, settings: Any, fresh: Any = False, waits: bool = True) -> Any:
    """
    Return the Job of the refinement that is next in turn (spec section 9, *Flat*).

    It visits what changed and, beside it, the next settings.sweep voxels, until all have seen
    the present class volatility. That is taken anew when settings.volatility_every refinements
    were begun with it and all voxels have seen it, or at once with *fresh*. By the method
    geometry a map of more voxels is then surveyed first, in as many refinements as it takes, and
    swept by the parameters that come of it; in one step where no mapping *waits* for it.

    """
    rules = rules_of(memory, settings)
    if settings.method == 'geometry':
        return _begin_paged(memory, settings) if memory.pager is not None else \
            _begin_round(memory, settings, rules, fresh, waits)
    if memory.survey is not None:       # the method was another one
        memory.survey = memory.refined_with = None
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


def _begin_round(memory: Any, settings: Any, rules: Any, fresh: bool, waits: bool) -> Job:
    """
    Return begin_next()'s Job by the method geometry.

    The schedule is run where parameters are missing or *fresh* ones wanted. Else what changed is
    labelled by those in force, and the next blocks of a sweep, over which they are estimated
    anew (spec section 12.5): the next sweep goes by the new ones.

    """
    surveyed = memory.survey is not None and memory.survey.fitted
    if surveyed:
        memory.survey.end()
    if fresh or _unknown(memory, settings, rules):
        nothing = surveyed and memory.geometry is None      # all of it moved away
        if not waits or nothing or memory.n_voxels <= settings.sweep:
            return begin(memory, settings)
        memory.survey = Survey(memory, settings, rules)
    if memory.survey is not None:
        beside = memory.survey.step()
        memory.refinements += 1
        return Job(memory, settings, snapshot.nothing(memory), memory.rho, number_of_ids(memory),
                   memory.geometry, renewed=beside)
    renewed, ended = None, memory.sweep is None or memory.sweep.ended
    memory.relief.young &= not ended
    if ended and memory.n_observations != memory.rho_of:
        renewed = partial(_renewed, memory.geometry, memory.tally, memory.relief,
                          settings.geometry)
        memory.sweep, memory.tally = Sweep(memory.m.blocks, memory.n_blocks), Tally()
        memory.rho_of, memory.since_rho = memory.n_observations, 0
    memory.since_rho += 1
    also = next_blocks(memory.sweep, memory.m.blocks, memory.table, settings.sweep)
    taken = reached(memory, settings, False, also)
    snapshot.settle(memory)
    snapshot.settle_blocks(memory, also)    # a survey leaves their marks
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry,
               memory.sweep, renewed)


def _unknown(memory: Any, settings: Any, rules: Any) -> bool:
    """Return whether there is nothing to go by, nor a survey under way that will give it."""
    if memory.survey is not None:
        return bool(memory.survey.outdated(rules))
    return memory.rho is None or memory.refined_with != rules or news(memory, settings) or \
        not has_relief(memory, settings)


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
    if new:
        fit_anew(memory, settings)
    renewed = None if new else paged.next_sweep(memory, settings.geometry)
    taken = paged.part(memory, settings, new)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry,
               memory.sweep, renewed, learns=True)
