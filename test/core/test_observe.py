"""observe() against the reference: random clouds, borders, votes and identities."""

from unittest import mock

from core_worlds import examples, IDS, NO_IDS, pose, seeds
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.frame import observe as module
from persem_ros.core.frame.observe import observe
from persem_ros.errors import PersemError
from persem_ros.frames import UNKNOWN
import pytest
import reference as ref

EYE = np.eye(4)


def as_dict(seen):
    """Return Observations in the reference's form, {voxel: (label, s)}."""
    return {tuple(map(int, v)): (int(c), float(s))
            for v, c, s in zip(seen.voxels, seen.labels, seen.confidences) if c != UNKNOWN}


def cloud(rng, n, extent=1.5):
    """Return n points within *extent* metres, some not finite, and labels of all kinds."""
    points = rng.uniform(-extent, extent, (n, 3))
    points[rng.random(n) < 0.05] = rng.choice([np.nan, np.inf, -np.inf])
    ids = rng.choice(IDS, rng.integers(1, 6))
    labels = rng.choice(np.concatenate([ids, rng.choice(NO_IDS, 1)]), n).astype(np.int32)
    return points, labels


def same(one, two):
    """Assert that two Observations have the same bytes."""
    for name in ('voxels', 'labels', 'confidences', 'where', 'ids', 'offsets'):
        a, b = getattr(one, name), getattr(two, name)
        assert a.dtype == b.dtype and a.tobytes() == b.tobytes(), name


@given(seeds, st.integers(0, 300), st.sampled_from([0.05, 0.3, 0.5, 4.0]),
       st.sampled_from([1, 2, 5]), st.booleans())
@examples(max_examples=150)
def test_random_clouds(seed, n, voxel_size, min_pixels, shifted):
    rng = np.random.default_rng(seed)
    points, labels = cloud(rng, n)
    T, origin = pose(rng), tuple(rng.normal(size=3)) if shifted else (0.0, 0.0, 0.0)
    seen = observe(points, labels, T, voxel_size, min_pixels, origin)
    assert as_dict(seen) == ref.observe(points, labels, T, voxel_size, min_pixels, origin)
    assert len({tuple(v) for v in seen.voxels}) == len(seen.voxels)
    counted = [c for c, p in zip(labels, points) if 0 <= c <= 65534 and np.isfinite(p).all()]
    assert sorted(set(counted)) == seen.ids.tolist()
    for point, row in zip(points, seen.where):
        if np.isfinite(point).all():
            assert tuple(seen.voxels[row]) == ref.voxel_of(point, T, voxel_size, origin)
        else:
            assert row == -1


@given(seeds, st.integers(0, 200), st.sampled_from([0.3, 4.0]), st.sampled_from([1, 3]))
@examples(max_examples=60)
def test_random_weights(seed, n, voxel_size, min_pixels):
    rng = np.random.default_rng(seed)
    points, labels = cloud(rng, n)
    w = rng.choice([0.0, 1.0, 0.5, 0.25, 1 / 3, 2.0, -1.0, 1e-6, np.nan, rng.random()], n)
    weights = np.rint(np.clip(np.nan_to_num(w), 0, 1) * 65536).astype(np.uint32)
    seen = observe(points, labels, EYE, voxel_size, min_pixels, weights=weights)
    assert as_dict(seen) == ref.observe(points, labels, EYE, voxel_size, min_pixels, weights=w)
    certain = observe(points, labels, EYE, voxel_size, weights=np.full(n, 65536, np.uint32))
    same(certain, observe(points, labels, EYE, voxel_size))


@given(seeds)
@examples(max_examples=30)
def test_points_on_the_borders_of_voxels(seed):
    rng = np.random.default_rng(seed)
    points = rng.integers(-6, 7, (200, 3)) * 0.25
    labels = rng.choice(IDS, 200).astype(np.int32)
    seen = observe(points, labels, EYE, 0.5)
    assert as_dict(seen) == ref.observe(points, labels, EYE, 0.5)
    assert seen.voxels.min() < 0


