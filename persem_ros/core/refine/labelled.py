"""Labels of a snapshot by any method, and of the whole map without entering them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.method import Labelled, relabel
from persem_ros.core.jit import split
from persem_ros.core.memory.blocks import directions
from persem_ros.core.refine import fusion, selection, snapshot

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.core.refine.snapshot import Snapshot
    from persem_ros.settings.config import Refine

# Methods that look no farther than a voxel's neighbours: a part of the map at a time will do.
LOCAL = {'majority', *fusion.MODES, *selection.METHODS}


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


def number_of_ids(memory: Any) -> Any:
    """Return K, the number of distinct ids of all counted pixels."""
    return int(np.count_nonzero(memory.seen_ids))


def trust_of(rho: NDArray[np.float64], lambda_volatility: float) -> NDArray[np.float64]:
    """Return exp(-lambda_v rho(c)) of every id, (65536,) float64; most ids never occur."""
    trust, volatile = np.ones(len(rho)), np.flatnonzero(rho)
    trust[volatile] = np.exp(-lambda_volatility * rho[volatile])
    return trust


def _with(function: Any, scratch: np.dtype[Any]) -> Callable[..., Any]:
    """Return *function* with a scratch record of its own for each slice of the work."""
    return lambda begin, end, *arguments: function(begin, end, np.zeros(1, scratch), *arguments)
