"""Dropping far blocks: what stays is as if nothing had happened, what went can come back."""

from dataclasses import replace

from core_worlds import observations
import numpy as np
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import stored_observations, VoxelMemory
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.turns import begin
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Refine


def frame(rng, stamp, x0):
    """Return observations of a 30 x 30 patch that starts at x0, seven classes."""
    return observations(stamp, {
        (x0 + x, y, 0): (int(rng.integers(0, 7)), float(rng.choice([0.5, 0.75, 1.0])))
        for x in range(30) for y in range(30)}, ())


def columns(memory):
    """Return the map's columns without voxel numbers, and all histories."""
    map_ = memory.voxels()
    return ({k: v.tolist() for k, v in map_.items() if k != 'number'},
            [[a.tolist() for a in memory.history(v)] for v in map_['voxel'][::37]],
            [memory.evidence(v) for v in map_['voxel'][::37]])


def two_places(far=800):
    """Return a memory that saw a patch here and a patch far away, eight times each."""
    rng, memory = np.random.default_rng(3), VoxelMemory(0.5)
    for t in range(8):
        memory.add(frame(rng, 2 * t, 0))
        memory.add(frame(rng, 2 * t + 1, far))
    return memory


def test_what_stays_is_unchanged_and_what_went_is_gone():
    memory = two_places()
    here = [v for v in memory.voxels()['voxel'].tolist() if v[0] < 100]
    kept = {tuple(v): (memory.evidence(v), memory.history(v)[2].tolist()) for v in here}
    observed, rho = memory.n_observations, memory.volatility()
    assert keep_near(memory, (5.0, 5.0, 0.0), radius=50.0) == 900
    assert memory.voxels()['voxel'].tolist() == here and memory.n_voxels == 900
    assert {tuple(v): (memory.evidence(v), memory.history(v)[2].tolist()) for v in here} == kept
    assert memory.find([(800, 0, 0)]).tolist() == [-1]
    assert stored_observations(memory) == 8 * 900
    assert memory.n_observations == observed and (memory.volatility() == rho).all()
    assert keep_near(memory, (5.0, 5.0, 0.0), radius=50.0) == 0


def test_places_in_memory_are_used_again():
    memory, rng = two_places(), np.random.default_rng(4)
    sizes = memory.nbytes()
    for flight in range(5):
        keep_near(memory, (5.0, 5.0, 0.0), radius=50.0)
        for t in range(8):
            memory.add(frame(rng, 1000 + 10 * flight + t, 800 + 64 * flight))
    after = memory.nbytes()
    assert memory.n_voxels == 1800 and memory.n_numbers == 1800
    assert {k: after[k] for k in ('voxels', 'histories')} == {
        k: sizes[k] for k in ('voxels', 'histories')}
    fresh = load(dump(memory))
    assert columns(fresh) == columns(memory)
    for settings in (Refine(), replace(Refine(), neighbours=6)):
        refine(memory, settings)
        refine(fresh, settings)
        assert columns(fresh) == columns(memory)


def test_an_increment_after_dropping_equals_a_full_run():
    memory = two_places(far=32)     # the patches touch
    refine(memory, Refine())
    assert keep_near(memory, (7.0, 7.0, 0.0), radius=14.0) > 100
    refine(memory, Refine(), full=False)
    increment = columns(memory)
    memory.refined_with = None
    refine(memory, Refine(), full=False)
    assert columns(memory) == increment


def test_a_cap_drops_the_farthest_first():
    memory = two_places()
    assert keep_near(memory, (5.0, 5.0, 0.0), max_voxels=1800) == 0
    assert keep_near(memory, (5.0, 5.0, 0.0), max_voxels=1200) >= 720
    assert 900 <= memory.n_voxels <= 1080
    assert (memory.voxels()['voxel'][:, 0] < 100).sum() == 900


def test_nothing_goes_while_a_refinement_reads():
    memory = two_places()
    job = begin(memory, Refine())
    assert keep_near(memory, (5.0, 5.0, 0.0), radius=50.0) == 0
    finish(job, *job.compute())
    assert keep_near(memory, (5.0, 5.0, 0.0), radius=50.0) == 900
