"""The image front end against the reference: what counts, where it is, other sizes."""

from dataclasses import replace

from core_worlds import examples, IDS, NO_IDS, pose, seeds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.frame.images import counting, measured, points
from persem_ros.core.frame.median import median_depth, median_within
from persem_ros.core.frame.observe import gather, observe
from persem_ros.core.frame.place import measured_points, place
from persem_ros.core.frame.stride import stride_of, thinned
from persem_ros.errors import PersemError
from persem_ros.frames import Frame, pinhole
from persem_ros.settings.config import Memory
import pytest
import reference as ref

NO_DEPTHS = (0.0, np.nan, np.inf, -np.inf, -1.0)


def frame_of(labels, depth, fx=40.0):
    """Return a Frame of two images, with a camera for the depth's size."""
    depth = np.asarray(depth, np.float64)
    h, w = depth.shape
    return Frame(0, np.asarray(labels, np.int32), depth,
                 pinhole(w, h, fx, fx * 1.1, (w - 1) / 2, (h - 1) / 2 + 0.3))


def same(one, two):
    """Assert that two Observations have the same bytes."""
    for name in ('voxels', 'labels', 'confidences', 'where', 'ids', 'offsets'):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name


def counted(frame, settings):
    """Return the points and labels that count, as the reference lists them."""
    xyz, labels = points(frame, settings)
    assert xyz.dtype == np.float64 and labels.dtype == np.int32
    assert xyz.shape == (frame.depth.size, 3) and labels.shape == (frame.depth.size,)
    chosen = np.isfinite(xyz).all(axis=1) & (labels >= 0) & (labels <= 65534)
    return [tuple(map(float, p)) for p in xyz[chosen]], labels[chosen].tolist()


def expected(frame, settings):
    """Return what the reference makes of the same frame."""
    stride = settings.stride or ref.auto_stride(
        frame.depth, frame.camera.K[0, 0], settings.voxel_size, settings.min_depth,
        settings.max_depth)
    return ref.backproject(frame.depth, frame.camera.rays, frame.labels,
                           settings.ignore_labels, settings.dynamic_labels,
                           settings.min_depth, settings.max_depth, stride)


@given(seeds, st.integers(1, 12), st.integers(1, 12), st.integers(0, 4),
       st.sampled_from([(255, 65535), (0,), (-1,), (65534, 3, 70000)]),
       st.sampled_from([(-1,), (2, 5), (65533,)]))
@examples(max_examples=150)
def test_random_frames(seed, h, w, stride, ignored, dynamic):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.0, 12.0, (h, w))
    chosen = rng.random((h, w)) < 0.3
    depth[chosen] = rng.choice(NO_DEPTHS + (0.5, 10.0), chosen.sum())      # both ends included
    frame = frame_of(rng.choice(IDS + NO_IDS + (255,), (h, w)), depth)
    settings = replace(Memory(), min_depth=0.5, max_depth=10.0, stride=stride,
                       ignore_labels=ignored, dynamic_labels=dynamic)
    assert counted(thinned(frame, settings), settings) == expected(frame, settings)
    # Placing pixels without their points is only a short cut.
    frame = replace(frame, T_map_camera=pose(rng, 40.0))
    for voxel_size, origin in ((0.5, (0.0, 0.0, 0.0)), (0.03, (7.0, -300.0, 0.1)),
                               (5e-6, (0.0, 0.0, 0.0))):        # some are out of reach
        xyz, labels = points(frame, settings)
        keys, base = place(measured(frame, settings), frame.T_map_camera, voxel_size, origin)
        those, its = place(measured_points(xyz), frame.T_map_camera, voxel_size, origin)
        assert keys.tolist() == those.tolist() and base.tolist() == its.tolist()
        seen = gather(measured(frame, settings), frame.labels, counting(settings),
                      frame.T_map_camera, voxel_size, 1, origin)
        same(seen, observe(xyz, labels, frame.T_map_camera, voxel_size, 1, origin))


