"""The four verbs in a row, frame by frame, against the reference."""

from dataclasses import replace

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.frames import Frame, pinhole
from persem_ros.pipeline import Pipeline
from persem_ros.settings.config import METHODS
import pytest
import replays
from replays import config_of

CAMERA = pinhole(8, 6, 5.0, 5.0, 3.5, 2.5)
IDS = (-70000, -1, 0, 1, 2, 3, 9, 255, 65534, 65535, 70000)
DEPTHS = (np.nan, np.inf, -np.inf, -1.0, 0.0, 0.1, 0.05, 200.0, 200.1)


def frames_of(seed, count=5, scale=1):
    """Return random frames of a corner of the world; labels *scale* times as large as depth."""
    rng = np.random.default_rng(seed)
    result = []
    for i in range(count):
        depth = rng.uniform(0.2, 1.5, (6, 8))
        odd = rng.random((6, 8)) < 0.1
        depth[odd] = rng.choice(DEPTHS, np.count_nonzero(odd))
        labels = rng.choice((1, 2, 3, 9), (6 * scale, 8 * scale))
        odd = rng.random(labels.shape) < 0.1
        labels[odd] = rng.choice(IDS, np.count_nonzero(odd))
        result.append(Frame(1000 * i, labels.astype(np.int32), depth, CAMERA,
                            cw.pose(rng, spread=0.2), truth=np.ones_like(labels, np.int32)))
    return result


settings = st.fixed_dictionaries({
    'memory.voxel_size': st.sampled_from([0.1, 0.5, 2.0]),
    'memory.stride': st.integers(0, 3),
    'memory.min_pixels': st.integers(1, 3),
    'memory.max_depth': st.sampled_from([0.9, 200.0]),
    'memory.ignore_labels': st.sampled_from([[255, 65535], [0], [-1, 2], [-1]]),
    'memory.dynamic_labels': st.sampled_from([[-1], [9], [3, 65534]]),
    'render.fill': st.sampled_from(['input', 'unknown']),
    'refine.method': st.sampled_from(METHODS),
    'refine.min_observations': st.integers(1, 3),
    'map.origin': st.sampled_from([[0.0, 0.0, 0.0], [-1.7, 0.3, 12.25]])})


@cw.examples(max_examples=25)
@given(cw.seeds, st.integers(1, 2), settings)
def test_map_and_images_are_those_of_the_reference(seed, scale, values):
    config, frames = config_of(values), frames_of(seed, scale=scale)
    expected = replays.Expected(frames, config, [config.refine.method])
    pipeline = Pipeline(config)
    for frame in frames:
        pipeline.add(frame)
    pipeline.refine()
    columns = pipeline.memory.voxels()
    found = dict(zip(map(tuple, columns['voxel'].tolist()), columns['label'].tolist()))
    assert found == expected.labels[config.refine.method]
    for frame, image in zip(frames, expected.published()):
        assert pipeline.render(frame).tolist() == image


def test_observations_save_placing_the_pixels_again():
    pipeline, frames = Pipeline(config_of({'memory.dynamic_labels': [9]})), frames_of(1)
    for frame in frames:
        observations = pipeline.add(frame)
        assert (pipeline.voxel_image(frame, observations) == pipeline.voxel_image(frame)).all()
        assert (pipeline.render(frame, observations) == pipeline.render(frame)).all()


def test_rendering_asks_and_never_adds():
    pipeline, frames = Pipeline(config_of()), frames_of(2)
    pipeline.add(frames[0])
    before = pipeline.memory.n_voxels, pipeline.memory.n_observations
    for frame in frames:
        pipeline.render(frame)
    assert (pipeline.memory.n_voxels, pipeline.memory.n_observations) == before


def test_a_given_memory_is_gone_on_with():
    first, frames = Pipeline(config_of()), frames_of(3)
    for frame in frames[:2]:
        first.add(frame)
    second = Pipeline(config_of(), first.memory)
    for frame in frames[2:]:
        second.add(frame)
    whole = Pipeline(config_of())
    for frame in frames:
        whole.add(frame)
    one, two = second.memory.voxels(), whole.memory.voxels()
    assert all((one[name] == two[name]).all() for name in two)


def test_unknown_is_the_first_ignored_id():
    assert Pipeline(config_of({'memory.ignore_labels': [-1, 7, 255]})).unknown == 7
    assert Pipeline(config_of({'memory.ignore_labels': [-1]})).unknown == 65535


def test_labels_of_another_shape_are_refused():
    frame = frames_of(4, count=1)[0]
    wrong = replace(frame, labels=np.ones((8, 6), np.int32))
    with pytest.raises(PersemError, match='aspect'):
        Pipeline(config_of()).add(wrong)
