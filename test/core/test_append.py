"""Adding frames in rounds and in parts: the reference's map, the same bytes by any threads."""

from contextlib import contextmanager
from dataclasses import replace

from core_worlds import EXACT, examples, observations, seeds, SHARES
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.memory import append
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.pools import (
    BLOCKS, CHUNK, FREE, LINKS, RETIRED, SPILLS, STORED, VOXELS)
from persem_ros.core.memory.voxel_memory import VoxelMemory
import pytest
import reference as ref

PLANE = [tuple(map(int, cell)) for cell in np.ndindex(36, 36, 1)]     # more than AHEAD
FAR = (500, 0, 0)


@contextmanager
def threads(number):
    """Set the number of threads, each worth one observation."""
    before, grain = jit.threads(), append.GRAIN
    try:
        jit.set_threads(number)
        append.GRAIN = 1
        yield
    finally:
        jit.set_threads(before)
        append.GRAIN = grain


def pools_of(memory):
    """Return the bytes of all pools as far as they are in use, or were."""
    used = memory.m.used
    sizes = used[[BLOCKS, VOXELS, LINKS, SPILLS, LINKS, BLOCKS, FREE, RETIRED]].tolist()
    return [pool[:size].tobytes() for pool, size in zip(memory.m, sizes + 3 * [None])]


def seen_by(rng, ids, hit):
    """Return what one frame sees of the plane, {voxel: (c, s)}, in any order."""
    here = rng.permutation(len(PLANE))[:int(hit * len(PLANE))]
    labels, shares = rng.choice(ids, len(here)), rng.choice(SHARES[len(EXACT):], len(here))
    return {PLANE[i]: (int(c), float(np.float32(s))) for i, c, s in zip(here, labels, shares)}


def assert_holds(memory, expected, bound):
    """Hold every tenth voxel and all counts of a memory against the reference's."""
    assert memory.n_voxels == len(expected.histories)
    columns = memory.voxels()
    assert columns['observations'].tolist() == [
        len(expected.histories[v]) for v in sorted(expected.histories)]
    for row, voxel in list(enumerate(sorted(expected.histories)))[::10]:
        h = expected.histories[voxel]
        assert [ref.Observation(int(c), float(s), int(t))
                for c, s, t in zip(*memory.history(voxel))] == h[-bound:]
        assert memory.evidence(voxel) == expected.evidence(voxel)       # bit for bit
        assert columns['majority'][row] == columns['label'][row] == expected.majority(voxel)
        assert columns['switches'][row] == sum(a.c != b.c for a, b in zip(h, h[1:]))


@pytest.mark.parametrize('bound', [0, 1, 7])
@given(seed=seeds, classes=st.sampled_from([2, 14]))
@examples(max_examples=5)
def test_many_observations_of_many_voxels(bound, seed, classes):
    rng = np.random.default_rng(seed)
    memory, expected = VoxelMemory(0.5, max_history=bound), ref.Memory()
    ids = rng.choice(65535, classes, replace=False).tolist()
    for stamp in range(18):
        seen = seen_by(rng, ids, rng.choice([0.02, 0.7, 1.0]))
        memory.add(observations(stamp, seen, unknown=[FAR, (0, 0, 1)]))
        expected.add(seen, stamp)
        if stamp == 9:      # what leaves begins anew
            keep_near(memory, (0.0, 0.0, 0.0), 12.0)
            here = set(map(tuple, memory.voxels()['voxel'].tolist()))
            assert 0 < len(here) < len(expected.histories)
            expected.histories = {v: h for v, h in expected.histories.items() if v in here}
    assert append.AHEAD < len(PLANE) and (memory.m.used[SPILLS] > 0) == (classes > 3)
    assert_holds(memory, expected, bound)


@pytest.mark.parametrize('bound', [0, 1, 5])
@given(seed=seeds)
@examples(max_examples=5)
def test_any_number_of_threads_leaves_the_same_pools(bound, seed):
    left = []
    for number in (1, 2, 3, 7):
        memory, rng = VoxelMemory(0.5, max_history=bound), np.random.default_rng(seed)
        with threads(number):
            for stamp in range(14):
                seen = seen_by(rng, range(9), rng.choice([0.0, 0.003, 0.4, 1.0]))
                memory.add(observations(stamp, seen, unknown=[FAR]))
                if stamp % 5 == 4:
                    keep_near(memory, rng.uniform(0.0, 18.0, 3) * (1, 1, 0), 10.0)
        left.append(pools_of(memory))
    assert all(one == left[0] for one in left)


@pytest.mark.parametrize('bound', [0, 1])
def test_evidence_spills_in_both_rounds_of_a_frame(bound):
    # The first voxel's seventh observation takes a link (with a bound it lets one go, too), the
    # second one's fourth has a place: both are of a class more than their records hold.
    first, second, left = (0, 0, 0), (3, 0, 0), []
    for number in (1, 2, 3):
        memory, expected = VoxelMemory(0.5, max_history=bound), ref.Memory()
        for stamp in range(CHUNK + 1):
            seen = {first: (stamp % 3 if stamp < CHUNK else 9, 1.0)}
            if stamp > 2:
                seen[second] = stamp + 10, 1.0
            assert memory.m.used[SPILLS] == 0
            with threads(number):
                memory.add(observations(stamp, seen))
            expected.add(seen, stamp)
        assert memory.m.used[SPILLS] == 2
        for voxel in first, second:
            assert memory.evidence(voxel) == expected.evidence(voxel)
        left.append(pools_of(memory))
    assert all(one == left[0] for one in left)


def test_a_voxel_without_a_history_lets_nothing_go():
    memory = VoxelMemory(0.5, max_history=1)
    for stamp in range(4 * CHUNK + 2):
        memory.add(observations(stamp, {(0, 0, 0): (3, 1.0)}))
    none = {name: getattr(dump(memory), name)[:0] for name in (
        'history_label', 'history_confidence', 'history_frame', 'history_offset')}
    bare = load(replace(dump(memory), history_start=np.zeros(2, np.int64), **none))
    bare.add(observations(99, {(0, 0, 0): (4, 0.5)}))
    assert bare.m.used[RETIRED] == 0 and bare.m.used[STORED] == 1
    assert [column.tolist() for column in bare.history((0, 0, 0))[:2]] == [[4], [0.5]]