@given(seeds, st.lists(st.tuples(st.sampled_from(IDS + NO_IDS), st.integers(1, 4)), max_size=9),
       st.integers(1, 6))
@examples(max_examples=150)
def test_votes_and_their_ties(seed, votes, min_pixels):
    labels = np.repeat([c for c, _ in votes], [n for _, n in votes]).astype(np.int32)
    np.random.default_rng(seed).shuffle(labels)
    points = np.full((len(labels), 3), -0.1)
    seen = observe(points, labels, EYE, 1.0, min_pixels)
    assert as_dict(seen) == ref.observe(points, labels, EYE, 1.0, min_pixels)
    assert len(seen.voxels) == bool(votes)      # seen, whether observed or not


@given(seeds)
@examples(max_examples=20)
def test_the_order_of_points_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    points, labels = cloud(rng, 400)
    order = rng.permutation(400)
    assert as_dict(observe(points, labels, EYE, 0.5)) == as_dict(
        observe(points[order], labels[order], EYE, 0.5))


def test_confidence_is_the_float32_of_the_share():
    labels = np.array([4, 4, 6], np.int32)
    seen = observe(np.zeros((3, 3)), labels, EYE, 1.0)
    assert seen.confidences.dtype == np.float32
    assert seen.confidences[0] == np.float32(2 / 3)


def test_more_voxels_than_the_first_table_holds():
    rng = np.random.default_rng(5)
    points = rng.uniform(-20, 20, (60000, 3))
    labels = rng.choice(IDS, 60000).astype(np.int32)
    seen = observe(points, labels, EYE, 1.0)
    assert len(seen.voxels) > 32768
    assert as_dict(seen) == ref.observe(points, labels, EYE, 1.0)


def test_a_thousand_ids_in_one_voxel():
    labels = np.concatenate([np.arange(65534, 64534, -1), [65000]]).astype(np.int32)
    seen = observe(np.zeros((1001, 3)), labels, EYE, 1.0)
    assert as_dict(seen) == {(0, 0, 0): (65000, float(np.float32(2 / 1001)))}
    assert len(seen.ids) == 1000


def test_points_outside_the_index_range_have_no_place():
    # The range is a million voxels from the sensor along each axis (21 bits of a key).
    edge = 2.0 ** 20
    points = np.array([[1e300, 0, 0], [0, -3e9, 0], [0, 0, edge], [edge - 1, 1 - edge, 5]])
    seen = observe(points, np.ones(4, np.int32), EYE, 1.0)
    assert seen.where.tolist() == [-1, -1, -1, 0]
    assert seen.voxels.tolist() == [[2 ** 20 - 1, 1 - 2 ** 20, 5]]
    assert seen.ids.tolist() == [1]


def test_a_sensor_too_far_away_for_its_voxels_is_refused():
    T = EYE.copy()
    T[0, 3] = 3e9
    with pytest.raises(PersemError, match='too far away for voxels of 1.0 m'):
        observe(np.zeros((1, 3)), np.ones(1, np.int32), T, 1.0)


def test_large_coordinates_keep_their_precision():
    # 1e7 m away, 1 cm voxels: the origin is taken off the position before anything is added.
    T = EYE.copy()
    T[:3, 3] = 5e6 + 0.125, 1e7, -3e6
    points = np.random.default_rng(2).uniform(-1, 1, (500, 3))
    labels = np.ones(500, np.int32)
    near = T.copy()
    near[:3, 3] = 0.125, 0.0, 0.0
    assert as_dict(observe(points, labels, T, 0.01, origin=(5e6, 1e7, -3e6))) == \
        as_dict(observe(points, labels, near, 0.01))


