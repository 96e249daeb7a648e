"""Voxels through which later frames look: counted, gone, back again (spec section 10)."""

from dataclasses import replace

from core_worlds import examples, observations, pose, seeds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.frame.clear import clear
from persem_ros.core.frame.render import voxel_image
from persem_ros.core.frame.view import warp_of
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.changes import Changes
from persem_ros.core.memory.evict import drop
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.explain import explain
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.regions import regions
from persem_ros.core.refine.turns import begin
from persem_ros.core.refine.whole import refine
from persem_ros.frames import Camera, Frame, pinhole
from persem_ros.settings.config import Memory, Refine
import pytest
import reference as ref

SECOND = 10 ** 9


@st.composite
def looks(draw):
    """Draw (voxel size, origin, settings, frames); a frame: its pose, stamp, depth and voxels."""
    rng = np.random.default_rng(draw(seeds))
    size, origin = float(rng.uniform(0.1, 1.0)), tuple(rng.normal(size=3).tolist())
    settings = Memory(voxel_size=size, min_depth=float(rng.choice([0.0, 0.5])),
                      clear_after=int(rng.integers(1, 4)), clear_margin=float(rng.uniform(0, 3)),
                      clear_slope=float(rng.choice([0.0, 0.05])),
                      clear_range=float(rng.choice([5.0, 30.0])))
    w, h = int(rng.integers(1, 24)), int(rng.integers(1, 24))
    camera = pinhole(w, h, *rng.uniform(0.5, 1.5, 2) * w, (w - 1) / 2, (h - 1) / 2)
    eye, frames, stamp = pose(rng), [], int(rng.integers(0, 2 ** 40))
    for _ in range(draw(st.integers(1, 8))):
        stamp += int(rng.integers(1, 2 * SECOND))
        T = eye.copy()
        T[:3, 3] += rng.normal(scale=0.3, size=3)
        depth = rng.choice([1.0, 4.0, 9.0, 40.0]) + rng.uniform(0, 3) * rng.random((h, w))
        holes = rng.random((h, w)) < rng.choice([0.0, 0.3, 0.6])
        depth[holes] = rng.choice([np.nan, np.inf, 0.0, 0.2])
        ahead = np.array([*rng.uniform(-0.6, 0.6, (30, 2)).T, np.ones(30)]).T \
            * rng.uniform(0.5, 12.0, (30, 1))
        places = (ahead @ T[:3, :3].T + T[:3, 3] - origin) / size
        seen = {tuple(v): (1 + i % 3, 1.0)
                for i, v in enumerate(np.floor(places).astype(int).tolist())}
        frames.append((T, stamp, depth, seen if rng.random() < 0.6 else {}))
    return size, origin, settings, camera, frames


@given(looks())
@examples(max_examples=120)
def test_what_is_looked_through_and_what_is_gone(drawn):
    size, origin, settings, camera, frames = drawn
    memory, plain, counts = VoxelMemory(size, origin), ref.Clearing(settings.clear_after), {}
    for T, stamp, depth, seen in frames:
        memory.add(observations(stamp, seen))
        for voxel in seen:
            counts[voxel] = counts.get(voxel, 0) + 1
        before = set(plain.gone) - set(seen)
        frame = Frame(stamp, np.zeros(depth.shape, np.int32), depth, camera, T)
        went = clear(memory, frame, settings)
        plain.frame(seen, counts, stamp, lambda voxel: ref.seen_through(
            depth.tolist(), camera.K.tolist(), T.tolist(), voxel, size, origin,
            settings.min_depth, settings.clear_margin, settings.clear_slope,
            settings.clear_range))
        assert went == len(plain.gone - before)
    saved = dump(memory)
    voxels = [tuple(v) for v in saved.voxels().tolist()]
    assert {v for v, gone in zip(voxels, saved.gone) if gone} == plain.gone
    assert {v: (n, at) for v, n, at in zip(
        voxels, saved.passed.tolist(), saved.passed_at.tolist()) if n} == plain.looks
    again = dump(load(saved))
    for name in ('gone', 'passed', 'passed_at'):
        assert (getattr(again, name) == getattr(saved, name)).all()


