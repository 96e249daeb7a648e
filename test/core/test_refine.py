"""Refinement against the reference: every method, thresholds, increments, identities."""

from dataclasses import replace

from core_worlds import (
    columns_of, core_of, EXACT, examples, observations, reference_of, refinements, seeds, worlds)
from hypothesis import assume, given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import METHODS, Refine
import pytest
import reference as ref

BOUNDS = st.sampled_from([0, 0, 1, 3, 8, 9])


def labels_of(memory, method, settings):
    """Return {voxel: (label, source)} of label(), which enters nothing into the map."""
    before = columns_of(memory)
    labels, sources = label(memory, method, settings)
    assert labels.dtype == np.uint16 and sources.dtype == np.uint8
    assert columns_of(memory) == before
    columns = memory.voxels()
    return {tuple(v): (int(labels[n]), int(sources[n]))
            for v, n in zip(columns['voxel'].tolist(), columns['number'])}


def rho_of(memory):
    """Return the volatility that a memory holds in the reference's form."""
    return {int(c): float(memory.rho[c]) for c in np.flatnonzero(memory.rho)}


@pytest.mark.parametrize('method', METHODS)
def test_random_worlds(method):
    @given(worlds(), refinements(), BOUNDS)
    @examples(max_examples=40)
    def check(frames, settings, bound):
        memory, expected = core_of(frames, bound), reference_of(frames)
        wanted = ref.label(expected, method, settings, bound)
        assert labels_of(memory, method, settings) == wanted
        assert refine(memory, replace(settings, method=method)) == memory.n_voxels
        assert columns_of(memory) == wanted
    check()


@pytest.mark.parametrize('method', ['trust', 'context', 'context_history', 'persem'])
def test_thresholds_hit_exactly(method):
    # Shares that are binary fractions and settings that are quarters: margins meet thresholds.
    @given(worlds(shares=EXACT), refinements(
        lambda_volatility=0.0, lambda_disagreement=0.0, lambda_gap=0.0, gamma=1.0, eta=0.25,
        min_observations=1), st.sampled_from([0.0, 0.25, 0.5]), st.sampled_from([0.0, 0.25, 0.5]))
    @examples(max_examples=40)
    def check(frames, settings, tau_replay, tau_context):
        settings = replace(settings, tau_replay=tau_replay, tau_context=tau_context)
        assert labels_of(core_of(frames), method, settings) == ref.label(
            reference_of(frames), method, settings)
    check()


@pytest.mark.parametrize('method', ['unweighted', 'recency', 'consensus', 'probabilistic'])
def test_close_votes(method):
    # Thousands of voxels with three classes near a draw: a weight one percent off shows.
    rng, cells = np.random.default_rng(8), [(3 * i, 0, 0) for i in range(3000)]
    frames = []
    for t in range(9):
        frames.append((t, {cell: (int(rng.integers(3)), float(np.float32(s))) for cell, s in zip(
            cells, rng.uniform(0.4, 1.0, len(cells))) if rng.random() < 0.8}, (0, 1, 2)))
    memory, expected = core_of(frames), reference_of(frames)
    for settings in (Refine(), replace(Refine(), lambda_recency=0.4, beta=1.3)):
        assert labels_of(memory, method, settings) == ref.label(expected, method, settings)


def margins_of(expected, method, settings):
    """Return (voxel, setting, margin) of every candidate: thresholds worth trying."""
    found = []
    for voxel, history in expected.histories.items():
        if len(history) < settings.min_observations:
            continue
        majority, candidate = expected.majority(voxel), None
        if method == 'context':
            around = expected.neighbours(voxel, settings.neighbours)
            if around:
                candidate = ref.argmax(ref.hard_share(expected, around), majority)
        else:
            rho = expected.volatility()
            candidate = ref.proposal(expected, voxel, rho, settings)
            if candidate is not None:
                e = ref.trusted_evidence(history, rho, settings)
                found.append((voxel, 'tau_replay', e[candidate] - e.get(majority, 0.0)))
        if candidate not in (None, majority):
            hard, soft = ref.margins(expected, voxel, candidate, settings)
            found.append((voxel, 'tau_context', min(hard, soft)))       # the one that decides
    return [one for one in found if one[2] > 1e-6]


