"""Why the method geometry calls one place what it does: every term of its score."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.dense import looks
from persem_ros.core.geometry.hints import hints
from persem_ros.core.geometry.labelling import SMOOTHED, with_ring
from persem_ros.core.geometry.method import groups_in, model_of, places_of
from persem_ros.core.geometry.schedule import fit
from persem_ros.core.geometry.shape import LEVELS
from persem_ros.core.geometry.votes import take_votes


def account(memory: Any, taken: Any, number: int, settings: Any,
            parameters: Optional[Any] = None) -> dict[str, Any]:
    """
    Return how a voxel comes to its label by the method geometry.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map.
    taken : core.refine.snapshot.Snapshot
        The whole map.
    number : int
        The voxel's number.
    settings : persem_ros.settings.config.Refine
        up and geometry.
    parameters : Parameters or SparseParameters, optional
        What to go by; None: fitted to the map.

    Returns
    -------
    dict
        votes {c: p_v}, looks (N_v) and independent (n_v); height (voxels above ground), tilt
        (0 upright, 1 sloping, 2 level, 3 none) and roughness (0 smooth, 1 rough, 2 scattered);
        shape, cell and shifted_cell {c: P_k(c|b_k)}, what such places are called; unlikely, the
        classes that refine.geometry.heights has elsewhere; neighbours
        {c: mean Q}, empty without any; frequencies {c: pi}; posterior {c: Q}; rho; label and
        probability.

    """
    constants = settings.geometry
    votes = take_votes(memory, taken, constants.directions,
                       known=None if parameters is None else parameters.classes)
    places = places_of(memory, taken, settings)
    cells = cells_at(places.ground, constants.cell) if parameters is None else parameters.cells
    groups = groups_in(places, cells, constants.cell)
    model = model_of(memory.m.blocks, taken, votes, groups, cells, constants, parameters)
    if parameters is None:
        parameters = fit(model, constants.rounds)
    row = int(taken.row[number]) - 1
    wanted = [np.array([row])]
    if constants.smoothing:
        for _ in range(SMOOTHED):
            wanted.insert(0, with_ring(model.blocks, taken, wanted[0]))
    around = with_ring(model.blocks, taken, np.array([row]))
    Q, theirs = model.posterior(parameters, wanted, around[around != row])
    first = votes.start[row]
    voted = slice(first, first + votes.count[row])
    best = int(np.flatnonzero(Q.max() - Q <= 1e-9)[0])
    named = _by_class(votes.classes)
    likely = hints(constants.heights, parameters.classes)[groups.fine[row]]
    shape = parameters.group_share(0, groups.fine[row], constants.prior) * likely
    return {
        'votes': {int(votes.classes[z]): float(share) for z, share in zip(
            votes.place[voted], votes.share[voted]) if z >= 0},
        'looks': float(votes.total[row]),
        'independent': float(looks(votes.total[row], parameters.rho)),
        'height': int(groups.height[row]), 'tilt': int(places.shape[row]) // LEVELS,
        'roughness': int(places.shape[row]) % LEVELS,
        'shape': named(shape / shape.sum()),
        'unlikely': parameters.classes[likely < 1.0].tolist(),
        'cell': named(parameters.group_share(1, groups.coarse[row], constants.prior)),
        'shifted_cell': named(parameters.group_share(2, groups.shifted[row], constants.prior)),
        'neighbours': {} if theirs is None else named(theirs),
        'frequencies': named(parameters.pi), 'posterior': named(Q), 'rho': parameters.rho,
        'label': int(votes.classes[best]), 'probability': float(Q[best])}


def _by_class(classes: Any) -> Any:
    """Return a function that makes {class id: value} of an array (K,)."""
    return lambda values: dict(zip(classes.tolist(), np.asarray(values).tolist()))