@pytest.mark.parametrize('n', [0, 1])
def test_next_to_nothing(n):
    seen = observe(np.zeros((n, 3)), np.zeros(n, np.int32), EYE, 0.5, stamp=7, sensor='front')
    assert as_dict(seen) == ({(0, 0, 0): (0, 1.0)} if n else {})
    assert seen.voxels.shape == (n, 3) and seen.where.shape == (n,)
    assert (seen.stamp, seen.sensor) == (7, 'front')
    assert seen.T_map_sensor.tolist() == EYE.tolist()


def test_layouts_and_types_are_normalised_at_the_border():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (300, 3)).astype(np.float32).astype(np.float64)
    labels = rng.integers(0, 200, 300).astype(np.int32)
    plain = observe(points, labels, EYE, 0.5)
    frozen = points.copy()
    frozen.setflags(write=False)
    wide = np.zeros((600, 6))
    wide[::2, ::2] = points
    for p, c in [(frozen, labels), (np.asfortranarray(points), labels.astype(np.uint8)),
                 (wide[::2, ::2], np.repeat(labels, 2)[::2]),
                 (points.astype(np.float32), labels.astype(np.int64)),
                 (points.astype('>f8'), labels.astype('>i4')),
                 (points.reshape(20, 15, 3), labels.reshape(20, 15)),
                 (points.tolist(), labels.tolist())]:
        same(observe(p, c, EYE, 0.5), plain)
    same(observe(points, labels, EYE.tolist(), 0.5), plain)


def test_the_same_again_and_with_another_number_of_threads():
    rng = np.random.default_rng(4)
    points = rng.uniform(-5, 5, (150000, 3))        # several slices
    labels = rng.choice(IDS + NO_IDS, 150000).astype(np.int32)
    T, before = pose(rng), jit.threads()
    try:
        jit.set_threads(1)
        one = observe(points, labels, T, 0.25)
        same(observe(points, labels, T, 0.25), one)
        for threads in (2, 5):
            jit.set_threads(threads)
            same(observe(points, labels, T, 0.25), one)
    finally:
        jit.set_threads(before)


def in_parts(number):
    """Return what stands in for jit.split(): as many slices as are asked for, one by one."""
    def split(function, n, *arguments, grain=1):
        edges = [n * i // number for i in range(number + 1)]
        return [function(a, b, *arguments) for a, b in zip(edges, edges[1:]) if a < b]
    return split


@given(seeds, st.integers(1, 2000), st.sampled_from([0.05, 0.3, 4.0]), st.sampled_from([1, 3]),
       st.sampled_from([2, 3, 7]), st.booleans())
@examples(max_examples=80)
def test_what_parts_of_a_frame_counted_adds_up(seed, n, voxel_size, min_pixels, parts, weighed):
    # Voxels, their first ids and further ones in several parts, or in later ones alone; points
    # that only have a place; ties. Small voxels are more than the first tables hold.
    rng = np.random.default_rng(seed)
    points, labels = cloud(rng, n)
    labels[:rng.integers(0, n)] = -1
    weights = rng.choice([0, 1, 30000, 65536], n).astype(np.uint32) if weighed else None
    T = pose(rng)
    with mock.patch.object(module, 'split', in_parts(1)):
        whole = observe(points, labels, T, voxel_size, min_pixels, weights=weights)
    with mock.patch.object(module, 'split', in_parts(parts)):
        same(observe(points, labels, T, voxel_size, min_pixels, weights=weights), whole)


def test_voxels_are_in_order_of_first_appearance():
    rng = np.random.default_rng(8)
    points, labels = cloud(rng, 1000)
    seen = observe(points, labels, EYE, 0.3)
    _, first = np.unique(seen.where[seen.where >= 0], return_index=True)
    assert (np.diff(first) > 0).all()


def test_inputs_are_left_alone():
    points, labels = cloud(np.random.default_rng(6), 100)
    before = points.tobytes(), labels.tobytes()
    observe(points, labels, EYE, 0.5)
    assert (points.tobytes(), labels.tobytes()) == before
