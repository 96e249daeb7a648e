"""Maps fitted in steps beside the mapping: at rest the same bits as all at once (section 12.5)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

from core_worlds import examples
import geometry_reference as plain
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.geometry.ground import NONE
from persem_ros.core.geometry.relief import Relief
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.pools import CLOCK
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine import sweep
from persem_ros.core.refine.job import abandon, finish
from persem_ros.core.refine.rules import at_rest, swept
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Geometry
import pytest
from test_geometry import (
    advance, assert_alike, assert_as_whole, big_flight, flights, GEOMETRY, histories_of,
    memory_frame, memory_of, narrow_flight, ORIGIN, refine_everywhere, SETTINGS, SIZE, UPS)


def come_to_rest(memory, settings):
    """Refine until nothing is left to do."""
    for _ in range(2000):
        advance(memory, settings)
        if at_rest(memory, settings):
            return
    raise AssertionError('it goes on for ever')


def assert_refreshed(memory, settings):
    """Hold a map that ~/refine has gone over against one that was refined at once."""
    refine_everywhere(memory, settings)
    straight = load(dump(memory))
    refine(straight, settings)
    ours, theirs = memory.voxels(), straight.voxels()
    for name in ('voxel', 'label', 'source', 'confidence'):
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    if memory.n_voxels and memory.geometry is not None:
        for name in ('classes', 'pi', 'theta'):
            assert getattr(memory.geometry, name).tobytes() == \
                getattr(straight.geometry, name).tobytes()
    assert at_rest(memory, settings) and advance(memory, settings) == 0


def let_move_away(memory, rng):
    """Have some voxels look as if their content had moved away, or come back."""
    some = rng.random(memory.n_voxels) < 0.2
    block, cell, number = (column[some] for column in memory.listing())
    memory.m.voxels['gone'][number] ^= 1
    memory.n_gone += len(number)
    np.bitwise_or.at(memory.m.blocks['changed'], (block, cell >> 3),
                     (1 << (cell & 7)).astype(np.uint8))
    memory.m.used[CLOCK] += 1
    memory.m.stamps['evidence'][block] = memory.m.stamps['stored'][block] = memory.clock


def live(frames, settings, bound, rng, changes=()):
    """
    Return the memory of frames between which refinements begin and end at random.

    What a refinement does beside the mapping it does before, between or after frames that come
    meanwhile, sometimes afresh. *changes* are called between refinements.

    """
    memory, job, result = memory_of([], bound), None, None
    for frame in frames:
        memory.add(memory_frame(*frame))
        for _ in range(int(rng.integers(0, 6))):
            if job is None:
                for change in changes:
                    if rng.random() < 0.1:
                        change(memory, rng)
                job = begin_next(memory, settings, fresh=rng.random() < 0.05)
            if result is None and rng.random() < 0.7:
                result = job.compute()
            if result is not None and rng.random() < 0.7:
                if rng.random() < 0.03:
                    abandon(job)
                else:
                    finish(job, *result)
                job = result = None
    if job is not None:
        finish(job, *(result or job.compute()))
    return memory


@pytest.fixture(params=[0, sweep.AT_ONCE], ids=['sorted beside', 'sorted at once'])
def at_once(request, monkeypatch):
    """Let blocks be sorted by the job, or where it begins."""
    monkeypatch.setattr(sweep, 'AT_ONCE', request.param)


seeds = st.integers(0, 2 ** 32 - 1)


@pytest.mark.usefixtures('at_once')
@given(flights(), SETTINGS, UPS, st.sampled_from([0, 0, 2]), st.integers(1, 40), seeds)
@examples(max_examples=40)
def test_at_rest_all_is_as_if_refined_at_once(frames, constants, up, bound, slice_, seed):
    settings = replace(GEOMETRY, up=up, geometry=constants, sweep=slice_)
    memory = live(frames, settings, bound, np.random.default_rng(seed))
    if not memory.n_voxels:
        return
    come_to_rest(memory, settings)
    assert_as_whole(memory, settings)
    assert_refreshed(memory, settings)
    assert_alike(memory, plain.geometry(histories_of(frames), SIZE, ORIGIN, up, bound, constants))


def keep_some(memory, rng):
    """Let go of what is far from some voxel."""
    voxels = memory.voxels()['voxel']
    if len(voxels):
        place = (voxels[rng.integers(len(voxels))] + 0.5) * SIZE + np.array(ORIGIN)
        keep_near(memory, place.tolist(), radius=float(rng.choice([3.0, 6.0, 12.0])))


@given(flights(), SETTINGS, UPS, st.integers(1, 40), seeds)
@examples(max_examples=40)
def test_also_where_blocks_leave_and_contents_move_away(frames, constants, up, slice_, seed):
    settings = replace(GEOMETRY, up=up, geometry=constants, sweep=slice_)
    memory = live(frames * 2, settings, 0, np.random.default_rng(seed),
                  [keep_some, let_move_away])
    if (memory.m.voxels['gone'][memory.listing()[2]] == 0).any():
        come_to_rest(memory, settings)
        assert_as_whole(memory, settings)
        assert_refreshed(memory, settings)


def heights(ground):
    """Return the lowest voxels and the level of the tiles over which there is any."""
    return {tuple(tile): (lowest, level) for tile, lowest, level in zip(
        ground.tiles.tolist(), ground.lowest.tolist(), ground.level.tolist())
        if min(lowest) != NONE}


def assert_relief_is_todays(memory):
    """Hold the relief that is kept against one made anew."""
    relief, anew = memory.relief, Relief(memory, memory.relief.up, memory.relief.window)
    anew.update(memory)
    assert (relief.bits[:memory.n_blocks] == anew.bits[:memory.n_blocks]).all()
    assert heights(relief.ground) == heights(anew.ground)


@pytest.mark.parametrize('early', [False, True])
def test_what_comes_while_the_relief_is_made_is_taken_in(early):
    settings, memory = replace(GEOMETRY, sweep=300), memory_of(big_flight(3, 30))
    job = begin_next(memory, settings)
    early = early and job.compute()
    memory.add(memory_frame(99, {(0, 0, 3): (1, 1.0), (90, 9, -9): (2, 1.0)}, (0.0, 0.0, 9.0)))
    finish(job, *(early or job.compute()))
    while not swept(memory, settings):
        advance(memory, settings)
    assert_as_whole(memory, settings)
    assert_relief_is_todays(memory)
    assert not at_rest(memory, settings)        # the parameters have yet to hear of it


@pytest.mark.parametrize('up', ['z', '-y'])
def test_a_relief_that_lost_cells_is_that_of_what_is_left(up):
    settings = replace(GEOMETRY, up=up, geometry=Geometry(window=9, cell=16))
    memory, rng = memory_of(narrow_flight()), np.random.default_rng(3)
    refine(memory, settings)
    for change in (keep_some, let_move_away, keep_some, let_move_away):
        change(memory, rng)
        refine(memory, settings, full=False)
        assert_as_whole(memory, settings)
        assert_relief_is_todays(memory)


def test_a_step_looks_at_no_more_than_a_slice():
    memory, sizes = memory_of(big_flight(3, 40)), []
    settings = replace(GEOMETRY, sweep=300)
    while not swept(memory, settings):
        job = begin_next(memory, settings)
        sizes.append(job.snapshot.refined)
        finish(job, *job.compute())
    most = int(memory.m.blocks['count'][:memory.n_blocks].max())
    assert 0 < max(sizes) < 300 + most and sum(sizes) == memory.n_voxels
    assert sizes[:5] == [0] * 5         # of which the map has more than four slices


def test_parameters_stay_until_others_are_there_and_a_class_that_comes_begins_anew():
    settings, frames = replace(GEOMETRY, sweep=300), big_flight(3, 40, n_frames=4)
    memory = memory_of(frames)
    refine(memory, settings)
    first = memory.geometry
    advance(memory, settings, fresh=True)
    memory.add(memory_frame(9, {(0, 0, -4): (77, 1.0), (1, 1, -4): (77, 1.0)}, (0.0, 0.0, 9.0)))
    surveys = [memory.survey]
    while not swept(memory, settings):
        assert memory.geometry is first or memory.survey is None
        advance(memory, settings)
        if memory.survey not in (None, surveys[-1]):
            surveys.append(memory.survey)
    assert len(surveys) == 2 and 77 in memory.geometry.classes
    come_to_rest(memory, settings)
    assert_as_whole(memory, settings)


def test_a_sweep_that_finds_none_of_the_classes_that_are_known_keeps_the_parameters():
    def seen(c, stamp):
        return memory_frame(stamp, {(0, 0, 0): (c, 1.0)}, (0.0, 0.0, 9.0))
    memory = VoxelMemory(SIZE, ORIGIN, max_history=2)
    for stamp, c in enumerate([1, 2, 2]):       # class 1 is read no more when they are fitted
        memory.add(seen(c, stamp))
    come_to_rest(memory, GEOMETRY)
    known = memory.geometry.pi
    for stamp in (3, 4, 5):
        memory.add(seen(1, stamp))
        come_to_rest(memory, GEOMETRY)
    assert memory.geometry.pi.tolist() == known.tolist()
    assert_as_whole(memory, GEOMETRY)
    assert_refreshed(memory, GEOMETRY)


def test_a_survey_that_another_method_ends_leaves_nothing_out():
    settings, memory = replace(GEOMETRY, sweep=300), memory_of(big_flight(3, 40, n_frames=4))
    other = replace(settings, method='majority')
    come_to_rest(memory, other)
    while memory.survey is None or len(memory.changed_blocks()):    # until it has begun to fit
        advance(memory, settings)
    memory.add(memory_frame(9, {(0, 0, -4): (1, 1.0)}, (0.0, 0.0, 9.0)))
    come_to_rest(memory, other)
    assert not memory.voxels()['source'].any()
    assert not memory.m.blocks['changed'][:memory.n_blocks].any()
    come_to_rest(memory, settings)
    assert_as_whole(memory, settings)


def test_frames_that_come_while_threads_compute():
    settings = replace(GEOMETRY, sweep=400, geometry=Geometry(window=9, cell=16))
    frames, memory = narrow_flight(14), memory_of([])
    with ThreadPoolExecutor(1) as beside:
        for before, frame in pairwise(frames):
            memory.add(memory_frame(*before))
            for again in range(4):
                job = begin_next(memory, settings, fresh=again == 0 and frame[0] % 4 == 0)
                result = beside.submit(job.compute)
                memory.add(memory_frame(1000 * frame[0] + again, *frame[1:]))
                finish(job, *result.result())
    come_to_rest(memory, settings)
    assert_as_whole(memory, settings)
    assert_refreshed(memory, settings)
