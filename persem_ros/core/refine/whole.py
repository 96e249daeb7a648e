"""The whole map refined by one who waits: in one step, or block after block of a store."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.kept import fitted_by, within
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.fitting import Fitting
from persem_ros.core.refine.job import finish, Job
from persem_ros.core.refine.labelled import number_of_ids
from persem_ros.core.refine.reach import ASIDE, surrounded
from persem_ros.core.refine.rules import rules_of, take_rho
from persem_ros.core.refine.turns import begin

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Refine

AT_ONCE = 64        # blocks of a step of refine_all() that mapping waits for
VOXELS_AT_ONCE = 1 << 17, 8     # of a step that nobody waits for; and its share of the bound
IN_A_BLOCK = 100    # voxels, where nothing is in memory to count


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
    take_rho(memory)
    assert pager is not None and memory.rho is not None, 'of a map that is paged'
    snapshot.settle(memory)
    memory.geometry = known
    if known is not None:
        memory.fitted_by, memory.known_ids = fitted_by(settings), memory.voted_ids.copy()
    arrays = {} if known is None else known.arrays()
    for numbers in pager.visit(index, at_once, max_voxels, saves):
        snapshot.settle_blocks(memory, numbers)
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
    memory.sweep, memory.refined_with = None, rules_of(memory, settings)
    memory.since_rho = 1
