"""Refinements beside the mapping thread: what they were handed is what they see."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import random
import threading
import time

from core_worlds import columns_of, core_of, examples, observations, refinements, worlds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.capture import Capture
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import abandon, finish
from persem_ros.core.refine.snapshot import take
from persem_ros.core.refine.turns import begin
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import METHODS, Refine
import pytest
import reference as ref

HERE, EAST = (7, 0, 0), (8, 0, 0)
A, B = 3, 7


def walk(frames, seed=0, side=24, classes=5):
    """Return Observations of a sensor that drifts over a plane, new voxels with each frame."""
    rng = np.random.default_rng(seed)
    result = []
    for t in range(frames):
        cells = np.stack(np.meshgrid(np.arange(side) + t, np.arange(side), [0, 1]),
                         axis=-1).reshape(-1, 3)
        cells = cells[rng.random(len(cells)) < 0.8]
        truth = (cells[:, 0] // 7 + cells[:, 1] // 5) % classes
        labels = np.where(rng.random(len(cells)) < 0.4, rng.integers(0, classes, len(cells)),
                          truth)
        shares = rng.choice([0.4, 0.5, 2 / 3, 1.0], len(cells)).astype(np.float32)
        seen = {tuple(map(int, v)): (int(c), float(s)) for v, c, s in zip(cells, labels, shares)}
        result.append(observations(10 * t, seen))
    return result


def memory_of(seen, max_history=0):
    """Return the memory of a list of Observations."""
    memory = VoxelMemory(0.5, max_history=max_history)
    for one in seen:
        memory.add(one)
    return memory


@given(worlds(most_frames=30), refinements(), st.sampled_from(METHODS), st.integers(1, 20),
       st.sampled_from([0, 1, 4, 8]), st.booleans())
@examples(max_examples=100)
def test_a_job_sees_the_map_as_it_was_at_its_start(frames, settings, method, cut, bound, full):
    settings = replace(settings, method=method)
    memory = core_of(frames[:cut], bound)
    if not full:
        refine(memory, settings)
        for stamp, seen, ids in frames[:cut:3]:
            memory.add(observations(stamp, seen, ids))
    job = begin(memory, settings, full)
    labels, sources, *rest = job.compute()
    for stamp, seen, ids in frames[cut:]:
        memory.add(observations(stamp + 10 ** 12, seen, ids))
        again, anew, *_ = job.compute()
        assert again.tolist() == labels.tolist() and anew.tolist() == sources.tolist()
    finish(job, labels, sources, *rest)
    # Whatever came in between is caught up by the next increment.
    refine(memory, settings, full=False)
    found = columns_of(memory)
    memory.rho, rho = None, memory.rho
    refine(memory, settings)
    if (rho == memory.rho).all() and method != 'geometry':      # which kept its parameters
        assert found == columns_of(memory)


@pytest.mark.parametrize('method', ['persem', 'context_history', 'consensus'])
@pytest.mark.parametrize('max_history', [0, 4])
def test_mapping_and_refinement_at_once(method, max_history):
    settings, seen = replace(Refine(), method=method), walk(60)
    memory, results = VoxelMemory(0.5, max_history=max_history), []
    with ThreadPoolExecutor(1) as pool:
        for i, one in enumerate(seen):
            if i % 6 == 3:
                job, stop = begin(memory, settings, full=i % 4 == 1), threading.Event()
                computed = pool.submit(compute_until, stop, job)
            memory.add(one)
            if i % 6 == 2 and i > 2:
                stop.set()
                results.append((i - 5, job, *computed.result()[:2]))
                finish(job, *computed.result())
        stop.set()
        finish(job, *computed.result())
    assert len(results) == 9

    # Each job gave what it would have given with nothing going on beside it.
    for i, job, labels, sources in results:
        alone = memory_of(seen[:i], max_history)
        alone.rho = job.rho
        again = begin(alone, settings, full=False)      # all is changed here, so all is visited
        wanted, whence, *_ = again.compute()
        row = np.argsort(again.snapshot.number)[job.snapshot.number[:job.snapshot.refined]]
        assert (labels == wanted[row]).all() and (sources == whence[row]).all()

    straight = memory_of(seen, max_history)
    refine(memory, settings)
    refine(straight, settings)
    assert columns_of(memory) == columns_of(straight)
    for voxel in straight.voxels()['voxel'][::37]:
        assert memory.evidence(voxel) == straight.evidence(voxel)
        assert [a.tobytes() for a in memory.history(voxel)] == [
            a.tobytes() for a in straight.history(voxel)]


@pytest.mark.parametrize('max_history', [0, 4])
@pytest.mark.parametrize('seed', range(3))
def test_evictions_saves_and_jobs_that_are_given_up_come_at_any_time(seed, max_history):
    rng, seen = random.Random(seed), walk(60, seed)
    settings = replace(Refine(), method=rng.choice(['persem', 'context_history', 'consensus']))
    memory, twin = (VoxelMemory(0.5, max_history=max_history) for _ in range(2))
    job = capture = None
    done, saved = Counter(), []
    with ThreadPoolExecutor(2) as pool:
        for t, one in enumerate(seen):
            if job is None and rng.random() < 0.3:
                job, stop = begin(memory, settings, full=rng.random() < 0.5), threading.Event()
                computed = pool.submit(compute_until, stop, job, rng.random() * 0.003)
            elif job is not None and rng.random() < 0.3:
                stop.set()
                act = rng.choice([abandon, lambda job: finish(job, *computed.result())])
                done[act is abandon] += computed.result() is not None
                act(job)
                job = None
            if capture is None and rng.random() < 0.2:
                capture = Capture(memory)
            elif capture is not None and capture.step(rng.choice([100, 1000, np.inf])):
                saved.append((columns_of(memory), pool.submit(capture.dump)))
                capture = None
            position, radius = (t / 2, 6.0, 0.0), rng.choice([5.0, 7.0, 9.0])
            if keep_near(memory, position, radius):
                done['gone'] += 1
                assert keep_near(twin, position, radius)
            memory.add(one)
            twin.add(one)
            time.sleep(rng.random() * 0.002)
        if job is not None:
            stop.set()
            finish(job, *computed.result())
        if capture is not None:
            capture.close()
        for columns, dumped in saved:
            assert columns_of(load(dumped.result())) == columns
    assert done[True] and done[False] and done['gone'] > 3 and len(saved) > 2, done
    assert not memory.read_beside
    for one in (memory, twin):
        refine(one, settings)
    assert columns_of(memory) == columns_of(twin)


def compute_until(stop, job, pause=0.0):
    """Return what a job computes, again and again until told to stop, always the same."""
    result = job.compute()
    while not stop.is_set():
        time.sleep(pause)
        again, anew, *_ = job.compute()
        assert (again == result[0]).all() and (anew == result[1]).all()
    return result


def test_many_readers_of_one_job():
    memory = memory_of(walk(12))
    job = begin(memory, Refine())
    wanted, results = [a.tobytes() for a in job.compute()[:3]], []
    threads = [threading.Thread(target=lambda: results.append(
        [a.tobytes() for a in job.compute()[:3]])) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [wanted] * 8


def test_a_majority_label_follows_the_majority_of_today():
    memory = core_of([(t, {HERE: (A, 1.0)}, ()) for t in range(3)])
    job = begin(memory, Refine())
    result = job.compute()
    for t in range(3, 8):
        memory.add(observations(t, {HERE: (B, 1.0)}))
    finish(job, *result)
    assert columns_of(memory)[HERE] == (B, 0)


def test_a_refined_label_stays_until_the_next_refinement():
    frames = [(t, {HERE: (A if t % 2 else B, 0.5 if t % 2 else 0.4), EAST: (B, 1.0)}, ())
              for t in range(6)]
    memory = core_of(frames)
    assert columns_of(memory)[HERE] == (A, 0)
    refine(memory, Refine())
    assert columns_of(memory)[HERE] == (B, 1)
    memory.add(observations(10, {HERE: (A, 0.25)}))
    assert columns_of(memory)[HERE] == (B, 1)
    for t in range(11, 20):
        memory.add(observations(t, {HERE: (A, 1.0)}))
    refine(memory, Refine(), full=False)
    assert columns_of(memory)[HERE] == (A, 0)


def test_a_job_that_was_given_up_is_made_up_for():
    seen = walk(10)
    memory, straight = memory_of(seen), memory_of(seen)
    refine(memory, Refine())
    memory.add(seen[-1])
    abandon(begin(memory, Refine(), full=False))
    refine(memory, Refine(), full=False)
    straight.add(seen[-1])
    refine(straight, Refine())
    assert columns_of(memory) == columns_of(straight)
    assert memory.refinements == 0


def test_a_bounded_history_takes_its_room_back_after_a_job():
    seen = walk(4, side=8)
    memory, sizes = VoxelMemory(0.5, max_history=4), []
    for i in range(60):
        job = begin(memory, Refine())
        for one in seen:
            memory.add(replace(one, stamp=1000 * i + one.stamp))
        finish(job, *job.compute())
        sizes.append(sum(n for what, n in memory.nbytes().items() if what != 'frames'))
    assert max(sizes[40:]) <= max(sizes[10:20])


def test_an_increment_takes_only_the_changed_and_their_surroundings():
    far = (400, 0, 0)
    memory = core_of([(t, {HERE: (A, 1.0), EAST: (A, 1.0), far: (A, 1.0)}, ()) for t in range(3)])
    assert take(memory).refined == 3
    refine(memory, Refine())
    memory.add(observations(9, {HERE: (B, 1.0)}))
    assert refine(memory, Refine(), full=False) == 2        # HERE and, in another block, EAST
    memory.add(observations(10, {far: (B, 1.0)}))
    assert refine(memory, Refine(), full=False) == 1


@pytest.mark.parametrize('neighbours', [6, 18, 26])
def test_an_increment_visits_exactly_the_changed_and_their_neighbours(neighbours):
    # Blocks on both sides of zero, with holes; changes on all their faces, edges and corners.
    rng = np.random.default_rng(neighbours)
    cells = [tuple(int(x) - 10 for x in v) for v in np.ndindex(20, 20, 20) if rng.random() < 0.7]
    memory = core_of([(0, {v: (A, 1.0) for v in cells}, ())])
    settings = replace(Refine(), neighbours=neighbours)
    refine(memory, settings)
    for stamp in range(1, 40):
        few = [cells[i] for i in rng.choice(len(cells), rng.integers(1, 5), replace=False)]
        new = tuple(int(x) for x in rng.integers(-10, 10, 3))      # here before, or not
        changed = {v: (B, 0.5) for v in [*few, new]}
        memory.add(observations(stamp, changed))
        job = begin(memory, settings, full=False)
        finish(job, *job.compute())
        columns = memory.voxels()
        voxel_of = dict(zip(columns['number'].tolist(), map(tuple, columns['voxel'].tolist())))
        around = {tuple(a + b for a, b in zip(v, d)) for v in changed
                  for d in [(0, 0, 0), *ref.offsets(neighbours)]}
        assert {voxel_of[n] for n in job.snapshot.number[:job.snapshot.refined].tolist()} == \
            around & set(voxel_of.values())
