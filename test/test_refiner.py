"""The node's refinements beside the mapping, without ROS: what ~/refine waits for."""

from dataclasses import replace
import threading
import time

from core_worlds import core_of, observations
import numpy as np
from persem_ros.core.refine.rules import swept
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.ros.counters import Statistics
from persem_ros.ros.refiner import Refiner
from persem_ros.settings.config import Refine
import pytest

SETTINGS = replace(Refine(), method='geometry', sweep=300, period=1e9)


def plane(n_frames, side=40, seed=0):
    """Return frames over rough ground, with wrong labels among them."""
    rng = np.random.default_rng(seed)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(side), np.arange(side)))
    cells = np.stack([i, j, (i // 9) % 2], axis=1).tolist()
    frames = []
    for t in range(n_frames):
        labels = np.where(rng.random(len(cells)) < 0.3, rng.integers(0, 5, len(cells)), i // 11)
        frames.append((10 * t, {tuple(v): (int(c), 1.0) for v, c in zip(cells, labels)
                                if rng.random() < 0.6}, ()))
    return frames


@pytest.fixture
def refiner():
    """Return a Refiner, and what is set when its thread is done."""
    done = threading.Event()
    refiner = Refiner(Statistics(), done.set)
    yield refiner, done
    refiner.close()


def serve(refiner, done, memory, future, between=lambda step: None):
    """Do what the worker does until a future is done; return how many steps that took."""
    for step in range(200):
        between(step)
        refiner.begin(memory, SETTINGS, stale=False)
        if not refiner.busy:
            return step
        end = time.monotonic() + 60
        while not refiner.finish(memory) and refiner.busy:
            assert time.monotonic() < end
            done.wait(0.01)
        done.clear()
        assert refiner.busy is False
        if future.done():
            return step + 1
    raise AssertionError('it goes on for ever')


def test_the_map_after_a_refinement_that_was_asked_for_is_that_of_a_replay(refiner):
    frames = plane(6)
    memory, replayed = core_of(frames[:4]), core_of(frames)
    refine(memory, SETTINGS)
    for stamp, seen, ids in frames[4:]:
        memory.add(observations(stamp, seen, ids))
    future = refiner[0].ask()
    steps = serve(*refiner, memory, future)
    assert steps >= 2 * (memory.n_voxels // 400) and future.result()[0] == memory.n_voxels
    refine(replayed, SETTINGS)
    ours, theirs = memory.voxels(), replayed.voxels()
    for name in ('voxel', 'label', 'source', 'confidence'):
        assert ours[name].tobytes() == theirs[name].tobytes()


def test_frames_and_a_new_class_that_come_meanwhile_are_part_of_it(refiner):
    frames, memory = plane(9), core_of(plane(3))
    future = refiner[0].ask()

    def fly(step):
        if step < 6:
            stamp, seen, ids = frames[3 + step]
            memory.add(observations(stamp, {**seen, (step, 0, 0): (60 + (step > 2), 1.0)}, ids))
    serve(*refiner, memory, future, fly)
    assert future.result()[0] == memory.n_voxels and {60, 61} <= set(memory.geometry.classes)
    again = refiner[0].ask()
    serve(*refiner, memory, again)
    before = memory.voxels()
    refine(memory, SETTINGS)
    assert before['confidence'].tobytes() == memory.voxels()['confidence'].tobytes()


def test_the_first_refinement_of_a_large_map_waits_for_no_period_between_its_steps(refiner):
    memory = core_of(plane(3))
    refiner[0]._began = -1e10           # the first is due, by SETTINGS no other
    refiner[0].begin(memory, SETTINGS)
    while refiner[0].busy:
        refiner[1].wait(0.01)
        if refiner[0].finish(memory) or not refiner[0].busy:
            refiner[0].begin(memory, SETTINGS)
    assert swept(memory, SETTINGS) and memory.geometry is not None


def test_what_goes_wrong_in_a_step_is_told_and_the_next_begins_anew(refiner, monkeypatch):
    memory = core_of(plane(3))
    future = refiner[0].ask()
    monkeypatch.setattr('persem_ros.core.refine.survey.Survey._fit', _refuse)
    with pytest.raises(PersemError, match='too many'):
        serve(*refiner, memory, future)
    assert future.exception() is not None and memory.survey is None
    monkeypatch.undo()
    again = refiner[0].ask()
    serve(*refiner, memory, again)
    assert again.result()[0] == memory.n_voxels


def _refuse(survey):
    raise PersemError('too many classes')
