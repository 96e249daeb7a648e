"""Refinements a slice at a time: the sweep, stamps of blocks, blocks that leave the hash table."""

from dataclasses import replace

from core_worlds import columns_of, core_of, examples, observations, refinements, seeds, worlds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import drop
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine import sweep
from persem_ros.core.refine.job import abandon, finish
from persem_ros.core.refine.labelled import LOCAL
from persem_ros.core.refine.rules import at_rest, swept
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Refine
import pytest


def step(memory, settings, fresh=False):
    """Run the refinement that is next in turn; return how many voxels it visited."""
    job = begin_next(memory, settings, fresh)
    return finish(job, *job.compute())


@pytest.fixture(params=[0, sweep.AT_ONCE], ids=['sorted beside', 'sorted at once'])
def at_once(request, monkeypatch):
    """Let blocks be sorted by the job, or where it begins."""
    monkeypatch.setattr(sweep, 'AT_ONCE', request.param)


@pytest.mark.usefixtures('at_once')
@given(worlds(most_frames=20), refinements(), st.sampled_from(sorted(LOCAL)), st.integers(1, 9),
       st.integers(1, 6))
@examples(max_examples=15)
def test_a_sweep_that_has_ended_equals_a_full_run(frames, settings, method, slice_, every):
    settings = replace(settings, method=method, sweep=slice_, volatility_every=every)
    memory = core_of([])
    for k, frame in enumerate(frames):
        memory.add(observations(*frame))
        if k % 2:
            step(memory, settings)
    step(memory, settings)
    for _ in range(200):
        if swept(memory, settings):
            break
        step(memory, settings)
    assert swept(memory, settings)
    straight = core_of(frames)
    straight.rho = memory.rho
    refine(straight, settings, full=False)      # all is changed there, so all is visited
    assert columns_of(memory) == columns_of(straight)


def row_of_blocks(n):
    """Return a memory of n blocks in a row, one voxel each."""
    return core_of([(t, {(8 * x, 0, 0): (1, 1.0) for x in range(n)}, ()) for t in range(3)])


@pytest.mark.usefixtures('at_once')
def test_a_new_volatility_waits_for_the_end_of_the_sweep():
    memory, settings = row_of_blocks(10), replace(Refine(), sweep=2, volatility_every=3)
    rho, taken = None, []
    for k in range(20):
        job = begin_next(memory, settings)
        if job.rho is not rho:
            rho = job.rho
            taken.append(k)
        finish(job, *job.compute())
    later = sweep.AT_ONCE == 0      # the first has changes to visit and no order yet
    assert taken == ([0, 6, 12, 18] if later else [0, 5, 10, 15])


def test_a_slice_is_the_next_blocks_in_ascending_index():
    memory, settings = row_of_blocks(10), replace(Refine(), sweep=3)
    refine(memory, settings)
    begun = begin_next(memory, settings, fresh=True)
    found = [begun.snapshot]
    finish(begun, *begun.compute())
    while not swept(memory, settings):
        job = begin_next(memory, settings)
        found.append(job.snapshot)
        finish(job, *job.compute())
    blocks = memory.m.blocks['index']
    assert [blocks[one.block[:one.refined], 0].tolist() for one in found] == [
        [0, 1, 2], [3, 4, 5], [6, 7, 8], [9]]


def test_other_settings_begin_the_sweep_anew_and_keep_the_volatility():
    memory, settings = row_of_blocks(6), replace(Refine(), sweep=6)
    step(memory, settings)
    assert swept(memory, settings)
    other, rho = replace(settings, eta=0.9), memory.rho
    assert not swept(memory, other)
    assert step(memory, other) == 6 and swept(memory, other) and memory.rho is rho
    assert step(memory, other) == 0


def test_a_map_is_at_rest_when_all_have_seen_the_volatility_of_today():
    memory, settings = row_of_blocks(6), replace(Refine(), sweep=4, volatility_every=3)
    rests = []
    for k in range(8):
        step(memory, settings)
        rests.append(at_rest(memory, settings))
        if k == 2:
            memory.add(observations(99, {(0, 0, 0): (2, 1.0)}))
    assert rests == [False, True, True, False, True, True, False, True]     # each third anew
    memory.add(observations(100, {(0, 0, 0): (2, 1.0)}))
    assert not at_rest(memory, settings)


def test_a_job_that_was_given_up_is_swept_again():
    memory, settings = row_of_blocks(6), replace(Refine(), sweep=6)
    abandon(begin_next(memory, settings))
    assert not swept(memory, settings)
    assert step(memory, settings) == 6 and swept(memory, settings)


def test_a_map_that_comes_back_is_swept():
    memory, settings = row_of_blocks(6), replace(Refine(), sweep=4)
    refine(memory, settings)
    memory = load(dump(memory))
    assert step(memory, settings) == 4 and not swept(memory, settings)
    assert step(memory, settings) == 2 and swept(memory, settings)


def shown(memory, since):
    """Return the first coordinates of the blocks that a viewer has to look at again."""
    blocks = np.flatnonzero(memory.m.stamps['shown'][:memory.n_blocks] > since)
    return memory.m.blocks['index'][blocks, 0].tolist()


def test_stamps_tell_what_a_viewer_has_not_seen():
    memory, settings = row_of_blocks(5), replace(Refine(), min_observations=1, eta=1.0)
    assert shown(memory, 0) == [0, 1, 2, 3, 4]
    refine(memory, settings)
    now = memory.clock
    assert shown(memory, now) == []
    memory.add(observations(9, {(16, 0, 0): (2, 0.5), (17, 0, 0): (3, 1.0)}))
    assert shown(memory, now) == [2]
    now = memory.clock
    refine(memory, settings)                # the neighbour's label wins where eta is 1
    assert columns_of(memory)[16, 0, 0] == (3, 1) and shown(memory, now) == [2]
    now = memory.clock
    refine(memory, settings)                # nothing changes, so there is nothing to show
    assert shown(memory, now) == []


@given(seeds, st.integers(2, 400))
@examples(max_examples=10)
def test_blocks_that_leave_the_hash_table_leave_the_others_in_it(seed, n):
    rng, memory = np.random.default_rng(seed), VoxelMemory(0.5)
    known = set()
    for round_ in range(6):
        fresh = {tuple(8 * x for x in v) for v in rng.integers(-20, 20, (n, 3)).tolist()}
        memory.add(observations(round_, {v: (1, 1.0) for v in fresh}))
        known |= fresh
        listed = sorted(known)
        numbers = memory.find(listed)
        assert (numbers >= 0).all() and len(set(numbers.tolist())) == len(listed)
        gone = [v for v in listed if rng.random() < 0.4]
        index = [tuple(i) for i in memory.m.blocks['index'][:memory.n_blocks].tolist()]
        live = memory.m.blocks['near'][:memory.n_blocks, 13] > 0
        drop(memory, [b for b in range(memory.n_blocks)
                      if live[b] and tuple(8 * x for x in index[b]) in set(gone)])
        assert (memory.find(gone) == -1).all() if gone else True
        known -= set(gone)
    assert memory.n_voxels == len(known)
