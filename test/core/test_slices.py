"""What is spread over frames: the copy for a save, a growing hash table, letting go."""

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory import growth
from persem_ros.core.memory.capture import Capture, dump
from persem_ros.core.memory.evict import drop, keep_near
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Refine
from test_dump import parts


def patch(rng, stamp, n=40, spread=40):
    """Return Observations of n voxels here and there."""
    return cw.observations(stamp, {
        tuple(v): (int(rng.choice(cw.IDS)), float(rng.choice(cw.EXACT)))
        for v in rng.integers(-spread, spread, (n, 3)).tolist()})


@given(cw.seeds, st.integers(1, 60), st.sampled_from([0, 3]))
@cw.examples(max_examples=25)
def test_a_copy_in_slices_is_the_map_of_one_moment(seed, slice_, bound):
    rng, memory = np.random.default_rng(seed), VoxelMemory(0.5, max_history=bound)
    for stamp in range(6):
        memory.add(patch(rng, stamp))
    job, capture, stamp = None, Capture(memory), 10
    while not capture.step(slice_ + 5 * (stamp - 10) if slice_ < 50 else None):
        memory.add(patch(rng, stamp, 5))
        stamp += 1
        if job is None:
            job = begin_next(memory, Refine())
        elif rng.random() < 0.5:
            finish(job, *job.compute())
            job = None
    moment = parts(dump(memory))
    for later in range(5):      # histories go on while they are read
        memory.add(patch(rng, 1000 + later))
        refine(memory, Refine())
    assert keep_near(memory, (0, 0, 0), 1.0) == 0       # nothing leaves meanwhile
    assert parts(capture.dump()) == moment
    assert not memory.captures


def test_a_copy_of_what_changed_holds_that_alone():
    memory = cw.core_of([(0, {(8 * x, 0, 0): (1, 1.0) for x in range(9)}, ())])
    refine(memory, Refine())
    first = Capture(memory)
    assert first.step()
    assert len(first.dump().block_index) == 9
    memory.add(cw.observations(1, {(16, 0, 0): (1, 1.0)}))
    second = Capture(memory, first.moment)
    assert second.step()
    saved = second.dump()
    assert saved.block_index[:, 0].tolist() == [2] and saved.observations.tolist() == [2]
    third = Capture(memory, second.moment)
    assert third.step()
    assert len(third.dump().cell) == 0
    refine(memory, Refine())        # it has been handed the change: its mark is another
    fourth = Capture(memory, second.moment)
    assert fourth.step()
    saved = fourth.dump()
    assert saved.block_index[:, 0].tolist() == [2] and saved.dirty.tolist() == [0]


def test_a_hash_table_grows_over_several_frames(monkeypatch):
    monkeypatch.setattr(growth, 'PART', 7)
    monkeypatch.setattr(growth.Growth.step, '__defaults__', (7,))
    memory, seen, tables, growing = VoxelMemory(0.5), [], set(), 0
    for stamp in range(60):
        fresh = [(8 * stamp, 8 * k, 0) for k in range(20)]
        memory.add(cw.observations(stamp, {v: (1, 1.0) for v in fresh}))
        seen += fresh
        if stamp == 25:         # begins anew
            drop(memory, memory.find(seen[:10]))        # a voxel a block: their numbers agree
            seen = seen[10:]
        assert (memory.find(seen) >= 0).all()
        tables.add(len(memory.table))
        growing += memory.growth is not None
    assert len(tables) > 2 and growing > 20
    assert memory.n_voxels == len(seen)


def test_the_farthest_go_first_and_only_so_many():
    memory = cw.core_of([(0, {(8 * x, 0, 0): (1, 1.0) for x in range(20)}, ())])
    assert keep_near(memory, (0, 0, 0), radius=20.0, at_once=6) == 6
    assert memory.voxels()['voxel'][:, 0].max() == 8 * 13
    assert keep_near(memory, (0, 0, 0), radius=20.0, at_once=60) == 9
    assert keep_near(memory, (0, 0, 0), radius=20.0, at_once=60) == 0
    assert memory.n_voxels == 5
