"""The method geometry on a map that is looked at part by part: the same bits as on the whole."""

from dataclasses import replace

from core_worlds import examples
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.geometry.columns import cells_at, columns_of, merged
from persem_ros.core.geometry.groups import cells_listed
from persem_ros.core.geometry.kept import within
from persem_ros.core.geometry.looks import look, looks_from, model_of, pairs_of
from persem_ros.core.geometry.method import relabel
from persem_ros.core.geometry.parameters import estimate
from persem_ros.core.geometry.schedule import Schedule
from persem_ros.core.geometry.sparse_parameters import estimate_sparse
from persem_ros.core.geometry.totals import arrays_of, sums_from, Totals
from persem_ros.core.refine.reach import ASIDE, surrounded
from persem_ros.core.refine.whole import refine
import pytest
from test_geometry import big_flight, flights, GEOMETRY, memory_of, SETTINGS, UPS


def fitted(looks, settings, form):
    """Return the parameters and columns of a map of which there are Looks, in any order."""
    columns = merged([columns_of(one.index) for one in looks])
    classes = np.unique(np.concatenate([one.votes.classes for one in looks]))
    constants, n = settings.geometry, sum(len(one.shape) for one in looks)
    cells = columns.cells(constants.cell)
    for pairs in map(pairs_of, (one.votes for one in looks)):
        pairs.check(len(classes))
    schedule = Schedule(constants.rounds, lambda sums, rho: form(
        sums, n, classes, cells, rho, constants.shrink))
    while not schedule.ended:
        totals = Totals(cells)
        for one in looks:
            model = model_of(one, columns, classes, constants)
            sums = model.start(schedule.rho) if schedule.parameters is None else model.round(
                within(schedule.parameters.arrays(), model.cells))
            totals.add(sums_from(arrays_of(sums)), tuple(map(cells_listed, model.cells)))
        schedule.take(totals.sums())
    return schedule.parameters, columns


def assert_parts_are_the_whole(memory, settings, parts, form=estimate, beside=False):
    """Hold the parts, arrays of block numbers, against a refinement of the whole map."""
    looks = [looks_from(look(memory, surrounded(memory, settings, numbers, int(beside)),
                             settings, beside).arrays()) for numbers in parts]
    parameters, columns = fitted(looks, settings, form)
    refine(memory, settings)
    whole, ours = memory.geometry.arrays(), parameters.arrays()
    assert {name: a.tobytes() for name, a in ours.items()} == {
        name: a.tobytes() for name, a in whole.items()}
    for numbers in parts:
        taken = surrounded(memory, settings, numbers, ASIDE, columns)
        own = within(whole, cells_at(taken.relief.ground, settings.geometry.cell))
        found = relabel(memory, taken, settings, own)
        number = taken.number[:taken.refined]
        assert (found.labels == memory.m.voxels['label'][number]).all()
        assert (found.sources == memory.m.voxels['source'][number]).all()
        assert (found.posterior == memory.store.beliefs['posterior'][number]).all()


def cut(memory, rng, most):
    """Return the block numbers of a memory in some parts, shuffled."""
    numbers = rng.permutation(memory.n_blocks)
    edges = np.sort(rng.integers(0, len(numbers) + 1, int(rng.integers(0, most))))
    return [part for part in np.split(numbers, edges) if len(part)]


@given(flights(), SETTINGS, UPS, st.sampled_from([0, 0, 2]), st.integers(0, 99))
@examples(max_examples=30)
def test_parts_are_the_whole(frames, constants, up, bound, seed):
    memory = memory_of(frames, bound)
    if memory.n_voxels:
        settings = replace(GEOMETRY, up=up, geometry=constants)
        assert_parts_are_the_whole(memory, settings, cut(memory, np.random.default_rng(seed), 5))


@pytest.mark.parametrize('classes', [5, 90])
def test_parts_of_a_large_map(classes):
    memory, rng = memory_of(big_flight(3, 40, classes, 6)), np.random.default_rng(2)
    forms = {'form': estimate} if classes < 65 else {'form': estimate_sparse, 'beside': True}
    assert_parts_are_the_whole(memory, GEOMETRY, cut(memory, rng, 70), **forms)