CAMERA = pinhole(40, 30, 40.0, 40.0, 19.5, 14.5)
EAGER = Memory(voxel_size=0.5, clear_after=2, clear_range=100.0)


def look(memory, stamp, depth, settings=EAGER):
    """Have the memory see a wall at a depth, from the origin along z."""
    image = np.full((30, 40), float(depth))
    return clear(memory, Frame(stamp, np.zeros(image.shape, np.int32), image, CAMERA), settings)


def scene(times=1):
    """Return a memory of two voxels 4 m ahead and their neighbours' wall, 20 m ahead."""
    memory = VoxelMemory(0.5)
    for t in range(times):
        seen = {(0, 0, 8): (7, 1.0), (1, 0, 8): (7, 1.0)}
        seen |= {(x, y, 40): (3, 1.0) for x in range(-2, 3) for y in range(-2, 3)}
        memory.add(observations(t, seen))
    return memory


def seen_voxels(memory):
    """Return the set of voxels that a map shows."""
    return set(map(tuple, memory.voxels()['voxel'].tolist()))


def test_one_look_a_second_counts_and_an_observation_brings_it_back():
    memory = scene()
    assert look(memory, 10 * SECOND, 20.4) == 0
    assert look(memory, 10 * SECOND + 999_999_999, 20.4) == 0       # the same second
    assert (0, 0, 8) in seen_voxels(memory)
    memory.add(observations(11 * SECOND, {(1, 0, 8): (7, 1.0)}))    # begins anew
    assert look(memory, 11 * SECOND, 20.4) == 1
    assert seen_voxels(memory) == seen_voxels(scene()) - {(0, 0, 8)}
    assert look(memory, 12 * SECOND, 20.4) == 1
    memory.add(observations(13 * SECOND, {(0, 0, 8): (7, 1.0)}))
    assert (0, 0, 8) in seen_voxels(memory) and (1, 0, 8) not in seen_voxels(memory)
    assert len(memory.history((0, 0, 8))[0]) == 2
    assert look(memory, 13 * SECOND, 20.4) == 0     # what was counted before does not


def test_what_was_seen_often_goes_late():
    memory = scene(times=50)
    went = [look(memory, k * SECOND, 20.4) for k in range(1, 6)]
    assert went == [0, 0, 0, 0, 2]          # a tenth of 50


@pytest.mark.parametrize('depth, margin, slope, far, gone', [
    (5.26, 1.5, 0.0, 100.0, True),          # 4.5 + 0.75 is the bound
    (5.24, 1.5, 0.0, 100.0, False),
    (5.4, 1.5, 0.05, 100.0, False),         # 4.5 * 0.05 more
    (20.4, 1.5, 0.02, 4.4, False),          # farther than clear_range
    (np.inf, 0.0, 0.0, 100.0, False),       # no measurement
    (3.0, 0.0, 0.0, 100.0, False)])         # hidden
def test_margins(depth, margin, slope, far, gone):
    settings = replace(EAGER, clear_after=1, clear_margin=margin, clear_slope=slope,
                       clear_range=far)
    assert look(scene(), SECOND, depth, settings) == 2 * gone


def test_nothing_is_cleared_unasked_nor_by_a_cloud():
    memory = scene()
    assert look(memory, SECOND, 20.4, replace(EAGER, clear_after=0)) == 0
    cloud = Frame(SECOND, np.zeros((1, 2), np.int32), np.full((1, 2), 20.0), CAMERA,
                  points=np.zeros((1, 2, 3)))
    assert clear(memory, cloud, replace(EAGER, clear_after=1)) == 0
    assert not dump(memory).passed.any()


def gone_scene():
    """Return scene() with one of the two voxels gone, seen three times, and not refined yet."""
    memory = scene(times=3)
    for k in (1, 2):
        look(memory, k * SECOND, 20.4)
    memory.add(observations(3 * SECOND, {(1, 0, 8): (7, 1.0)}))
    return memory


