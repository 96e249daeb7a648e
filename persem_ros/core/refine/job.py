"""Making up the map's mind: a refinement as a job, and its three steps in one call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.kept import fitted_by, from_arrays, in_cells, Tally, within
from persem_ros.core.geometry.method import Labelled, relabel
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import directions
from persem_ros.core.memory.history import TOGETHER
from persem_ros.core.memory.pools import CLOCK
from persem_ros.core.refine import fusion, paged, selection, snapshot
from persem_ros.core.refine.fitting import Fitting
from persem_ros.core.refine.reach import ASIDE, reached, surrounded
from persem_ros.core.refine.sweep import next_blocks, Sweep

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.core.refine.snapshot import Snapshot
    from persem_ros.settings.config import Refine

AT_ONCE = 64        # blocks of a step of refine_all() that mapping waits for
VOXELS_AT_ONCE = 1 << 17, 8     # of a step that nobody waits for; and its share of the bound
IN_A_BLOCK = 100    # voxels, where nothing is in memory to count
# Methods that look no farther than a voxel's neighbours: a part of the map at a time will do.
SWEPT = {'majority', *fusion.MODES, *selection.METHODS}


@dataclass(frozen=True, eq=False)
class Job:
    """
    A refinement under way.

    The mapping thread makes it with begin() and ends it with finish() (or abandon()); compute()
    may run on any thread in between, while frames are added.

    """

    memory: VoxelMemory
    settings: Refine
    snapshot: snapshot.Snapshot
    rho: NDArray[np.float64]
    n_ids: int
    parameters: Any
    sweep: Sweep | None = None
    renewed: Callable[[], Any] | None = None    # what *parameters* are to be, found beside
    learns: bool = False

    def compute(self) -> Labelled:
        """Return the core.geometry.method.Labelled of the snapshot's refined rows."""
        if self.sweep is not None:
            self.sweep.prepare()
        found = labelled(self.memory, self.snapshot, self.settings.method, self.settings, self.rho,
                         self.n_ids, self.renewed() if self.renewed else self.parameters)
        if self.learns:
            paged.learn(self.memory.pager, self.snapshot, self.settings)
        return found


def refine(memory: VoxelMemory, settings: Refine, full: bool = True, max_voxels: int = 0) -> int:
    """
    Refine the map: begin, compute, finish (spec section 3; section 4 for other methods).

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map.
    settings : persem_ros.settings.config.Refine
        The method and its constants.
    full : bool
        Take the class volatility anew and visit every voxel; False: keep the last volatility
        and visit the voxels whose own or neighbouring evidence changed.
    max_voxels : int
        As in refine_all(), where a store holds the rest of the map.

    Returns
    -------
    int
        Number of voxels visited.

    """
    if full and memory.pager is not None:
        return sum(refine_all(memory, settings, max_voxels, blocks_at_once(memory, max_voxels)))
    job = begin(memory, settings, full)
    return finish(job, *job.compute())


def begin(memory: VoxelMemory, settings: Refine, full: bool = True) -> Job:
    """Return the Job of a refinement; call it on the mapping thread, between two frames."""
    if settings.method == 'geometry' and memory.pager is not None:
        return _begin_paged(memory, settings)
    if full or memory.rho is None:
        _take_rho(memory)
    rules = _rules(memory, settings)
    everywhere = memory.refined_with != rules
    memory.refined_with = rules
    memory.since_rho += 1
    if everywhere:
        memory.sweep = None
    if settings.method == 'geometry':
        everywhere |= _news(memory, settings)
        taken = reached(memory, settings, everywhere)
    else:
        taken = snapshot.take(memory, None if everywhere else settings.neighbours)
    snapshot.settle(memory)
    memory.refinements += 1
    assert memory.rho is not None, 'it was taken above'
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry)