@pytest.mark.parametrize('method', ['trust', 'context', 'persem'])
def test_thresholds_that_lie_on_a_margin(method):
    @given(worlds(), refinements(eta=0.0, tau_replay=0.0, tau_context=0.0, min_observations=1),
           st.sampled_from([0.5, 0.8]), st.integers(0, 10 ** 6))
    @examples(max_examples=60)
    def check(frames, settings, gamma, choice):
        settings = replace(settings, gamma=gamma)
        memory, expected = core_of(frames), reference_of(frames)
        margins = margins_of(expected, method, settings)
        assume(margins)
        voxel, name, margin = margins[choice % len(margins)]
        answers = []
        for shift in (-1e-6, 0.0, 1e-6):
            there = replace(settings, **{name: margin + shift})
            wanted = ref.label(expected, method, there)
            assert labels_of(memory, method, there) == wanted
            answers.append(wanted[voxel])
        assert answers[1] == answers[2]     # hit exactly is not exceeded
        if method == 'context' or name == 'tau_replay' and method == 'trust':
            assert answers[0] != answers[1]
    check()


@given(worlds(), refinements(min_observations=1), st.integers(0, 10 ** 6))
@examples(max_examples=60)
def test_an_eta_that_makes_the_anchor_a_tie(frames, settings, choice):
    memory, expected, ties = core_of(frames), reference_of(frames), []
    for voxel in expected.histories:
        around = expected.neighbours(voxel, settings.neighbours)
        majority = expected.majority(voxel)
        p, q = expected.share(voxel), ref.mean_share(expected, around)
        for c in q:
            lead, pull = p[majority] - p.get(c, 0.0), q[c] - q.get(majority, 0.0)
            if lead > 1e-3 and pull > 1e-3:
                ties.append((voxel, lead / (lead + pull)))
    assume(ties)
    voxel, eta = ties[choice % len(ties)]
    for shift in (-1e-6, 0.0, 1e-6):
        there = replace(settings, eta=eta + shift)
        assert labels_of(memory, 'history', there) == ref.label(expected, 'history', there)
    # Beyond the tie somebody else than the majority has won for certain.
    assert ref.anchor(expected, voxel, there) != expected.majority(voxel)


@pytest.fixture(scope='module')
def long_histories():
    """Return (bound, memory, reference) of histories over many links, gaps beyond every table."""
    rng = np.random.default_rng(0)
    cells = [(x, y, 0) for x in (-1, 0) for y in (-1, 0)]
    frames, stamp = [], 0
    for t in range(400):
        frames.append((stamp, {cell: (int(rng.integers(0, 30)) * 2000, float(np.float32(
            rng.choice([0.4, 2 / 3, 1.0])))) for cell in cells if rng.random() < 0.7}, ()))
        stamp += 1
        if t % 100 == 99:
            for _ in range(1100):       # frames that saw nothing
                frames.append((stamp, {}, ()))
                stamp += 1
    expected = reference_of(frames)
    return [(bound, core_of(frames, bound), expected) for bound in (0, 128)]


@pytest.mark.parametrize('method', METHODS)
def test_long_histories_and_many_classes(long_histories, method):
    for bound, memory, expected in long_histories:      # evidence spills
        for settings in (Refine(), replace(Refine(), gamma=0.6, lambda_gap=1e-4, tau_replay=0.0,
                                           eta=0.1, tau_context=0.0, lambda_recency=0.01)):
            assert labels_of(memory, method, settings) == ref.label(
                expected, method, settings, bound)


def test_an_empty_map():
    memory = VoxelMemory(0.5)
    assert refine(memory, Refine()) == 0
    assert refine(memory, Refine(), full=False) == 0
    for method in METHODS:
        assert len(label(memory, method, Refine())[0]) == 0


@given(worlds(most_frames=20), refinements(), st.sampled_from(METHODS[:-1]), BOUNDS,
       st.lists(st.integers(0, 3), min_size=20, max_size=20))
@examples(max_examples=120)
def test_an_increment_equals_a_full_run(frames, settings, method, bound, steps):
    settings = replace(settings, method=method)
    memory, expected, done = VoxelMemory(0.5, max_history=bound), ref.Memory(), 0
    for i, (stamp, seen, ids) in enumerate(frames):
        memory.add(observations(stamp, seen, ids))
        expected.add(seen, stamp, ids)
        if steps[i] == 0:       # a full run: fresh volatility
            refine(memory, settings)
            assert rho_of(memory) == {c: x for c, x in expected.volatility().items() if x}
        elif steps[i] == 1:
            visited = refine(memory, settings, full=False)
            assert visited <= memory.n_voxels
        else:
            continue
        done += 1
        rho = rho_of(memory)
        assert columns_of(memory) == ref.label(expected, method, settings, bound, rho)


@given(worlds(), refinements(), st.sampled_from(METHODS))
@examples(max_examples=60)
def test_twice_gives_the_same_and_visits_nothing(frames, settings, method):
    settings = replace(settings, method=method)
    memory = core_of(frames)
    refine(memory, settings)
    once = columns_of(memory)
    assert refine(memory, settings, full=False) == 0
    assert columns_of(memory) == once
    refine(memory, settings)
    assert columns_of(memory) == once


