"""Why a voxel has its label: spec sections 2 and 3 for one voxel, every number kept."""

from __future__ import annotations

import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.account import account
from persem_ros.core.geometry.kept import parameters_of
from persem_ros.core.geometry.method import GEOMETRY
from persem_ros.core.memory.blocks import directions
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.refine.reach import at_hand
from persem_ros.core.refine.selection import (
    CANDIDATE, CONTEXT, HISTORY, MAJORITY, METHODS, PROPOSED, TRUST, VERIFIED)
from persem_ros.core.refine.snapshot import take

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Refine


def explain(memory: VoxelMemory, voxel: NDArray[np.int32], settings: Refine) -> dict[str, Any]:
    """
    Return the trace of a voxel's refinement, computed step by step in plain Python.

    Parameters
    ----------
    memory : persem_ros.core.memory.voxel_memory.VoxelMemory
        The map.
    voxel : sequence of 3 int
        Index of an observed voxel.
    settings : persem_ros.settings.config.Refine
        The method and its constants. The fusion methods of spec section 4 have no steps: for
        them there is only what the voxel and its neighbours have seen.

    Returns
    -------
    dict
        observations (N_v), recurrent, majority (c_M); evidence {c: h_v}, shares {c: p_v};
        neighbours (number), hard {c: S_hard}, soft {c: q_v}; anchor {c: (1-eta) p_v + eta q_v}
        and anchor_label (c_H), None without neighbours; steps, a list of dicts (label,
        confidence, t, gap, surprise, weight, leader), one per stored observation, and
        replayed {c: e}; candidate, replay_margin, hard_margin, soft_margin (None where no step
        proposes another label); label and source that follow from all this; stored_label and
        stored_source, what the map has; changed (True where it was observed after the map was
        refined); gone, how many looks through it made it so (0: before it was moved),
        None: it is there, else nothing follows; geometry, for that method what
        core.geometry.account.account returns, with the map's parameters, or fitted ones where it
        has none; shapes and ground are those of the last refinement where these are at hand.

    Raises
    ------
    PersemError
        For a voxel that was never observed.

    """
    number = memory.number(voxel)
    record = memory.m.voxels[number]
    majority = int(record['majority'])
    evidence = memory.evidence(voxel)
    total = sum(evidence.values())
    shares = {c: h / total for c, h in evidence.items()}
    n, hard, soft = support(memory, voxel, settings.neighbours)
    rho = memory.volatility() if memory.rho is None else memory.rho
    steps, replayed = replay(*memory.history(voxel), rho, settings)
    trace: dict[str, Any] = {
        'observations': int(record['n']),
        'recurrent': int(record['n']) >= settings.min_observations,
        'majority': majority, 'evidence': evidence, 'shares': shares, 'neighbours': n,
        'hard': hard, 'soft': soft, 'anchor': {}, 'anchor_label': None, 'steps': steps,
        'replayed': replayed, 'candidate': None, 'replay_margin': None, 'hard_margin': None,
        'soft_margin': None, 'label': majority, 'source': MAJORITY,
        'stored_label': int(record['label']), 'stored_source': int(record['source']),
        'changed': memory.changed(voxel), 'geometry': None,
        'gone': int(memory.store.passed['count'][number]) if record['gone'] else None}
    if trace['gone'] is not None:
        return trace
    if n:
        trace['anchor'] = {c: (1 - settings.eta) * shares.get(c, 0.0)
                           + settings.eta * soft.get(c, 0.0) for c in sorted({*shares, *soft})}
        trace['anchor_label'] = argmax(trace['anchor'], majority)
    if settings.method == 'geometry':
        known = parameters_of(memory, settings)
        taken = None if known is None else at_hand(memory, voxel, settings)
        found = trace['geometry'] = account(
            memory, take(memory) if taken is None else taken, number, settings, known)
        trace['label'] = found['label']
        trace['source'] = GEOMETRY if found['label'] != majority else MAJORITY
    if settings.method in METHODS and trace['recurrent']:
        _decide(trace, *METHODS[settings.method], settings)
    return trace


def quickly(memory: VoxelMemory, voxel: NDArray[np.int32], settings: Refine) -> bool:
    """Return whether explain() need not look at the whole map."""
    return settings.method != 'geometry' or (
        parameters_of(memory, settings) is not None
        and at_hand(memory, voxel, settings) is not None)