def _news(memory: Any, settings: Any) -> bool:
    """Return whether parameters have to be fitted anew: there are none, or a class is new."""
    by = fitted_by(settings)
    if memory.geometry is None and memory.habits:
        memory.geometry = from_arrays(memory.habits)
    memory.habits = {}
    if memory.geometry is not None and memory.fitted_by == by and \
            not (memory.voted_ids & ~memory.known_ids).any():
        return False
    memory.geometry, memory.fitted_by, memory.known_ids = None, by, memory.voted_ids.copy()
    return True


def begin_next(memory: Any, settings: Any, fresh: Any = False) -> Any:
    """
    Return the Job of the refinement that is next in turn (spec section 9, *Flat*).

    It visits what changed and, beside it, the next settings.sweep voxels, until all have seen
    the present class volatility. That is taken anew when settings.volatility_every refinements
    were begun with it and all voxels have seen it, or at once with *fresh*.

    """
    rules = _rules(memory, settings)
    if settings.method == 'geometry':
        return _begin_paged(memory, settings) if memory.pager is not None else \
            _begin_round(memory, settings, rules, fresh)
    if fresh or memory.rho is None or _due(memory, settings):
        _take_rho(memory)
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


def blocks_at_once(memory: VoxelMemory, max_voxels: int) -> int:
    """
    Return how many blocks refine_all() best takes a step where nobody waits for it.

    A step looks at the blocks around its own, too: a map in memory took by the method
    geometry 3.1 s instead of 11.8 (860 000 voxels, a busy machine) with 64 blocks a step.

    """
    most, share = VOXELS_AT_ONCE
    voxels = min(most, max_voxels // share) if max_voxels else most
    mean = memory.n_voxels / memory.n_blocks if memory.n_voxels else IN_A_BLOCK
    return max(AT_ONCE, int(voxels / mean))


def refine_all(memory: VoxelMemory, settings: Refine, max_voxels: int = 0,
               at_once: int = AT_ONCE, saves: bool = True) -> Iterator[int]:
    """
    Refine a map of which a store holds the rest, block after block with all around them.

    By the method geometry the parameters are fitted first, to all of it.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        It has a pager.
    settings : persem_ros.settings.config.Refine
        The method and its constants.
    max_voxels : int
        The bound of memory, between two steps; 0: none.
    at_once : int
        Blocks of a step; labels do not depend on it.
    saves : bool
        As of core.memory.paging.Pager.visit.

    Yields
    ------
    int
        How many voxels a step has visited.

    """
    pager: Any = memory.pager
    index, known, columns = pager.index(), None, None
    if settings.method == 'geometry':
        fitting = Fitting(memory, settings, index, at_once, max_voxels, saves)
        known = yield from fitting.parameters()
        pager.columns = columns = fitting.columns
    _take_rho(memory)
    assert pager is not None and memory.rho is not None, 'of a map that is paged'
    snapshot.settle(memory)
    memory.geometry = known
    if known is not None:
        memory.fitted_by, memory.known_ids = fitted_by(settings), memory.voted_ids.copy()
    arrays = {} if known is None else known.arrays()
    for numbers in pager.visit(index, at_once, max_voxels, saves):
        _settle_blocks(memory, numbers)
        here = None
        if columns is None:
            taken = snapshot.take(memory, settings.neighbours, numbers)
        else:
            taken = surrounded(memory, settings, numbers, ASIDE, columns)
            if taken.refined:
                here = within(arrays, cells_at(taken.relief.ground, settings.geometry.cell))
        memory.refinements += 1
        job = Job(memory, settings, taken, memory.rho, number_of_ids(memory), here)
        visited = finish(job, *job.compute())
        memory.geometry = known
        yield visited
    memory.sweep, memory.refined_with = None, _rules(memory, settings)
    memory.since_rho = 1


def _settle_blocks(memory: VoxelMemory, numbers: NDArray[np.int64]) -> None:
    """Mark every voxel of some blocks as unchanged."""
    marked = numbers[memory.m.blocks['changed'][numbers].any(axis=1)]
    memory.m.used[CLOCK] += 1
    memory.m.blocks['changed'][marked] = 0
    memory.m.stamps['stored'][marked] = memory.clock


def _begin_round(memory: Any, settings: Any, rules: Any, fresh: bool) -> Job:
    """
    Return begin_next()'s Job by the method geometry.

    The schedule is run where parameters are missing or *fresh* ones wanted. Else what changed is
    labelled by those in force, and the next blocks of a sweep, over which they are estimated
    anew (spec section 12.5): the next sweep goes by the new ones.

    """
    if fresh or memory.rho is None or memory.refined_with != rules or _news(memory, settings):
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
    rules = _rules(memory, settings)
    if memory.rho is None:
        memory.rho, memory.rho_of = memory.volatility(), -1
    if memory.refined_with not in (None, rules):        # None also where a block has left
        memory.sweep = None
    memory.refined_with = rules
    memory.since_rho += 1
    if memory.fitted_by is not None and memory.fitted_by[0] != settings.up:
        memory.pager.columns = None
    news = _news(memory, settings)
    renewed = None if news else paged.next_sweep(memory, settings.geometry)
    taken = paged.part(memory, settings, news)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, number_of_ids(memory), memory.geometry,
               memory.sweep, renewed, learns=True)


