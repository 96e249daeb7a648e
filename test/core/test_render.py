"""Reprojection against the reference: known and unknown pixels, fills, dynamic ids, sizes."""

from dataclasses import replace

from core_worlds import examples, IDS, NO_IDS, pose, seeds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.frame.images import points
from persem_ros.core.frame.observe import observe
from persem_ros.core.frame.place import measured_points, place
from persem_ros.core.frame.render import filled, nearest, render, voxel_image, voxel_image_of
from persem_ros.core.frame.stride import thinned
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.frames import Frame, pinhole, UNKNOWN
from persem_ros.settings.config import Memory
import pytest
import reference as ref


def world(rng, shape, settings, frames=4):
    """Return a memory of random frames, a further frame and what it sees."""
    h, w = shape
    camera = pinhole(w, h, 20.0, 22.0, w / 2, h / 2)
    memory = VoxelMemory(settings.voxel_size, origin=(0.5, -1.0, 0.25))
    T = pose(rng)
    for stamp in range(frames):
        depth = rng.uniform(0.2, 4.0, shape)
        chosen = rng.random(shape) < 0.2
        depth[chosen] = rng.choice([0.0, np.nan, np.inf, 0.05, 9.0], chosen.sum())
        frame = Frame(stamp, rng.choice(IDS + NO_IDS + (255,), shape).astype(np.int32), depth,
                      camera, T)

        def seen(frame):
            return observe(*points(frame, settings), T, settings.voxel_size, settings.min_pixels,
                           memory.origin, stamp)
        if stamp < frames - 1:
            memory.add(seen(thinned(frame, settings)))
    return memory, frame, points(frame, settings)[0], seen(frame)


def by_number(memory, labels):
    """Return {voxel: label} of labels by voxel number."""
    columns = memory.voxels()
    return {tuple(v): int(labels[n])
            for v, n in zip(columns['voxel'].tolist(), columns['number'])}


@given(seeds, st.sampled_from([(7, 9), (1, 5), (12, 4)]), st.sampled_from([1, 3]),
       st.sampled_from(['input', 'unknown']), st.sampled_from([(-1,), (2, 13), (0, 65534)]),
       st.sampled_from([0.1, 0.6]))
@examples(max_examples=100)
def test_random_frames(seed, shape, stride, fill, dynamic, voxel_size):
    rng = np.random.default_rng(seed)
    settings = replace(Memory(), voxel_size=voxel_size, stride=stride, dynamic_labels=dynamic,
                       max_depth=5.0)
    memory, frame, placed, seen = world(rng, shape, settings)
    labels = rng.choice(IDS, memory.n_voxels).astype(np.uint16)
    voxels = voxel_image(memory, seen, shape)
    unseen = voxel_image_of(
        memory, *place(measured_points(placed), frame.T_map_camera, memory.voxel_size,
                       memory.origin), shape)
    assert voxels.tolist() == unseen.tolist()
    image = filled(render(voxels, labels), frame.labels, settings, fill)
    assert image.dtype == np.int32
    assert image.reshape(-1).tolist() == ref.render(
        by_number(memory, labels), [p if np.isfinite(p).all() else None for p in placed],
        frame.labels.reshape(-1).tolist(), frame.T_map_camera, voxel_size, fill,
        [c for c in dynamic if c >= 0], memory.origin)


def test_a_frame_is_rendered_from_the_memory_as_it_stood_then():
    settings = replace(Memory(), voxel_size=0.5)
    memory, _, _, seen = world(np.random.default_rng(3), (6, 6), settings)
    before = voxel_image(memory, seen, (6, 6))
    assert (before >= 0).any() and (before < 0).any()
    memory.add(seen)
    after = voxel_image(memory, seen, (6, 6))
    assert (after[before >= 0] == before[before >= 0]).all()        # nothing moves
    assert (after >= 0).sum() > (before >= 0).sum()


@pytest.mark.parametrize('fill, unknown, expected', [
    ('input', UNKNOWN, [[7, 7, 8, 9], [7, 12, 8, -1]]),
    ('unknown', UNKNOWN, [[7, 7, UNKNOWN, UNKNOWN], [7, 12, UNKNOWN, UNKNOWN]]),
    ('unknown', 255, [[7, 7, 255, 255], [7, 12, 255, 255]])])
def test_refined_images_have_the_labels_size(fill, unknown, expected):
    image = np.array([[7, UNKNOWN]], np.uint16)
    own = np.array([[5, 6, 8, 9], [5, 12, 8, -1]], np.int32)
    settings = replace(Memory(), dynamic_labels=(12,))
    assert filled(image, own, settings, fill, unknown).tolist() == expected
    assert own.tolist() == [[5, 6, 8, 9], [5, 12, 8, -1]]       # not written to


@given(seeds, st.integers(1, 6), st.integers(1, 6), st.integers(1, 5), st.integers(1, 5))
@examples(max_examples=60)
def test_nearest_is_the_same_way_back(seed, h, w, wide, narrow):
    image = np.random.default_rng(seed).integers(0, 9, (h * narrow, w * narrow)).astype(np.uint16)
    assert nearest(image, (h * wide, w * wide)).tolist() == ref.resampled(
        image.tolist(), h * wide, w * wide)


def test_the_same_with_another_number_of_threads():
    settings = replace(Memory(), voxel_size=0.05)
    shape, before, results = (300, 500), jit.threads(), []
    try:
        for threads in (1, 2, 3):
            jit.set_threads(threads)
            memory, frame, placed, seen = world(
                np.random.default_rng(1), shape, settings, frames=2)
            labels = np.arange(memory.n_voxels).astype(np.uint16)
            voxels = voxel_image(memory, seen, shape)
            unseen = voxel_image_of(memory, *place(
                measured_points(placed), frame.T_map_camera, memory.voxel_size,
                memory.origin), shape)
            results.append((voxels.tobytes(), unseen.tobytes(),
                            render(voxels, labels).tobytes()))
    finally:
        jit.set_threads(before)
    assert results[0] == results[1] == results[2]
