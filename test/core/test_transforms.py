"""Rigid transforms of points against products of matrices."""

from core_worlds import examples, pose, seeds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.transforms import inverse, transformed


@given(seeds, st.integers(0, 40), st.booleans())
@examples(max_examples=60)
def test_points_are_moved_as_by_the_matrix(seed, n, turned):
    rng = np.random.default_rng(seed)
    points, T = rng.normal(scale=9.0, size=(n, 3)), pose(rng)
    points[rng.random(n) < 0.1] = np.nan
    before = points.copy()
    moved = transformed(np.asfortranarray(points) if turned else points, T)
    wide = np.concatenate([points, np.ones((n, 1))], axis=1)
    np.testing.assert_allclose(moved, np.einsum('ij,nj->ni', T, wide)[:, :3], atol=1e-12)
    assert moved.dtype == np.float64 and moved.flags.c_contiguous
    np.testing.assert_allclose(transformed(moved, inverse(T)), points, atol=1e-12)
    np.testing.assert_array_equal(points, before)


def test_a_point_is_moved_alike_alone_and_among_others():
    rng = np.random.default_rng(1)
    points, T = rng.normal(size=(1000, 3)), pose(rng)
    whole = transformed(points, T)
    assert b''.join(transformed(one[None], T).tobytes() for one in points) == whole.tobytes()