@given(seeds, st.integers(1, 6), st.integers(1, 6), st.integers(1, 5), st.integers(1, 5))
@examples(max_examples=100)
def test_labels_of_another_size(seed, h, w, wide, narrow):
    rng = np.random.default_rng(seed)
    frame = frame_of(rng.choice(IDS, (h * wide, w * wide)),
                     rng.uniform(1, 2, (h * narrow, w * narrow)))
    assert counted(frame, Memory()) == expected(frame, Memory())


def test_a_point_may_be_placed_where_its_label_does_not_count():
    xyz, labels = points(frame_of([[255, 7]], [[2.0, 2.0]]), Memory())
    assert labels.tolist() == [-1, 7]
    assert np.isfinite(xyz).all()


def test_zero_is_no_measurement_even_where_the_range_starts_at_zero():
    settings = replace(Memory(), min_depth=0.0)
    xyz, _ = points(frame_of([[1, 1, 1]], [[0.0, -0.0, 1e-9]]), settings)
    assert np.isfinite(xyz).all(axis=1).tolist() == [False, False, True]


@pytest.mark.parametrize('labels, depth', [((4, 8), (4, 4)), ((480, 640), (640, 480)),
                                           ((1080, 1920), (480, 640))])
def test_another_aspect_ratio_is_refused(labels, depth):
    frame = frame_of(np.zeros(labels), np.ones(depth))
    with pytest.raises(PersemError, match=f'{labels[1]} x {labels[0]}.*{depth[1]} x {depth[0]}'):
        points(frame, Memory())


def test_an_aspect_ratio_that_differs_by_rounding_is_fine():
    # Half of 1241 x 376, as a network that wants even sizes would give it.
    frame = frame_of(np.full((188, 620), 4), np.ones((376, 1241)))
    assert len(counted(frame, Memory())[1]) == 376 * 1241


def test_the_same_with_another_number_of_threads_and_layout():
    rng = np.random.default_rng(1)
    frame = frame_of(rng.choice(IDS, (256, 300)), rng.uniform(-1, 9, (256, 300)))
    turned = replace(frame, depth=np.asfortranarray(frame.depth),
                     labels=np.asfortranarray(frame.labels))
    frozen = replace(frame, depth=frame.depth.copy(), labels=frame.labels.copy())
    frozen.depth.setflags(write=False)
    frozen.labels.setflags(write=False)
    before, results = jit.threads(), []
    try:
        for threads, given_ in [(1, frame), (2, frame), (3, turned), (2, frozen)]:
            jit.set_threads(threads)
            results.append(b''.join(a.tobytes() for a in points(given_, Memory())))
    finally:
        jit.set_threads(before)
    assert len(set(results)) == 1


@given(seeds, st.integers(1, 40), st.sampled_from([1e-3, 1.0, 1e4]), st.booleans())
@examples(max_examples=100)
def test_the_median_depth_is_numpys(seed, n, scale, tied):
    rng = np.random.default_rng(seed)
    depth = scale * (rng.integers(1, 4, (n, 5)).astype(float) if tied else rng.exponential(
        size=(n, 5)))
    chosen = rng.random(depth.shape) < 0.3
    depth[chosen] = rng.choice(NO_DEPTHS, chosen.sum())
    low, high = 0.5 * scale, 3.0 * scale
    inside = depth[(depth >= low) & (depth <= high)]
    middle = np.median(inside) if len(inside) else 0.0
    assert median_depth(depth, low, high) == middle
    for least, most in np.sort(rng.uniform(low, high, (8, 2))):
        if median_within(depth, low, high, least, most):
            assert least <= middle <= most
    if len(inside) > 0.6 * depth.size:
        assert median_within(depth, low, high, low, high)


