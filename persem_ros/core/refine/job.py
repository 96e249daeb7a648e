"""Making up the map's mind: a refinement as a job, and its three steps in one call."""

from dataclasses import dataclass

import numpy as np
from persem_ros.core.geometry.method import Labelled, relabel
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import directions
from persem_ros.core.refine import fusion, selection, snapshot


@dataclass(frozen=True, eq=False)
class Job:
    """
    A refinement under way.

    The mapping thread makes it with begin() and ends it with finish() (or abandon()); compute()
    may run on any thread in between, while frames are added.

    """

    memory: object
    settings: object
    snapshot: snapshot.Snapshot
    rho: np.ndarray
    n_ids: int
    parameters: object

    def compute(self):
        """Return the core.geometry.method.Labelled of the snapshot's refined rows."""
        return labelled(self.memory, self.snapshot, self.settings.method, self.settings,
                        self.rho, self.n_ids, self.parameters)


def refine(memory, settings, full=True):
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

    Returns
    -------
    int
        Number of voxels visited.

    """
    job = begin(memory, settings, full)
    return finish(job, *job.compute())


def begin(memory, settings, full=True):
    """Return the Job of a refinement; call it on the mapping thread, between two frames."""
    if full or memory.rho is None:
        memory.rho, memory.refined_with, memory.geometry = memory.volatility(), None, None
    n_ids = int(np.count_nonzero(memory.seen_ids))
    # Other settings, or for this one method another number of ids, concern every voxel.
    rules = settings, n_ids if settings.method == 'probabilistic' else 0
    everywhere = memory.refined_with != rules or (
        settings.method == 'geometry' and memory.m.blocks['dirty'][:memory.n_blocks].any())
    memory.refined_with = rules
    taken = snapshot.take(memory, None if everywhere else settings.neighbours)
    snapshot.settle(memory)
    memory.refinements += 1
    return Job(memory, settings, taken, memory.rho, n_ids, memory.geometry)


def finish(job, labels, sources, posterior, parameters):
    """
    Enter what a job computed into the map, on the mapping thread; return how many voxels.

    A label that equals the majority of the snapshot follows the majority of today.

    """
    taken = job.snapshot
    split(_enter, taken.refined, job.memory.m.voxels, taken.number, taken.majority, labels,
          sources)
    _believe(job.memory.store.beliefs, taken.number[:taken.refined], labels, posterior)
    job.memory.geometry = parameters
    job.memory.refinements -= 1
    return taken.refined


def abandon(job):
    """Give a job up: its voxels count as changed again, through a full refinement."""
    job.memory.refinements -= 1
    job.memory.rho = None


def label(memory, method, settings):
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
                    int(np.count_nonzero(memory.seen_ids)))[:2]
    labels, sources = (np.zeros(memory.n_numbers, a.dtype) for a in rows)
    labels[taken.number], sources[taken.number] = rows
    return labels, sources


def labelled(memory, taken, method, settings, rho, n_ids, parameters=None):
    """Return the core.geometry.method.Labelled of a snapshot's refined rows by *method*."""
    if method == 'geometry':
        return relabel(memory, taken, settings, parameters)
    n, links = taken.refined, memory.m.links
    labels, sources = taken.majority[:n].copy(), np.zeros(n, np.uint8)
    if method in fusion.MODES:
        split(_with(fusion.fuse, fusion.VOTES), n, links, taken.frame_t, taken.start,
              taken.classes, taken.majority, taken.observations, taken.first, taken.head,
              fusion.MODES[method], memory.max_history, float(settings.lambda_recency),
              float(settings.beta), n_ids, labels)
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


def trust_of(rho, lambda_volatility):
    """Return exp(-lambda_v rho(c)) of every id, (65536,) float64; most ids never occur."""
    trust, volatile = np.ones(len(rho)), np.flatnonzero(rho)
    trust[volatile] = np.exp(-lambda_volatility * rho[volatile])
    return trust


def _with(function, scratch):
    """Return *function* with a scratch record of its own for each slice of the work."""
    return lambda begin, end, *arguments: function(begin, end, np.zeros(1, scratch), *arguments)


def _believe(beliefs, number, labels, posterior):
    """Note the posteriors of labels; where there are none, forget what was noted before."""
    if posterior.any() or beliefs['posterior'][number].any():
        beliefs['posterior'][number] = posterior
        beliefs['label'][number] = labels


@kernel
def _enter(begin, end, voxels, number, majority, labels, sources):
    """Write labels and sources to the voxels' records."""
    for r in range(begin, end):
        v = number[r]
        if labels[r] == majority[r]:
            voxels[v].label = voxels[v].majority
        else:
            voxels[v].label = labels[r]
        voxels[v].source = sources[r]