def _decide(trace: dict[str, Any], anchor: bool, then: int, settings: Refine) -> None:
    """Enter candidate, margins, label and source: the steps of the method."""
    majority = trace['majority']
    if anchor and trace['anchor_label'] not in (None, majority):
        trace['label'], trace['source'] = trace['anchor_label'], HISTORY
        return
    if then in (PROPOSED, VERIFIED):
        source, candidate = TRUST, argmax({majority: 0.0, **trace['replayed']}, majority)
        margin = trace['replayed'].get(candidate, 0.0) - trace['replayed'].get(majority, 0.0)
        proposed = exceeds(margin, settings.tau_replay)
    elif then == CANDIDATE and trace['neighbours']:
        source, candidate = CONTEXT, argmax({majority: 0.0, **trace['hard']}, majority)
        margin, proposed = None, True
    else:
        return
    if candidate == majority:
        return
    trace['candidate'], trace['replay_margin'] = candidate, margin
    if then != PROPOSED:
        for name in ('hard', 'soft'):
            trace[f'{name}_margin'] = \
                trace[name].get(candidate, 0.0) - trace[name].get(majority, 0.0)
        proposed = proposed and trace['neighbours'] > 0 and \
            exceeds(trace['hard_margin'], settings.tau_context) and \
            exceeds(trace['soft_margin'], settings.tau_context)
    if proposed:
        trace['label'], trace['source'] = candidate, source


def support(
        memory: VoxelMemory, voxel: NDArray[np.int32], neighbours: int
) -> tuple[int, dict[int, float], dict[int, float]]:
    """
    Return what the neighbours of a voxel say.

    Returns
    -------
    n : int
        How many were observed.
    hard : dict
        {c: S_hard(c)}, the share of them whose majority label is c.
    soft : dict
        {c: q_v(c)}, the mean of their p_u(c).

    """
    offsets = np.array([(d // 9 - 1, d // 3 % 3 - 1, d % 3 - 1)
                        for d in directions(neighbours).tolist()])
    around = (np.asarray(voxel) + offsets).astype(np.int32)
    numbers = memory.find(around)
    numbers[memory.m.voxels['gone'][numbers] > 0] = -1      # a -1 stays one
    hard: dict[int, int] = {}
    soft: dict[int, float] = {}
    n = int(np.count_nonzero(numbers >= 0))
    for index, number in zip(around, numbers):
        if number < 0:
            continue
        evidence = memory.evidence(index)
        total = sum(evidence.values())
        for c, h in evidence.items():
            soft[c] = soft.get(c, 0.0) + h / total
        c = int(memory.m.voxels[number]['majority'])
        hard[c] = hard.get(c, 0) + 1
    return n, {c: k / n for c, k in hard.items()}, {c: q / n for c, q in soft.items()}


def replay(
        labels: NDArray[np.uint16], confidences: NDArray[np.float32], times: NDArray[np.int32],
        rho: NDArray[np.float64], settings: Refine
) -> tuple[list[dict[str, float]], dict[int, float]]:
    """
    Return the steps of the trust replay of a history and {c: e} at its end.

    Parameters
    ----------
    labels, confidences, times : ndarray, shape (k,)
        The stored observations, oldest first: VoxelMemory.history().
    rho : ndarray, shape (65536,), float64
        Class volatility.
    settings : persem_ros.settings.config.Refine
        The constants.

    """
    steps, before, leader = [], None, -1
    # Arrays, in the order in which classes appear: a voxel may have been seen as all of them.
    place: dict[int, int] = {}
    ids, evidence = np.empty(65536, np.int64), np.zeros(65536)
    for c, s, t in zip(labels.tolist(), confidences.tolist(), times.tolist()):
        surprise = int(before is not None and leader != c)
        gap = 0 if before is None else t - before
        weight = (s * math.exp(-settings.lambda_volatility * rho[c])
                  * math.exp(-settings.lambda_disagreement * surprise)
                  * math.exp(-settings.lambda_gap * gap))
        evidence[:len(place)] *= settings.gamma
        at = place.setdefault(c, len(place))
        ids[at] = c
        evidence[at] += weight
        known = evidence[:len(place)]
        leader = int(ids[:len(place)][known.max() - known <= TIE].min())
        steps.append({'label': c, 'confidence': s, 't': t, 'gap': gap, 'surprise': surprise,
                      'weight': weight, 'leader': leader})
        before = t
    return steps, dict(zip(place, evidence[:len(place)].tolist()))


def argmax(values: dict[int, float], preferred: int | None = None) -> int:
    """Return the key of the largest value; *preferred* wins its ties, else the smaller key."""
    most = max(values.values())
    best = [c for c, value in values.items() if most - value <= TIE]
    return preferred if preferred in best else min(best)


def exceeds(x: float, threshold: float) -> bool:
    """Return whether x > threshold, where a tie is none (spec section 2)."""
    return x > threshold + TIE