@pytest.mark.parametrize('full', [True, False])
def test_who_is_gone_is_no_neighbour_and_not_rendered(full):
    memory = gone_scene()
    refine(memory, Refine(), full)
    trace = explain(memory, (1, 0, 8), Refine())
    assert trace['neighbours'] == 0 and trace['label'] == trace['stored_label']
    number = memory.find([[0, 0, 8], [1, 0, 8]])
    assert not regions(memory)[0][number].any()
    shown = voxel_image(memory, observations(9, {(0, 0, 8): (7, 1.0), (1, 0, 8): (7, 1.0)}),
                        (1, 2))
    assert shown.tolist() == [[-1, number[1]]]


@pytest.mark.parametrize('method', ['persem', 'geometry'])
def test_an_increment_equals_a_visit_of_everything_when_something_went(method):
    settings = replace(Refine(), method=method, min_observations=1)
    memory = scene(times=3)
    refine(memory, settings)
    for k in (1, 2):
        look(memory, k * SECOND, 20.4)
    refine(memory, settings, full=False)
    straight = load(dump(memory))       # with the same volatility and parameters
    refine(straight, settings, full=False)
    mine, theirs = memory.voxels(), straight.voxels()
    assert all((mine[name] == theirs[name]).all() for name in mine if name != 'number')


def test_a_refinement_under_way_leaves_alone_what_went_meanwhile():
    memory = scene(times=3)
    memory.add(observations(4, {(0, 0, 8): (5, 1.0)}))
    job = begin(memory, replace(Refine(), method='recency', lambda_recency=50.0))
    result = job.compute()
    for k in (1, 2):
        look(memory, k * SECOND, 20.4)
    finish(job, *result)
    record = memory.m.voxels[memory.find([[0, 0, 8]])[0]]
    assert record['gone'] and record['label'] == record['majority'] == 7 and not record['source']


def test_viewers_are_told():
    memory, changes = scene(), Changes()
    assert changes.take(memory).counts.sum() == 27
    look(memory, SECOND, 20.4)
    assert not len(changes.take(memory).counts)         # counting shows nothing
    look(memory, 2 * SECOND, 20.4)
    changed = changes.take(memory)
    assert len(changed.columns['voxel']) == changed.counts.sum() == 0 < len(changed.counts)
    memory.add(observations(3 * SECOND, {(1, 0, 8): (7, 1.0)}))
    assert changes.take(memory).columns['voxel'].tolist() == [[1, 0, 8]]


def test_a_block_that_left_takes_its_counts_along():
    memory = scene()
    look(memory, SECOND, 20.4)
    drop(memory, np.flatnonzero(memory.m.blocks['near'][:memory.n_blocks, 13]))
    for stamp in (2, 3):        # the same records, as often observed
        memory.add(observations(stamp, {(x, 0, 100): (7, 1.0) for x in range(27)}))
    assert not dump(memory).passed.any()


def test_a_distorted_image_is_looked_at_where_it_shows_the_voxel():
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    x, y = (u - 19.5) / 40.0, (v - 14.5) / 40.0
    bent = 1.0 + 0.15 * (x * x + y * y)
    camera = Camera(np.stack([x * bent, y * bent], axis=-1), CAMERA.K)
    warp = warp_of(camera)
    assert warp_of(CAMERA).size == 0 and warp.shape == (30, 40, 2)
    at = camera.rays[5, 8] * 40.0 + (19.5, 14.5)        # where a pinhole would see pixel (8, 5)
    near = np.rint(at).astype(int)
    moved = warp[near[1], near[0]] + (at - near)
    assert np.abs(moved - (8, 5)).max() < 0.2 < np.abs(at - (8, 5)).max()
    memory = VoxelMemory(0.5)
    memory.add(observations(0, {(0, 0, 8): (7, 1.0), (2, 1, 8): (7, 1.0)}))
    frame = Frame(SECOND, np.zeros((30, 40), np.int32), np.full((30, 40), 20.0), camera)
    assert clear(memory, frame, replace(EAGER, clear_after=1)) == 2
