"""A refinement as a job: begun between two frames, computed beside more of them, entered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.method import Labelled
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.history import TOGETHER
from persem_ros.core.memory.pools import CLOCK
from persem_ros.core.refine import paged
from persem_ros.core.refine.labelled import labelled
from persem_ros.core.refine.sweep import Sweep

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.core.refine.snapshot import Snapshot
    from persem_ros.settings.config import Refine


@dataclass(frozen=True, eq=False)
class Job:
    """
    A refinement under way.

    The mapping thread makes it (core.refine.turns) and ends it with finish() (or abandon());
    compute() may run on any thread in between, while frames are added.

    """

    memory: VoxelMemory
    settings: Refine
    snapshot: Snapshot
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
    memory = job.memory
    memory.refinements -= 1
    memory.rho = memory.relief = memory.survey = None


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