@given(seeds, st.integers(0, 9), st.sampled_from([0.0, 0.2, 0.6]), st.booleans())
@examples(max_examples=60)
def test_a_median_is_within_where_most_depths_say_so(seed, rows, missing, sloping):
    # Up to 27 000 depths, of which each half is counted in goes: it ends where it knows enough.
    rng = np.random.default_rng(seed)
    depth = rng.choice([np.arange(1.0, 9.0), rng.uniform(0.0, 9.0, 8)]).repeat(10)
    depth = rng.choice(depth, (rows, 3000))
    if sloping:
        depth *= np.linspace(0.2, 1.0, rows)[:, None]
    chosen = rng.random(depth.shape) < missing
    depth[chosen] = rng.choice(NO_DEPTHS, chosen.sum())
    low, high = float(rng.choice([0.0, 0.5, 2.0])), float(rng.choice([7.0, 50.0]))
    inside = depth[(depth >= low) & (depth <= high) & (depth > 0.0)]
    middle = np.median(inside) if len(inside) else np.nan
    for least, most in [(low, high), (low, middle), (middle, high), (middle + 1e-9, high),
                        *np.sort(rng.uniform(low, high, (4, 2)))]:
        found = median_within(depth, low, high, least, most)
        assert not found or least <= middle <= most
        within = ((depth > 0.0) & (depth >= least) & (depth <= most)).reshape(-1)
        halves = within[:within.size // 2], within[within.size // 2:]
        if all(2 * np.count_nonzero(half) > half.size for half in halves):
            assert found


@given(seeds, st.sampled_from([20.0, 100.0, 900.0]), st.floats(0.05, 2.0))
@examples(max_examples=60)
def test_the_stride_is_that_of_the_whole_images_median(seed, focal, size):
    rng = np.random.default_rng(seed)
    slope = np.linspace(1.0, rng.uniform(1.0, 9.0), 200)[:, None]   # 24 000: read in six goes
    depth = rng.uniform(0.5, 20.0) * slope * rng.uniform(0.9, 1.1, (200, 120))
    depth[rng.random(depth.shape) < rng.uniform(0.0, 0.7)] = rng.choice(NO_DEPTHS)
    frame, settings = frame_of(np.zeros(depth.shape), depth, focal), replace(
        Memory(), stride=0, voxel_size=size)
    assert stride_of(frame, settings) == ref.auto_stride(
        depth, focal, size, settings.min_depth, settings.max_depth)


def test_a_depth_next_to_nothing_leaves_one_pixel():
    frame = frame_of(np.zeros((4, 6)), np.full((4, 6), 1e-320))
    settings = replace(Memory(), stride=0, min_depth=0.0)
    assert thinned(frame, settings).depth.shape == (1, 1)


def test_rays_of_a_camera_are_thinned_once():
    settings = replace(Memory(), stride=2)
    frame = frame_of(np.zeros((4, 6)), np.ones((4, 6)))
    thin = thinned(frame, settings).camera
    assert thinned(replace(frame, depth=2 * frame.depth), settings).camera is thin
    assert thinned(frame, replace(settings, stride=3)).camera.rays.tolist() == \
        frame.camera.rays[::3, ::3].tolist()


@pytest.mark.parametrize('focal, depth, size, stride', [
    (400.0, 60.0, 0.5, 1), (1900.0, 60.0, 0.5, 5), (1900.0, 60.0, 0.1, 1), (300.0, 10.0, 0.1, 1),
    (300.0, 10.0, 0.3, 3), (300.0, np.nan, 0.5, 1)])
def test_auto_leaves_a_voxel_three_pixels(focal, depth, size, stride):
    frame = frame_of(np.zeros((20, 30)), np.full((20, 30), depth), focal)
    settings = replace(Memory(), stride=0, voxel_size=size)
    assert stride_of(frame, settings) == stride
    assert thinned(frame, settings).depth.shape == (-(-20 // stride), -(-30 // stride))


def test_auto_takes_all_points_of_a_cloud():
    frame = replace(frame_of(np.zeros((1, 9)), np.ones((1, 9)), 1e4), points=np.ones((1, 9, 3)))
    assert thinned(frame, replace(Memory(), stride=0)) is frame
    assert thinned(frame, replace(Memory(), stride=2)).points.shape == (1, 5, 3)


def test_weights_and_labels_of_another_size_are_thinned_on_the_grid_of_the_depth():
    labels = np.arange(64).reshape(8, 8)
    frame = replace(frame_of(labels, np.ones((4, 4))), weights=np.uint32(10 * labels))
    thin = thinned(frame, replace(Memory(), stride=2))
    assert thin.labels.tolist() == [[9, 13], [41, 45]]
    assert thin.weights.tolist() == [[90, 130], [410, 450]]
