"""The memory against the reference: histories, evidence, counters, the table of frames."""

import mmap
from pathlib import Path
import resource
import subprocess
import sys

from core_worlds import (
    core_of, examples, IDS, observations, reference_of, seeds, worlds)
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.memory import append, pools
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
import pytest
import reference as ref

HERE = (-1, 7, 8)


def history(memory, voxel):
    """Return the core's history of a voxel as the reference's list."""
    return [ref.Observation(int(c), float(s), int(t)) for c, s, t in zip(*memory.history(voxel))]


def assert_same(memory, expected):
    """Hold a memory of the core against one of the reference."""
    assert memory.n_voxels == len(expected.histories)
    assert memory.n_observations == sum(map(len, expected.histories.values()))
    columns = memory.voxels()
    assert [tuple(v) for v in columns['voxel'].tolist()] == sorted(expected.histories)
    for row, voxel in enumerate(sorted(expected.histories)):
        h = expected.histories[voxel]
        evidence, majority = expected.evidence(voxel), expected.majority(voxel)
        assert history(memory, voxel) == h
        assert memory.evidence(voxel) == evidence               # the same sums, bit for bit
        assert columns['majority'][row] == columns['label'][row] == majority
        assert columns['source'][row] == 0
        assert columns['observations'][row] == len(h)
        assert columns['switches'][row] == sum(a.c != b.c for a, b in zip(h, h[1:]))
        assert columns['confidence'][row] == pytest.approx(
            expected.share(voxel)[majority], abs=1e-7)
    rho, wanted = memory.volatility(), expected.volatility()
    assert {int(c): rho[c] for c in np.flatnonzero(rho)} == {c: x for c, x in wanted.items() if x}


@given(worlds())
@examples(max_examples=150)
def test_random_worlds(frames):
    assert_same(core_of(frames), reference_of(frames))


@given(worlds(most_frames=40), st.integers(1, 20))
@examples(max_examples=60)
def test_a_bounded_history_keeps_the_newest_and_all_of_the_evidence(frames, bound):
    memory, expected = core_of(frames, max_history=bound), reference_of(frames)
    for voxel, h in expected.histories.items():
        assert history(memory, voxel) == h[-bound:]
        assert memory.evidence(voxel) == expected.evidence(voxel)
    rho, wanted = memory.volatility(), expected.volatility()
    assert {int(c): rho[c] for c in np.flatnonzero(rho)} == {c: x for c, x in wanted.items() if x}
    assert memory.voxels()['observations'].tolist() == [
        len(expected.histories[v]) for v in sorted(expected.histories)]


def test_a_bounded_history_does_not_grow():
    memory = VoxelMemory(0.5, max_history=16)
    sizes = []
    for stamp in range(2000):
        memory.add(observations(stamp, {(i, 0, 0): (stamp % 3, 1.0) for i in range(20)}))
        sizes.append(sum(n for what, n in memory.nbytes().items() if what != 'frames'))
    assert max(sizes[100:200]) == max(sizes[1900:])
    assert memory.n_observations == 40000


@given(st.lists(st.sampled_from([10, 20, 30, 40, 50]), min_size=1, max_size=12))
@examples(max_examples=60)
def test_t_counts_the_distinct_stamps_in_order_of_integration(stamps):
    memory, expected = VoxelMemory(0.5), ref.Memory()
    for stamp in stamps:
        memory.add(observations(stamp, {HERE: (1, 1.0)}))
        expected.add({HERE: (1, 1.0)}, stamp)
    assert [f.t for f in memory.frames] == [o.t for o in expected.histories[HERE]]
    assert history(memory, HERE) == expected.histories[HERE]


def test_the_frame_table_knows_when_by_what_and_from_where():
    memory = VoxelMemory(0.5)
    memory.add(observations(10, {HERE: (1, 1.0)}, sensor='front'))
    memory.add(observations(10, {}, sensor='down'))
    memory.new_session()
    memory.add(observations(10, {HERE: (1, 1.0)}, sensor='front'))
    assert [(f.t, f.session, f.sensor, f.stamp) for f in memory.frames] == [
        (0, 0, 'front', 10), (0, 0, 'down', 10), (1, 1, 'front', 10)]
    assert all(f.T_map_sensor.tolist() == np.eye(4).tolist() for f in memory.frames)
    assert [o.t for o in history(memory, HERE)] == [0, 1]


