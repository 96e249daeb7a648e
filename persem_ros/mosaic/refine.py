"""A tile is refined: with the ring of blocks around it, and what goes by the whole map."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.kept import within
from persem_ros.core.geometry.overruled import counts_of
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.dump import Blocks
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.job import finish, Job
from persem_ros.core.refine.labelled import number_of_ids
from persem_ros.core.refine.reach import ASIDE, surrounded
from persem_ros.mosaic.fit import Fitted
from persem_ros.mosaic.folder import load_array
from persem_ros.mosaic.surroundings import empty, Surrounded
from persem_ros.mosaic.task import timed
from persem_ros.outputs.map import store
from persem_ros.settings.config import Refine


@dataclass(frozen=True)
class Refining:
    """
    A tile to be refined.

    Attributes
    ----------
    of : Surrounded
        Its map file is replaced.
    rho : str
        File of an array: the class volatility, float64 (65536,).
    fitted : Fitted, optional
        What the method geometry goes by.

    """

    of: Surrounded
    rho: str
    fitted: Fitted | None = None

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.of.name


@timed
def refine(task: Refining) -> dict[str, Any]:
    """Write a tile anew with refined labels; return what it took."""
    config, tile = task.of.config, task.of.tile
    own, memory = task.of.read()
    memory.rho = np.array(load_array(task.rho))
    numbers = block_numbers(memory, own.block_index)
    job = _job(memory, numbers, config.refine, task.fitted)
    finish(job, *job.compute())
    done = dump(memory)
    here = np.repeat(tile.holds(done.block_index), np.diff(done.block_start))
    store.save(task.of.path, replace(
        empty(config), rho=memory.rho, **{
            **{field.name: getattr(own, field.name) for field in fields(Blocks)},
            'label': done.label[here], 'source': done.source[here],
            'posterior': done.posterior[here], 'dirty': np.zeros(len(own.cell), np.uint8)}),
        config)
    return {'tile': [tile.i, tile.j], 'overruled': [] if task.fitted is None else counts_of(
        memory.columns(numbers), config.refine, task.fitted.columns())}


def _job(memory: VoxelMemory, blocks: NDArray[np.int64], settings: Refine,
         fitted: Fitted | None) -> Job:
    """Return the refinement of blocks of the given numbers by what goes by the whole map."""
    known: Any = None
    if fitted is None:
        taken = snapshot.take(memory, settings.neighbours, blocks)
    else:
        taken = surrounded(memory, settings, blocks, ASIDE, fitted.columns())
        known = within(fitted.arrays(), cells_at(taken.relief.ground, settings.geometry.cell))
    memory.refinements += 1
    rho: Any = memory.rho
    return Job(memory, settings, taken, rho, number_of_ids(memory), known)
