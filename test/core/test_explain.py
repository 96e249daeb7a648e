"""The trace of a voxel ends where the kernels end, and its numbers are the reference's."""

import core_worlds as cw
from hypothesis import given, strategies as st
from persem_ros.core.refine.explain import explain
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.selection import METHODS
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Config, updated
import pytest
import reference as ref


def settings_of(method, **others):
    values = {'refine.method': method, 'refine.min_observations': 2, 'refine.tau_replay': 0.0,
              **{f'refine.{name}': value for name, value in others.items()}}
    return updated(Config(), values).refine


@cw.examples(max_examples=80)
@given(cw.worlds(), st.sampled_from(sorted(METHODS)), st.sampled_from([6, 26]),
       st.sampled_from([0.0, 0.3, 0.8]), st.sampled_from([0.0, 0.1]), st.sampled_from([0, 3]))
def test_the_trace_ends_where_the_kernels_end(world, method, neighbours, eta, tau, kept):
    settings = settings_of(method, neighbours=neighbours, eta=eta, tau_context=tau)
    memory = cw.core_of(world, kept)
    if memory.n_voxels:
        labels, sources = label(memory, method, settings)
        for voxel in memory.voxels()['voxel']:
            trace = explain(memory, voxel, settings)
            number = memory.number(voxel)
            assert (trace['label'], trace['source']) == (labels[number], sources[number])


@cw.examples(max_examples=40)
@given(cw.worlds())
def test_its_numbers_are_the_references(world):
    settings = settings_of('persem')
    memory, plain = cw.core_of(world), cw.reference_of(world)
    for voxel in plain.histories:
        trace = explain(memory, voxel, settings)
        around = plain.neighbours(voxel, 26)
        assert trace['shares'] == pytest.approx(plain.share(voxel))
        assert trace['neighbours'] == len(around)
        assert trace['replayed'] == pytest.approx(ref.trusted_evidence(
            plain.histories[voxel], plain.volatility(), settings))
        if around:
            assert trace['hard'] == pytest.approx(ref.hard_share(plain, around))
            assert trace['soft'] == pytest.approx(ref.mean_share(plain, around))
            assert trace['anchor_label'] == ref.anchor(plain, voxel, settings)


def test_a_refined_map_has_the_label_of_its_trace():
    settings = settings_of('persem', eta=0.6)
    memory = cw.core_of([(t, {(0, 0, z): (1 if z else 2, 1.0) for z in range(3)}, [])
                         for t in range(4)])
    refine(memory, settings)
    trace = explain(memory, (0, 0, 0), settings)
    assert trace['anchor'] == pytest.approx({1: 0.6, 2: 0.4})
    assert (trace['stored_label'], trace['stored_source']) == (1, 1)
    assert (trace['label'], trace['source'], trace['changed']) == (1, 1, False)
    assert trace['candidate'] is None
    memory.add(cw.observations(9, {(0, 0, 0): (2, 1.0)}))
    assert explain(memory, (0, 0, 0), settings)['changed']
