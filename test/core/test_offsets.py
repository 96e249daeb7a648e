"""Where a voxel's points lay in it: the mean of the counted ones, to a 256th of an edge."""

from core_worlds import examples, pose, seeds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.frame import observe as module
from persem_ros.core.frame.observe import observe
from persem_ros.core.memory.voxel_memory import VoxelMemory


def seen(rng, n, size, T, origin, counted):
    """Return points, labels and the Observations of n points in a few voxels."""
    points = rng.uniform(-2 * size, 2 * size, (n, 3))
    labels = np.where(rng.random(n) < counted, rng.integers(0, 3, n), -1).astype(np.int32)
    return points, labels, observe(points, labels, T, size, 2, origin)


@given(seeds, st.sampled_from([0.05, 0.5, 3.0]), st.sampled_from([0.3, 1.0]),
       st.integers(1, 3000))
@examples(max_examples=40)
def test_the_mean_offset_of_the_counted_points(seed, size, counted, n):
    rng = np.random.default_rng(seed)
    T, origin = pose(rng), rng.normal(size=3)
    points, labels, found = seen(rng, n, size, T, origin, counted)
    at = (points @ T[:3, :3].T + T[:3, 3] - origin) / size
    for row, (voxel, label, offset) in enumerate(
            zip(found.voxels, found.labels, found.offsets)):
        if label == 65535:
            assert (offset == 128).all()
            continue
        own = (found.where == row) & (labels >= 0)
        mean = (at[own] - voxel).mean(axis=0)
        assert np.abs((offset + 0.5) / 256 - mean).max() < 1.01 / 256


def test_a_hair_below_a_border_is_the_last_256th():
    found = observe([[-1e-19, 0.5, 0.25]], [4], np.eye(4), 1.0)
    assert found.voxels.tolist() == [[-1, 0, 0]]
    assert found.offsets.tolist() == [[255, 128, 64]]


def test_a_frame_with_too_many_points_to_sum_keeps_the_middle(monkeypatch):
    monkeypatch.setattr(module, 'MOST_OFFSETS', 2)
    assert observe([[0.1, 0.1, 0.1]] * 2, [1, 1], np.eye(4), 1.0).offsets.tolist() == [[25] * 3]
    assert observe([[0.1, 0.1, 0.1]] * 3, [1] * 3, np.eye(4), 1.0).offsets.tolist() == [[128] * 3]


def test_an_observation_keeps_frame_and_offset():
    memory = VoxelMemory(1.0, max_history=8)
    for k in range(20):
        memory.add(observe([[0.05 * k, 0.5, 0.25]], [k % 3], np.eye(4), 1.0, stamp=k // 2,
                           sensor=f'camera {k % 2}'))
    labels, confidences, f, offsets = memory.sightings((0, 0, 0))
    assert f.tolist() == list(range(12, 20))
    assert memory.history((0, 0, 0))[2].tolist() == [k // 2 for k in range(12, 20)]
    assert offsets[:, 0].tolist() == [int(256 * 0.05 * k) for k in range(12, 20)]
    assert offsets[:, 2].tolist() == [64] * 8
    record = memory.m.voxels[memory.number((0, 0, 0))]
    assert record['first_label'] == 0 and record['n'] == 20