def swept(memory: Any, settings: Any) -> Any:
    """Return whether every voxel has seen the present volatility and settings."""
    return memory.rho is not None and memory.refined_with == _rules(memory, settings) and \
        (memory.sweep is None or memory.sweep.ended)


def at_rest(memory: Any, settings: Any) -> Any:
    """Return whether nothing is left to refine until something is observed or let go."""
    return swept(memory, settings) and memory.rho_of == memory.n_observations and \
        not len(memory.changed_blocks())


def _take_rho(memory: Any) -> None:
    """Take the class volatility anew; every voxel has to see it."""
    memory.rho, memory.rho_of = memory.volatility(), memory.n_observations
    memory.refined_with, memory.since_rho = None, 0
    memory.geometry, memory.tally, memory.habits = None, None, {}


def _due(memory: Any, settings: Any) -> Any:
    """Return whether the volatility has been used for long enough, and by all voxels."""
    return memory.since_rho >= settings.volatility_every and (
        memory.sweep is None or memory.sweep.ended)


def _rules(memory: Any, settings: Any) -> Any:
    """Return what labels everywhere depend on: settings, and for one method the number of ids."""
    return settings, number_of_ids(memory) if settings.method == 'probabilistic' else 0


def number_of_ids(memory: Any) -> Any:
    """Return K, the number of distinct ids of all counted pixels."""
    return int(np.count_nonzero(memory.seen_ids))


def finish(job: Job, labels: NDArray[np.uint16], sources: NDArray[np.uint8], posterior: Any,
           parameters: Any, sums: Any = None) -> int:
    """
    Enter what a job computed into the map, on the mapping thread; return how many voxels.

    A label that equals the majority of the snapshot follows the majority of today.

    """
    taken, pools = job.snapshot, job.memory.m
    pools.used[CLOCK] += 1
    split(_enter, taken.refined, pools.voxels, job.memory.store.beliefs, pools.stamps,
          pools.used[CLOCK], taken.block, taken.number, taken.majority, labels, sources, posterior)
    job.memory.geometry = parameters
    if sums is not None and job.memory.tally is not None:
        job.memory.tally.add(sums, taken.swept)
    job.memory.refinements -= 1
    return taken.refined


def abandon(job: Any) -> None:
    """Give a job up: its voxels count as changed again, through a full refinement."""
    job.memory.refinements -= 1
    job.memory.rho = None


def label(
        memory: VoxelMemory, method: str, settings: Refine
) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """
    Label the whole map by *method* without entering it.

    Returns
    -------
    labels : ndarray, shape (voxels,), uint16
        By voxel number.
    sources : ndarray, shape (voxels,), uint8

    """
    taken = snapshot.take(memory)
    rows = labelled(memory, taken, method, settings, memory.volatility(),
                    number_of_ids(memory))[:2]
    labels, sources = (np.zeros(memory.n_numbers, a.dtype) for a in rows)
    labels[taken.number], sources[taken.number] = rows
    return labels, sources