@given(worlds(), refinements(), st.sampled_from(METHODS))
@examples(max_examples=40)
def test_the_histories_are_left_alone(frames, settings, method):
    def remembered(memory):
        return [(memory.evidence(v), [a.tobytes() for a in memory.history(v)])
                for v in memory.voxels()['voxel']] + [memory.volatility().tobytes()]

    memory = core_of(frames)
    before = remembered(memory)
    refine(memory, replace(settings, method=method))
    assert remembered(memory) == before


@given(worlds(), refinements(), st.sampled_from(METHODS), st.randoms(use_true_random=False))
@examples(max_examples=60)
def test_the_order_of_voxels_within_frames_does_not_matter(frames, settings, method, random):
    shuffled = []
    for stamp, seen, ids in frames:
        cells = list(seen)
        random.shuffle(cells)
        shuffled.append((stamp, {cell: seen[cell] for cell in cells}, ids))
    assert labels_of(core_of(frames), method, settings) == labels_of(
        core_of(shuffled), method, settings)


@pytest.mark.parametrize('change', [
    {'eta': 0.9}, {'neighbours': 6}, {'min_observations': 7}, {'method': 'majority'},
    {'tau_context': 0.0, 'tau_replay': 0.0, 'eta': 0.0}, {'gamma': 0.5, 'eta': 0.0}])
def test_other_settings_revisit_the_whole_map(change):
    # A node's parameters change while it runs; voxels that nobody looks at again must follow.
    rng = np.random.default_rng(11)
    frames = [(t, {(x, y, 0): (int(rng.integers(0, 3)), float(rng.choice([0.5, 0.75, 1.0])))
                   for x in range(6) for y in range(6)}, ()) for t in range(6)]
    settings = Refine()
    memory, expected = core_of(frames), reference_of(frames)
    refine(memory, settings)
    before = columns_of(memory)
    refine(memory, replace(settings, **change), full=False)
    assert columns_of(memory) != before
    assert columns_of(memory) == ref.label(
        expected, change.get('method', 'persem'), replace(settings, **change), rho=rho_of(memory))


def test_a_new_id_anywhere_changes_the_probabilistic_labels_of_all():
    # K = 2: A 0.6 0.6 and B 0.9 make 1.3 to 1.7; K = 100: 1.2 to 0.9.
    here, there, settings = (0, 0, 0), (900, 0, 0), replace(Refine(), method='probabilistic')
    frames = [(t, {here: (c, float(np.float32(s)))}, (3, 5)) for t, (c, s) in enumerate(
        [(3, 0.6), (3, 0.6), (5, 0.9)])]
    memory, expected = core_of(frames), reference_of(frames)
    refine(memory, settings)
    assert columns_of(memory)[here] == (5, 0)
    last = (9, {there: (3, 1.0)}, range(100))
    memory.add(observations(*last))
    expected.add(last[1], last[0], last[2])
    refine(memory, settings, full=False)
    assert columns_of(memory) == ref.label(expected, 'probabilistic', settings)
    assert columns_of(memory)[here] == (3, 0)


def test_a_tie_that_the_majority_wins_from_outside_the_window():
    # K = 2: the one observation that the bound has kept says 0.5 and 0.5.
    here, settings = (0, 0, 0), Refine()
    frames = [(t, {here: (c, 0.5)}, (1, 2)) for t, c in enumerate([1, 1, 2])]
    assert labels_of(core_of(frames, 1), 'probabilistic', settings) == {here: (1, 0)}
    assert ref.label(reference_of(frames), 'probabilistic', settings, 1) == {here: (1, 0)}
    assert labels_of(core_of(frames, 1), 'unweighted', settings) == {here: (2, 0)}


@given(seeds)
@examples(max_examples=4)
def test_the_same_with_another_number_of_threads(seed):
    rng = np.random.default_rng(seed)
    grid = [tuple(int(x) for x in v) for v in np.ndindex(26, 26, 26)]     # several slices
    frames = []
    for stamp in range(5):
        chosen = rng.random(len(grid)) < 0.8
        frames.append((stamp, {v: (int(c), 0.5 + 0.25 * (c % 3)) for v, c, take in zip(
            grid, rng.integers(0, 6, len(grid)), chosen) if take}, ()))
    before, results = jit.threads(), []
    try:
        for threads in (1, 2, 3):
            jit.set_threads(threads)
            memory = core_of(frames)
            for method in METHODS:
                results.append((threads, method, [a.tobytes() for a in label(
                    memory, method, replace(Refine(), eta=0.2))]))
            refine(memory, Refine())
            results.append((threads, 'map', [a.tobytes() for a in memory.voxels().values()]))
    finally:
        jit.set_threads(before)
    for threads, name, found in results:
        assert found == next(f for _, n, f in results if n == name), (threads, name)