def test_a_frame_that_saw_nothing_counts_as_time():
    memory = VoxelMemory(0.5)
    for stamp, seen in [(1, {HERE: (1, 1.0)}), (2, {}), (3, {HERE: (1, 1.0)})]:
        memory.add(observations(stamp, seen))
    assert [o.t for o in history(memory, HERE)] == [0, 2]


def test_voxels_that_were_seen_and_not_observed_stay_unknown():
    memory = VoxelMemory(0.5)
    rows = memory.add(observations(1, {HERE: (1, 1.0)}, unknown=[(0, 0, 0), (1, 1, 1)]))
    assert rows.tolist() == [0, -1, -1] and memory.n_voxels == 1
    assert memory.find([(0, 0, 0), HERE, (1, 1, 1)]).tolist() == [-1, 0, -1]
    with pytest.raises(PersemError, match='0, 0, 0'):
        memory.history((0, 0, 0))


@given(seeds)
@examples(max_examples=5)
def test_many_blocks_are_found_again(seed):
    rng = np.random.default_rng(seed)
    voxels = np.unique(rng.integers(-4000, 4000, (20000, 3)), axis=0)
    voxels = voxels[rng.permutation(len(voxels))]
    memory = VoxelMemory(0.5)
    for stamp, part in enumerate(np.array_split(voxels, 7)):
        labels = [int(c) for c in rng.choice(IDS, len(part))]
        memory.add(observations(stamp, {tuple(v): (c, 1.0) for v, c in zip(part, labels)}))
    found = memory.find(voxels)
    assert sorted(found.tolist()) == list(range(len(voxels)))
    assert (memory.find(voxels + [0, 0, 9000]) == -1).all()
    assert (memory.voxels()['voxel'] == voxels[np.lexsort(voxels.T[::-1])]).all()


def test_voxels_at_the_ends_of_the_index_range():
    far = 2 ** 31 - 20
    seen = {(far, -far, 0): (3, 1.0), (-far, far, -far): (4, 0.5), (0, 0, far): (5, 0.5)}
    memory = core_of([(1, seen, ())])
    for voxel, (c, _) in seen.items():
        assert memory.find([voxel])[0] >= 0
        assert list(memory.evidence(voxel)) == [c]
    assert [tuple(v) for v in memory.voxels()['voxel'].tolist()] == sorted(seen)


def test_all_the_ids_that_there_are_in_one_voxel():
    rng = np.random.default_rng(0)
    order = [int(c) for c in rng.permutation(65535)[:3000]] + [0, 65534, 0]
    memory = VoxelMemory(0.5)
    for stamp, c in enumerate(order):
        memory.add(observations(stamp, {HERE: (c, 0.5)}))
    evidence = memory.evidence(HERE)
    assert set(evidence) == set(order)
    assert sum(evidence.values()) == 0.5 * len(order)
    assert memory.voxels()['majority'].tolist() == [0]


@given(worlds())
@examples(max_examples=20)
def test_the_same_frames_give_the_same_bytes(frames):
    one, two = core_of(frames), core_of(frames)
    for name, column in one.voxels().items():
        assert column.tobytes() == two.voxels()[name].tobytes()
    for voxel in one.voxels()['voxel']:
        assert [a.tobytes() for a in one.history(voxel)] == [
            a.tobytes() for a in two.history(voxel)]


@given(worlds(most_frames=40), st.sampled_from([0, 3]), seeds)
@examples(max_examples=30)
def test_parts_side_by_side_leave_the_same_pools(frames, bound, seed):
    before, grain, left = jit.threads(), append.GRAIN, []
    try:
        for threads, append.GRAIN in ((1, 1), (2, 1), (7, 1), (2, 5)):
            jit.set_threads(threads)
            memory, rng = VoxelMemory(0.5, max_history=bound), np.random.default_rng(seed)
            for number, (stamp, seen, ids) in enumerate(frames):
                memory.add(observations(stamp, seen, ids, unknown=[(0, 0, 0)]))
                if number % 5 == 4:     # from then on some records are used again
                    keep_near(memory, rng.uniform(-2.0, 2.0, 3), 2.0)
            used = memory.m.used.tolist()
            left.append((used, *(pool[:4096].tobytes() for pool in memory.m)))
    finally:
        jit.set_threads(before)
        append.GRAIN = grain
    assert left[1:] == left[:1] * 3


