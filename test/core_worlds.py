"""What the core's tests share: how many examples, random frames and bridges to the reference."""

from dataclasses import replace
from functools import partial
import math
import os

from hypothesis import HealthCheck, settings, strategies as st
import numpy as np
from persem_ros.core.frame.observe import Observations
from persem_ros.core.memory import frame_pages, frame_table, paging
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.frames import UNKNOWN
from persem_ros.settings.config import Refine
import reference as ref

# A continuous-integration machine sees the same examples each time; a developer sees new ones.
examples = partial(settings, deadline=None, derandomize='CI' in os.environ,
                   suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])

# Ids on both ends of the range, and more of them than a voxel's own record has places for.
IDS = (0, 1, 2, 3, 5, 8, 13, 65533, 65534)
NO_IDS = (-1, -7, 65535, 70000)


def rotation(rng):
    """Return a random 3x3 rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def pose(rng, spread=3.0):
    """Return a random 4x4 pose whose position is within about *spread* metres."""
    T = np.eye(4)
    T[:3, :3] = rotation(rng)
    T[:3, 3] = rng.normal(scale=spread, size=3)
    return T


seeds = st.integers(0, 2 ** 32 - 1)

# Corners of the cubes in which worlds lie: across the borders of blocks, below zero, far away.
CORNERS = ((-1, -1, -1), (6, 7, 6), (-9, 0, 7), (15, -16, -1), (10 ** 8, -10 ** 8, 3))
# Shares of 2, 3, 4 and 7 pixels: halves and quarters add up to exact ties, thirds do not.
EXACT = (0.25, 0.5, 0.75, 1.0)
SHARES = EXACT + (1 / 3, 2 / 3, 2 / 7, 3 / 7)


@st.composite
def worlds(draw, most_frames=14, shares=None, repeats=True):
    """
    Draw a random sequence of frames for both memories.

    Returns
    -------
    list of (stamp, dict, list)
        Per frame the stamp, {voxel: (c, s)} and the ids of all counted pixels.

    """
    rng = np.random.default_rng(draw(seeds))
    ids = [IDS[i] for i in rng.permutation(len(IDS))[:draw(st.integers(1, len(IDS)))]]
    # The most frequent of K ids has a share of 1/K at least.
    shares = [s for s in shares or draw(st.sampled_from([EXACT, SHARES])) if s >= 1 / len(ids)]
    hit = draw(st.sampled_from([0.2, 0.6, 1.0]))
    corner, size = draw(st.sampled_from(CORNERS)), rng.integers(1, 4, 3)
    cells = [tuple(int(x) for x in np.add(corner, d)) for d in np.ndindex(*size)]
    cells.append(tuple(int(x) for x in np.add(corner, (5, 5, 5))))      # with no neighbour
    habits = {cell: rng.choice(ids) for cell in cells}
    frames, stamp = [], int(rng.integers(0, 2 ** 40))
    for _ in range(draw(st.integers(1, most_frames))):
        if not frames or not repeats or rng.random() > 0.15:    # another sensor's, at times
            stamp += int(rng.integers(1, 10 ** 9))
        seen = {cells[i]: (int(habits[cells[i]] if rng.random() < 0.6 else rng.choice(ids)),
                           float(np.float32(rng.choice(shares))))
                for i in rng.permutation(len(cells)) if rng.random() < hit}
        frames.append((stamp, seen, [int(c) for c in ids]))
    return frames


@st.composite
def refinements(draw, **fixed):
    """Draw Refine settings: the defaults, round ones that hit thresholds exactly, or any."""
    kind = draw(st.sampled_from(['default', 'round', 'round', 'any', 'any']))
    chosen = {'neighbours': draw(st.sampled_from([6, 18, 26])),
              'min_observations': draw(st.integers(1, 4))}
    if kind == 'round':
        quarters, zero = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]), st.just(0.0)
        chosen |= {'lambda_volatility': 0.0, 'lambda_disagreement': draw(
            st.sampled_from([0.0, math.log(2)])), 'lambda_gap': 0.0, 'lambda_recency': draw(zero)}
        chosen |= {name: draw(quarters) for name in ('eta', 'tau_replay', 'tau_context', 'beta')}
        chosen['gamma'] = draw(st.sampled_from([0.0, 0.5, 1.0]))
    elif kind == 'any':
        chosen |= {name: draw(st.floats(low, high)) for name, low, high in (
            ('eta', 0.0, 1.0), ('lambda_volatility', 0.0, 3.0), ('lambda_disagreement', 0.0, 3.0),
            ('lambda_gap', 0.0, 0.5), ('gamma', 0.0, 1.0), ('tau_replay', 0.0, 0.5),
            ('tau_context', 0.0, 0.5), ('lambda_recency', 0.0, 0.5), ('beta', 0.0, 2.0))}
    return replace(Refine(), **{**chosen, **fixed})


def observations(stamp, seen, ids=(), sensor='', unknown=()):
    """Return the Observations of a frame; *unknown* voxels are seen without being observed."""
    voxels = np.array([*seen, *unknown], np.int32).reshape(-1, 3)
    labels = np.array([c for c, _ in seen.values()] + [UNKNOWN] * len(unknown), np.uint16)
    confidences = np.array([s for _, s in seen.values()] + [0] * len(unknown), np.float32)
    ids = np.unique(np.array([*ids, *(c for c, _ in seen.values())], np.uint16))
    return Observations(voxels, labels, confidences, np.arange(len(labels), dtype=np.int32), ids,
                        stamp, np.eye(4), sensor)


def core_of(frames, max_history=0):
    """Return the core's memory of the frames."""
    memory = VoxelMemory(0.5, max_history=max_history)
    for frame in frames:
        memory.add(observations(*frame))
    return memory


def reference_of(frames):
    """Return the reference's memory of the frames."""
    memory = ref.Memory()
    for stamp, seen, ids in frames:
        memory.add(seen, stamp, ids)
    return memory


def columns_of(memory):
    """Return {voxel: (label, source)} as the core's map has it."""
    columns = memory.voxels()
    return {tuple(v): (c, s) for v, c, s in zip(
        columns['voxel'].tolist(), columns['label'].tolist(), columns['source'].tolist())}


def tiny_pages(patch, rows):
    """Have pages of the frame table hold a few rows, and leave nonsense behind where they go."""
    for module in frame_pages, frame_table, paging:
        patch.setattr(module, 'PAGE', rows)
    patch.setattr(frame_pages, '_give_back', lambda column, first, end: column.__setitem__(
        slice(first, end), 9 if column.dtype.kind == 'u' else -1))