def labelled(
        memory: VoxelMemory, taken: Snapshot, method: str, settings: Refine,
        rho: NDArray[np.float64], n_ids: int, parameters: Any = None
) -> Labelled:
    """Return the core.geometry.method.Labelled of a snapshot's refined rows by *method*."""
    if method == 'geometry':
        return relabel(memory, taken, settings, parameters)
    n, links = taken.refined, memory.m.links
    labels, sources = taken.majority[:n].copy(), np.zeros(n, np.uint8)
    if method in fusion.MODES:
        split(_with(fusion.fuse, fusion.VOTES), n, links, taken.frame_t, taken.start,
              taken.majority, taken.observations, taken.first, taken.head, fusion.MODES[method],
              memory.max_history, float(settings.lambda_recency), float(settings.beta), n_ids,
              labels)
    elif method in selection.METHODS:
        anchor, then = selection.METHODS[method]
        gap = np.exp(-settings.lambda_gap * np.arange(selection.GAPS))
        split(_with(selection.select, selection.SCRATCH), n, memory.m.blocks, links,
              taken.frame_t, taken.block, taken.cell, taken.row, taken.start, taken.classes,
              taken.shares, taken.majority, taken.observations, taken.first, taken.head,
              directions(settings.neighbours), anchor, then,
              int(settings.min_observations), float(settings.eta),
              trust_of(rho, settings.lambda_volatility), gap,
              float(np.exp(-settings.lambda_disagreement)), float(settings.gamma),
              float(settings.lambda_gap), float(settings.tau_replay),
              float(settings.tau_context), memory.max_history, labels, sources)
    elif method != 'majority':
        raise ValueError(f'{method!r} is not a method on voxels')
    return Labelled(labels, sources, np.zeros(n, np.float32), None)


def trust_of(rho: NDArray[np.float64], lambda_volatility: float) -> NDArray[np.float64]:
    """Return exp(-lambda_v rho(c)) of every id, (65536,) float64; most ids never occur."""
    trust, volatile = np.ones(len(rho)), np.flatnonzero(rho)
    trust[volatile] = np.exp(-lambda_volatility * rho[volatile])
    return trust


def _with(function: Any, scratch: np.dtype[Any]) -> Callable[..., Any]:
    """Return *function* with a scratch record of its own for each slice of the work."""
    return lambda begin, end, *arguments: function(begin, end, np.zeros(1, scratch), *arguments)


@kernel
def _enter(begin, end, voxels, beliefs, stamps, now, block, number, majority, labels, sources,
           posterior):
    """Write labels, sources and posteriors of the voxels; stamp the blocks where they are new."""
    fetched = 0.0       # returned, so that it is done: several records are awaited at once
    for r in range(begin, end):
        if (r - begin) % TOGETHER == 0:
            for q in range(r, min(r + TOGETHER, end)):
                fetched += voxels[number[q]].n + beliefs[number[q]].posterior
        v = number[r]
        gone = voxels[v].gone > 0       # meanwhile
        believed = np.float32(0.0) if gone else posterior[r]
        before = beliefs[v].posterior
        if believed != before:
            stamps[block[r]].shown = now
            stamps[block[r]].stored = now
        if believed != 0.0 or before != 0.0:    # no page of it is written without
            beliefs[v].posterior = believed
            beliefs[v].label = labels[r]
        if gone:
            continue
        label = voxels[v].majority if labels[r] == majority[r] else labels[r]
        if voxels[v].label != label or voxels[v].source != sources[r]:
            voxels[v].label = label
            voxels[v].source = sources[r]
            stamps[block[r]].shown = now
            stamps[block[r]].stored = now
    return fetched