@given(worlds())
@examples(max_examples=30)
def test_a_frame_at_once_equals_its_voxels_one_by_one(frames):
    batch, singles = core_of(frames), VoxelMemory(0.5)
    for stamp, seen, ids in frames:
        for voxel, one in seen.items():
            singles.add(observations(stamp, {voxel: one}, ids))
        if not seen:
            singles.add(observations(stamp, seen, ids))
    columns = batch.voxels()
    for name, column in columns.items():
        assert column.tobytes() == singles.voxels()[name].tobytes()
    assert batch.find(columns['voxel']).tolist() == [
        int(batch.find([voxel])[0]) for voxel in columns['voxel']] == columns['number'].tolist()
    assert batch.volatility().tobytes() == singles.volatility().tobytes()
    for voxel in columns['voxel']:
        assert [a.tobytes() for a in batch.history(voxel)] == [
            a.tobytes() for a in singles.history(voxel)]


@pytest.mark.parametrize('pool', ['blocks', 'voxels', 'links', 'spills'])
def test_a_full_map_refuses_a_frame_and_stays_whole(pool):
    memory = core_of([(1, {(i, 0, 0): (1, 1.0) for i in range(5)}, ())])
    before = {name: a.tobytes() for name, a in memory.voxels().items()}
    memory.store.capacity[pool] = 8
    with pytest.raises(PersemError, match='memory.voxel_size'):
        memory.add(observations(2, {(i, 50, 50): (1, 1.0) for i in range(9)}))
    assert {name: a.tobytes() for name, a in memory.voxels().items()} == before
    assert len(memory.frames) == 1


@pytest.mark.skipif(sys.platform != 'linux', reason='/proc')
def test_a_limit_on_address_space_makes_smaller_pools_and_leaves_room(monkeypatch):
    size = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    before, whole = resource.getrlimit(resource.RLIMIT_AS), pools.Store()
    unlimited = dict(whole.capacity)
    del whole
    resource.setrlimit(resource.RLIMIT_AS, (size + (3 << 30), before[1]))
    try:
        memory = VoxelMemory(0.5)
        memory.add(observations(1, {(i, 0, 0): (1, 1.0) for i in range(5)}))
        del memory
        store = pools.Store()
        room = mmap.mmap(-1, 1 << 30)       # for whatever else the process does
        room.close()
        monkeypatch.setattr(pools, 'LEAST', 1 << 40)
        with pytest.raises(PersemError, match=r'ulimit -v\) is too small; raise it'):
            pools.Store()
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    shares = [unlimited[name] / n for name, n in store.capacity.items()]
    assert min(shares) > 1 and max(shares) == pytest.approx(min(shares), rel=1e-3)


def test_memory_does_not_grow_with_the_range_of_ids():
    sizes = []
    for top in (16, 65535):
        rng = np.random.default_rng(1)
        ids = [int(c) for c in np.linspace(0, top - 1, 16)]
        memory = VoxelMemory(0.5)
        for stamp in range(30):
            memory.add(observations(stamp, {
                (i, j, 0): (ids[rng.integers(16)], 1.0) for i in range(20) for j in range(20)}))
        sizes.append(memory.nbytes())
    assert sizes[0] == sizes[1]


BUDGET = """
import resource, sys
import numpy as np
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.frame.observe import Observations

SIDE, FRAMES = 60, 14
grid = np.indices((SIDE, SIDE, SIDE)).reshape(3, -1).T.astype(np.int32, order='C')
rng = np.random.default_rng(0)
memory = VoxelMemory(0.5, max_history=0)

def frame(stamp):
    n = len(grid)
    labels = ((grid[:, 0] // 9 + (rng.random(n) < 0.1)) % 16).astype(np.uint16)
    return Observations(grid, labels, np.ones(n, np.float32), np.arange(n, dtype=np.int32),
                        np.unique(labels), stamp, np.eye(4), '')

memory.add(Observations(grid[:1], np.zeros(1, np.uint16), np.ones(1, np.float32),
                        np.zeros(1, np.int32), np.zeros(1, np.uint16), -1, np.eye(4), ''))
made = [frame(i) for i in range(FRAMES)]
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for one in made:
    memory.add(one)
grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
budget = 16 * memory.n_observations + 160 * memory.n_voxels
print(memory.n_voxels, memory.n_observations, grown, sum(memory.nbytes().values()), budget)
"""


def test_bytes_per_observation_and_voxel():
    # In a process of its own: the peak that the operating system saw, not only our own account.
    out = subprocess.run([sys.executable, '-c', BUDGET], check=True, capture_output=True,
                         text=True).stdout
    voxels, observed, grown, counted, budget = map(int, out.split())
    assert (voxels, observed) == (60 ** 3, 14 * 60 ** 3 + 1)
    assert counted <= budget
    assert grown <= budget + (8 << 20)      # and pages, and what the caller's rows took
