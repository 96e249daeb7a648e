"""Smoothing in image space against the reference."""

from core_worlds import examples, IDS, seeds
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.frames import UNKNOWN
import reference as ref


@given(seeds, st.integers(1, 12), st.integers(1, 9), st.floats(0.0, 1.0) | st.sampled_from(
    [0.0, 0.5, 0.7, 1.0]), st.floats(0.0, 0.6), st.booleans())
@examples(max_examples=100)
def test_random_sequences(seed, length, classes, alpha, ignored, resized):
    rng = np.random.default_rng(seed)
    smooth, images, found = EmaImages(alpha), [], []
    shape = (3, 4)
    for i in range(length):
        if resized and rng.random() < 0.2:
            shape = tuple(rng.integers(1, 5, 2))
        image = rng.choice(IDS[-classes:], shape).astype(np.int32)
        image[rng.random(shape) < ignored] = -1
        images.append(image)
        found.append(smooth.update(image))
        assert found[-1].dtype == np.uint16
    for image, wanted in zip(found, ref.ema2d([i.tolist() for i in images], alpha)):
        assert image.tolist() == [[UNKNOWN if c < 0 else c for c in row] for row in wanted]


def test_results_stay_as_they_were_returned():
    smooth = EmaImages(0.0)
    first = smooth.update(np.full((2, 2), 4, np.int32))
    smooth.update(np.full((2, 2), 5, np.int32))
    assert (first == 4).all()


def test_the_same_with_another_number_of_threads():
    rng = np.random.default_rng(1)
    images = rng.choice(IDS + (-1,), (4, 200, 30)).astype(np.int32)
    before, results = jit.threads(), []
    try:
        for threads in (1, 2, 3):
            jit.set_threads(threads)
            smooth = EmaImages(0.7)
            results.append([smooth.update(image).tobytes() for image in images])
    finally:
        jit.set_threads(before)
    assert results[0] == results[1] == results[2]
