"""A memory that was dumped, loaded and continued equals one that never stopped."""

from dataclasses import fields, replace

from core_worlds import core_of, examples, observations, refinements, worlds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory import loading
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.regions import regions
from persem_ros.core.refine.turns import begin
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.settings.config import METHODS, Refine
import pytest


def content(memory):
    """Return everything that a memory answers, voxel by voxel."""
    columns = memory.voxels()
    numbers = columns.pop('number')
    codes, entropy, rate = (a[numbers].tobytes() for a in regions(memory))
    rows = [(memory.evidence(v), [a.tobytes() for a in (*memory.history(v), *memory.sightings(v))])
            for v in columns['voxel']]
    frames = [(f.t, f.session, f.sensor, f.stamp, f.T_map_sensor.tolist(), f.T_map_best.tolist())
              for f in memory.frames]
    frames.append([(n, s.uuid, {k: T.tolist() for k, T in s.mounts.items()})
                   for n, s in memory.frames.sessions.items()])
    records = memory.m.voxels[numbers]
    columns['first_label'], columns['gone'] = records['first_label'], records['gone']
    rho = None if memory.rho is None else memory.rho.tobytes()
    return ({k: a.tobytes() for k, a in columns.items()}, rows, frames, rho, codes, entropy, rate,
            memory.volatility().tobytes(), memory.n_observations, memory.voxel_size,
            memory.origin, memory.max_history, memory.session, memory.seen_ids.tobytes())


def parts(saved):
    """Return a dump's columns as bytes."""
    columns = {f.name: getattr(saved, f.name) for f in fields(saved) if f.name != 'frames'}
    columns |= columns.pop('habits')
    return {name: a.tobytes() if isinstance(a, np.ndarray) else a for name, a in columns.items()}


@given(worlds(most_frames=24), refinements(), st.sampled_from(METHODS),
       st.sampled_from([0, 1, 5, 8, 11]), st.integers(0, 24), st.booleans(), st.booleans())
@examples(max_examples=150)
def test_stopped_and_continued_equals_never_stopped(frames, settings, method, bound, cut,
                                                    refined, session):
    settings = replace(settings, method=method)
    straight = core_of(frames[:cut], bound)
    if refined:
        refine(straight, settings)
    saved = dump(straight)
    stopped = load(saved)
    assert content(stopped) == content(straight)
    assert parts(dump(stopped)) == parts(saved)
    for memory in (straight, stopped):
        if session:
            memory.new_session()
        for i, (stamp, seen, ids) in enumerate(frames[cut - 1 if cut else 0:]):
            memory.add(observations(stamp, seen, ids))
            if i % 3 == 0:
                refine(memory, settings, full=False)
    assert content(stopped) == content(straight)
    refine(straight, settings)
    refine(stopped, settings)
    assert content(stopped) == content(straight)


def test_a_class_that_only_evidence_remembers_is_not_new_after_loading():
    memory = core_of([(1, {(0, 0, 0): (8, 1.0)}, []), (2, {(0, 0, 0): (5, 1.0)}, [])], 1)
    again = load(dump(memory))
    assert again.history((0, 0, 0))[0].tolist() == [5]
    assert again.voted_ids.nonzero()[0].tolist() == [5, 8]
    assert again.voted_ids.tobytes() == memory.voted_ids.tobytes()


def test_a_dump_is_a_copy():
    memory = core_of([(1, {(0, 0, 0): (3, 1.0)}, ())])
    saved = dump(memory)
    before = parts(saved)
    memory.add(observations(2, {(0, 0, 0): (4, 1.0), (0, 0, 1): (4, 1.0)}))
    refine(memory, replace(Refine(), min_observations=1))
    assert parts(saved) == before and len(saved.frames) == 1
    loaded = load(saved)
    loaded.add(observations(2, {(0, 0, 0): (4, 1.0)}))
    assert parts(saved) == before and len(saved.frames) == 1


def test_a_map_saved_during_a_refinement_is_refined_when_it_comes_back():
    frames = [(t, {(0, 0, 0): (1 if t % 2 else 2, 0.5 if t % 2 else 0.4), (1, 0, 0): (2, 1.0)},
               ()) for t in range(6)]
    memory = core_of(frames)
    refine(memory, Refine())
    memory.add(observations(9, frames[0][1]))
    job = begin(memory, Refine(), full=False)
    loaded = load(dump(memory))         # what the job will find is not in it
    finish(job, *job.compute())
    for other in (memory, loaded):
        refine(other, Refine(), full=False)
    assert content(loaded) == content(memory)


def test_an_empty_memory():
    loaded = load(dump(VoxelMemory(0.25, origin=(1.0, 2.0, 3.0), max_history=7)))
    assert content(loaded) == content(VoxelMemory(0.25, (1.0, 2.0, 3.0), 7))


def test_a_map_needs_room_for_each_of_its_parts_alone(monkeypatch):
    """Blocks are a hundred times as large as voxels: there is room for fewer of them."""
    saved = dump(core_of([(k, {(x, y, 0): (k, 1.0) for x in range(16) for y in range(8)}, ())
                          for k in range(9)]))
    room = {'blocks': 2, 'voxels': 128, 'links': 512, 'spills': 256}
    monkeypatch.setattr(loading, 'VoxelMemory', lambda *arguments: small(*arguments, **room))
    assert load(saved).n_voxels == 128
    for name in room:
        less = {**room, name: room[name] // 2 - 1 if name != 'spills' else 255}
        monkeypatch.setattr(loading, 'VoxelMemory', lambda *arguments: small(*arguments, **less))
        with pytest.raises(PersemError, match='the map is full'):
            load(saved)


def small(*arguments, **capacity):
    """Return a memory with little room."""
    memory = VoxelMemory(*arguments)
    memory.store.capacity = capacity
    return memory


def test_blocks_and_voxels_are_dumped_in_order_whatever_the_order_of_arrival():
    rng = np.random.default_rng(0)
    voxels = [tuple(int(x) for x in v) for v in rng.integers(-30, 30, (500, 3))]
    one = core_of([(1, {v: (1, 1.0) for v in voxels}, ())])
    two = core_of([(1, {v: (1, 1.0) for v in reversed(voxels)}, ())])
    assert parts(dump(one)) == parts(dump(two))
    saved = dump(one)
    assert [tuple(b) for b in saved.block_index.tolist()] == sorted(
        {tuple(x >> 3 for x in v) for v in voxels})
    for b in range(len(saved.block_index)):
        cells = saved.cell[saved.block_start[b]:saved.block_start[b + 1]]
        assert (np.diff(cells.astype(int)) > 0).all()
