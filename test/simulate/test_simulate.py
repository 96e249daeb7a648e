"""The simulated flight: deterministic, consistent, and wrong by as much as it says."""

from dataclasses import replace
import hashlib
import sys

import numpy as np
from persem_ros.cli import main
from persem_ros.core.transforms import inverse
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import messages
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend
from persem_ros.simulate import materials as mat, terrain as land
from persem_ros.simulate.fields import make_field
from persem_ros.simulate.flight import BODY, Flight, MAP, OPTICAL, Plan, START
from persem_ros.simulate.path import make_path
from persem_ros.simulate.render import View
from persem_ros.simulate.segmenter import Mistakes, picture_noise, Segmenter
from persem_ros.simulate.sensor import DepthErrors, measured, PoseErrors, recorded
import pytest
from rosbags.highlevel import AnyReader

PLAN = Plan(frames=12, width=160, height=120, rate=0.5, speed=10.0)   # 20 m from frame to frame


@pytest.fixture(scope='module')
def exact():
    """Return a flight without errors."""
    return Flight(PLAN.without_errors(), workers=1)


@pytest.fixture(scope='module')
def exact_frames(exact):
    return list(exact.frames())


@pytest.fixture(scope='module')
def noisy(exact):
    """Return the same flight with the default errors."""
    return Flight(PLAN, workers=2, world=exact.world)


@pytest.fixture(scope='module')
def noisy_shots(noisy):
    return list(noisy.shots())


def points_of(frame):
    """Return the points of a frame in the map, shape (H, W, 3), metres."""
    rays, d = frame.camera.rays, frame.depth
    local = np.stack([rays[..., 0] * d, rays[..., 1] * d, d], -1)
    return local @ frame.T_map_camera[:3, :3].T + frame.T_map_camera[:3, 3]


def test_legend_and_materials_agree():
    legend = load_legend('town')
    for name in ('grass', 'field', 'road', 'pavement', 'building', 'tree', 'shrub', 'water',
                 'fence', 'vehicle'):
        assert legend.name(getattr(mat, name.upper())) == name
    assert legend.dynamic == (mat.VEHICLE,) and legend.ignored == (mat.VOID,)


def test_a_shot_depends_neither_on_the_workers_nor_on_the_order(noisy, noisy_shots):
    for i in (7, 0, 3):
        shot = noisy.shot(i)
        for name in ('labels', 'truth', 'color'):
            np.testing.assert_array_equal(getattr(shot, name), getattr(noisy_shots[i], name))
        np.testing.assert_array_equal(shot.depth, noisy_shots[i].depth)


def test_other_seed_other_flight(noisy_shots):
    other = Flight(replace(PLAN, seed=1, frames=1)).shot(0)
    assert (other.labels != noisy_shots[0].labels).mean() > 0.1
    assert (other.color != noisy_shots[0].color).mean() > 0.5


def test_same_seed_same_bytes(exact, tmp_path):
    # Two worlds, each made of the seed: the command's, and that of the tests.
    assert main(['simulate', str(tmp_path / 'a' / 'flight'), '--frames', '2', '--size',
                 '64x48']) == 0
    with RecordingWriter(tmp_path / 'b' / 'flight') as out:
        Flight(Plan(frames=2, width=64, height=48), world=exact.world).record(out)
    digests = [[hashlib.sha256(path.read_bytes()).hexdigest()
                for path in sorted((tmp_path / name / 'flight').iterdir())] for name in 'ab']
    assert len(digests[0]) == 2 and digests[0] == digests[1]


def test_reprojection_error_is_below_a_centimetre(exact, exact_frames):
    """A point seen in one frame is where the ray of another frame towards it meets the world."""
    compared = 0
    for here, there in zip(exact_frames[:-1:2], exact_frames[1::2]):
        points = points_of(here)[np.isfinite(here.depth) & (here.truth != mat.VEHICLE)][::7]
        local = (points - there.T_map_camera[:3, 3]) @ there.T_map_camera[:3, :3]
        K = there.camera.K
        u, v = (local[:, :2] / local[:, 2:] * (K[0, 0], K[1, 1]) + K[:2, 2]).T
        seen = (local[:, 2] > 1) & (u > 0) & (v > 0) & (u < PLAN.width - 1) & (v < PLAN.height - 1)
        points, local = points[seen], local[seen]
        origin = there.T_map_camera[:3, 3]
        hit, ray, _ = exact.world.scene.caster.intersects_location(
            np.broadcast_to(origin, points.shape), points - origin, multiple_hits=False)
        error = np.linalg.norm(hit - origin, axis=1) \
            - np.linalg.norm(points[ray] - origin, axis=1)
        assert error.max() < 0.01           # never beyond the point
        visible = error > -0.3              # else something stands in between
        assert visible.mean() > 0.6 and np.abs(error[visible]).mean() < 0.01
        assert np.median(np.abs(error[visible])) < 0.002
        compared += visible.sum()
    assert compared > 2000


def test_water_is_level(exact_frames):
    for frame in exact_frames:
        z = points_of(frame)[frame.truth == mat.WATER][:, 2]
        if len(z):
            np.testing.assert_allclose(z, land.WATER_LEVEL, atol=0.01)
    assert any((frame.truth == mat.WATER).any() for frame in exact_frames)


def test_labels_agree_with_the_geometry(exact, exact_frames):
    terrain = exact.world.terrain
    seen = set()
    for frame in exact_frames:
        inside = np.isfinite(frame.depth)
        points, truth = points_of(frame)[inside], frame.truth[inside]
        seen |= set(np.unique(truth).tolist())
        inside = (np.abs(points[:, 0]) < land.HALF_X - 1) & (np.abs(points[:, 1])
                                                             < land.HALF_Y - 1)
        points, truth = points[inside], truth[inside]
        above = points[:, 2] - terrain.height(points[:, 0], points[:, 1])
        ground = mat.CLASS[terrain.material(points[:, 0], points[:, 1])]
        flat = np.isin(truth, (mat.GRASS, mat.FIELD, mat.PAVEMENT, mat.WATER))
        assert np.abs(above[flat]).max() < 0.35         # the mesh has 2 m, the banks are round
        assert (ground[flat] == truth[flat]).mean() > 0.999     # cells of 0.2 m, float32 points
        road = truth == mat.ROAD
        bridge = (np.abs(points[:, 0] - land.river(points[:, 1])) < 20) \
            & (np.abs(points[:, 1]) < 8)
        assert (ground[road & ~bridge] == mat.ROAD).mean() > 0.999
        for label in (mat.BUILDING, mat.TREE):
            assert (above[truth == label] > -0.6).all()
    assert seen >= {mat.GRASS, mat.FIELD, mat.ROAD, mat.PAVEMENT, mat.BUILDING, mat.TREE,
                    mat.WATER, mat.VEHICLE}


def test_rays_that_hit_a_building_are_labelled_building(exact, exact_frames):
    """The face nearest to a pixel's point, found by another cast, has the pixel's class."""
    scene = exact.world.scene
    frame = next(f for f in exact_frames if (f.truth == mat.BUILDING).mean() > 0.05)
    for label in (mat.BUILDING, mat.TREE):
        points = points_of(frame)[frame.truth == label][::5]
        toward = points - frame.T_map_camera[:3, 3]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        face = scene.caster.intersects_first(points - toward, toward)     # from 1 m before it
        classes = np.append(mat.CLASS, 0)[scene.material[face]]
        assert (classes == label).mean() > 0.98


def test_body_poses_and_extrinsic_give_the_camera(exact):
    for stamp in exact.stamps:
        true = exact.body(stamp) @ exact.T_body_camera
        error = inverse(true) @ exact.recorded_camera(stamp)
        assert np.abs(error[:3, 3]).max() < 1e-3
        assert np.abs(error[:3, :3] - np.eye(3)).max() < 1e-4
    assert not set(exact.stamps) & set(exact.pose_stamps)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recording_gives_the_frames_of_the_flight(tmp_path, noisy, storage):
    with RecordingWriter(tmp_path / 'flight', storage) as writer:
        noisy.record(writer)
    with Recording(tmp_path / 'flight', Config()) as recording:
        frames = list(recording.frames(truth=True, color=True))
        legend = Legend.from_yaml(recording.legend_text)
    assert legend == load_legend('town')
    assert len(frames) == PLAN.frames
    for got, expected in zip(frames, noisy.frames()):
        assert got.stamp == expected.stamp and got.frame_id == OPTICAL
        known = expected.truth >= 0
        np.testing.assert_array_equal(got.labels[known], expected.labels[known])
        np.testing.assert_array_equal(got.truth[known], expected.truth[known])
        np.testing.assert_array_equal(got.depth, expected.depth)
        np.testing.assert_array_equal(got.color, expected.color)
        np.testing.assert_allclose(got.camera.rays, expected.camera.rays, atol=1e-12)
        np.testing.assert_allclose(got.T_map_camera, expected.T_map_camera, atol=1e-9)


def test_the_camera_is_mounted_as_said(exact):
    T = exact.T_body_camera
    down = np.degrees(np.arcsin(-T[2, 2]))      # the optical axis, z forward
    assert down == pytest.approx(PLAN.tilt) and abs(T[1, 2]) < 1e-12
    np.testing.assert_allclose(T[:3, 0], (0, -1, 0), atol=1e-12)    # image right is body right
    assert (BODY, MAP) == ('base_link', 'map')


def test_traffic_moves(exact):
    world = exact.world
    x, y, yaw = world.fleet.at(3.0)
    ahead = np.array(world.fleet.at(3.5)[:2]) - (x, y)
    speed = np.hypot(*ahead) / 0.5
    assert len(x) > 20 and np.median(speed) == pytest.approx(9, abs=2)
    forward = (ahead * (np.cos(yaw), np.sin(yaw))).sum(axis=0) / np.hypot(*ahead)
    assert (forward > 0.98).mean() > 0.9        # some turn at the end of their street
    road = mat.CLASS[world.terrain.material(x, y)] == mat.ROAD
    assert (road | (np.abs(x - land.river(y)) < 20)).all()
    corners = world.traffic(3.0).origins
    height = corners[:, 2] - world.deck(corners[:, 0], corners[:, 1])
    assert -0.5 < height.min() and height.max() < 4.0


def test_path_is_smooth_and_comes_back():
    path = make_path(np.random.default_rng(0), 200.0, 60.0, 6.0)
    time = np.arange(0, 200, 0.1)
    position = np.array([path.body(t)[:3, 3] for t in time])
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / 0.1
    assert 4.5 < speed.min() and speed.max() < 7.0
    acceleration = np.linalg.norm(np.diff(position, 2, axis=0), axis=1) / 0.01
    assert acceleration.max() < 4.0
    turn = [path.body(a)[:3, :3].T @ path.body(a + 0.1)[:3, :3] for a in time[:-1]]
    rate = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))) / .1
    assert rate.max() < 45.0
    late = position[time > 120]
    nearest = np.linalg.norm(late[:, None] - position[None, time < 60], axis=-1).min(axis=1)
    assert (nearest < 3.0).mean() > 0.3


def test_field_statistics():
    """Mean 0, variance 1 and the stated correlation, over many draws."""
    here = np.zeros((1, 3), np.float32)
    there = np.array([[4.0, 0, 0]], np.float32)
    draws = []
    for seed in range(600):
        field = make_field(np.random.default_rng(seed), [4.0, 8.0, 8.0])
        draws.append((field(here)[0], field(there)[0]))
    a, b = np.array(draws).T
    assert abs(a.mean()) < 0.12 and a.var() == pytest.approx(1.0, abs=0.15)
    assert np.mean(a * b) == pytest.approx(np.exp(-0.5), abs=0.1)


def test_picture_noise_statistics():
    noise = np.stack([picture_noise(np.random.default_rng(seed), 240, 320, 0.05)
                      for seed in range(40)])
    assert noise.shape == (40, 240, 320) and noise.dtype == np.float32
    assert abs(noise.mean()) < 0.05 and noise.var() == pytest.approx(1.0, abs=0.12)
    correlation = np.mean(noise[..., :-16] * noise[..., 16:])      # 16 pixels are 0.05
    assert correlation == pytest.approx(np.exp(-0.5), abs=0.08)


def test_default_mistakes(noisy_shots):
    """About three quarters of the pixels are right; mistakes are what the table says."""
    labels = np.stack([shot.labels for shot in noisy_shots])
    truth = np.stack([shot.truth for shot in noisy_shots])
    right = (labels == truth)[truth != mat.VOID].mean()
    assert 0.70 < right < 0.84
    assert (labels[truth == mat.GRASS] == mat.FIELD).mean() > 0.02


def plane(distance=75.0, label=mat.GRASS, shape=(120, 160), shift=0.0):
    """Return the View of a plane seen at a right angle, pixels 0.5 m apart."""
    y, x = np.mgrid[:shape[0], :shape[1]].astype(np.float32) / 2
    points = np.stack([x + shift, y, np.zeros_like(x)], -1)
    return View(np.full(shape, distance), np.full(shape, label, np.uint8), points,
                np.ones(shape, np.float32), np.zeros((*shape, 3), np.uint8))


def test_share_of_mistakes_is_the_stated_one():
    """At DISTANCE, at a right angle, without borders and salt: 19 % of the grass."""
    only = Mistakes(far=0.0, salt=0.0, border=0.0)
    wrong = []
    for seed in range(30):
        segmenter = Segmenter(np.random.default_rng(seed), only)
        labels = segmenter.labels(plane(), (40, 30, 75), np.random.default_rng(seed + 100))
        wrong.append((labels != mat.GRASS).mean())
    assert np.mean(wrong) == pytest.approx(0.19, abs=0.04)


def test_difficulty_scales_mistakes():
    wrong = []
    for difficulty in (0.0, 0.5, 1.0, 1.6):
        segmenter = Segmenter(np.random.default_rng(5), Mistakes(difficulty=difficulty))
        labels = segmenter.labels(plane(), (40, 30, 75), np.random.default_rng(6))
        wrong.append((labels != mat.GRASS).mean())
    assert wrong[0] == 0 and wrong == sorted(wrong) and wrong[3] > 1.3 * wrong[2] > 0


def test_mistakes_are_anchored_and_come_and_go():
    """The same ground from the same place, from another side and from far away."""
    segmenter = Segmenter(np.random.default_rng(1), Mistakes(salt=0.0, border=0.0))

    def wrong(origin, seed):
        return segmenter.labels(plane(), origin, np.random.default_rng(seed)) != mat.GRASS

    first, again = wrong((40, 30, 75), 1), wrong((40, 30, 75), 2)
    aside = wrong((110, 30, 75), 3)
    both, apart = (first & again).mean(), (first & aside).mean()
    chance = first.mean() * aside.mean()
    assert apart > 2.5 * chance             # a part is wrong from everywhere
    assert both > apart                     # a part depends on the view
    assert (first ^ again).mean() > 0.01    # and a part is new in every frame


def test_borders_shift_and_salt_falls():
    view = plane()
    view.labels[:, 80:] = mat.WATER
    segmenter = Segmenter(np.random.default_rng(1), Mistakes(difficulty=0.001, border=10.0,
                                                             salt=0.0))
    labels = segmenter.labels(view, (40, 30, 75), np.random.default_rng(1))
    edge = (labels == mat.WATER).argmax(axis=1)
    assert 0.6 < edge.std() < 5 and abs(edge.mean() - 80) < 3
    salted = Segmenter(np.random.default_rng(1), Mistakes(difficulty=0.001, border=0.0,
                                                          salt=20.0))
    labels = salted.labels(plane(shape=(240, 320)), (40, 30, 75), np.random.default_rng(1))
    assert (labels != mat.GRASS).mean() == pytest.approx(0.02 * 0.9, abs=0.004)


def test_depth_noise_and_holes():
    view = plane(80.0, shape=(240, 320))
    errors = DepthErrors()
    depth = measured(view, errors, np.random.default_rng(0))
    error = depth[np.isfinite(depth)] - 80
    assert error.std() == pytest.approx(errors.floor + errors.square * 80 ** 2, rel=0.1)
    assert abs(error.mean()) < 0.02
    assert np.isnan(depth).mean() == pytest.approx(errors.patches, abs=0.01)
    view.depth[:, 160:] = 60.0
    lost = np.isnan(measured(view, errors, np.random.default_rng(1)))
    assert lost[:, 159:161].mean() == pytest.approx(errors.edge, abs=0.1)
    assert lost[:, :150].mean() < 0.03
    view.labels[:] = mat.WATER
    assert np.isnan(measured(view, errors, np.random.default_rng(1)))[:, :150].mean() > 0.2


def test_depth_is_exact_without_errors_and_ends_at_the_range():
    view = plane(80.0)
    view.depth[0] = 181.0
    view.depth[1] = np.inf
    depth = measured(view, DepthErrors(scale=0.0), np.random.default_rng(0))
    assert np.isnan(depth[:2]).all() and (depth[2:] == np.float32(80)).all()


def test_pose_errors():
    poses = [np.eye(4) for _ in range(4000)]
    for i, T in enumerate(poses):
        T[0, 3] = i * 0.05                  # 200 m
    noisy_poses = recorded(poses, PoseErrors(noise=0.2, attitude=1.0), np.random.default_rng(0))
    shift = np.array([a[:3, 3] - b[:3, 3] for a, b in zip(noisy_poses, poses)])
    assert shift.std() == pytest.approx(0.2, rel=0.05)
    yaw = np.degrees([np.arctan2(T[1, 0], T[0, 0]) for T in noisy_poses])
    assert yaw.std() == pytest.approx(1.0, rel=0.1)
    ends = [recorded(poses[::40], PoseErrors(drift=1.0), np.random.default_rng(seed))[-1][:3, 3]
            - poses[3960][:3, 3] for seed in range(200)]
    assert np.std(ends) == pytest.approx(np.sqrt(1.98), rel=0.15)
    assert all((a == b).all() for a, b in zip(recorded(poses, PoseErrors(), None or
                                                       np.random.default_rng(0)), poses))


def test_exact_flight_has_no_errors(exact_frames):
    for frame in exact_frames:
        np.testing.assert_array_equal(frame.labels, frame.truth)
        assert np.isfinite(frame.depth).mean() > 0.95


def test_color_looks_like_a_photograph(exact_frames):
    """Classes differ in colour, the picture is neither dark nor burnt out."""
    color = np.concatenate([frame.color.reshape(-1, 3) for frame in exact_frames]).astype(float)
    truth = np.concatenate([frame.truth.ravel() for frame in exact_frames])
    assert 60 < color.mean() < 170 and (color > 250).mean() < 0.02 and color.std() > 30
    tree, road = color[truth == mat.TREE].mean(0), color[truth == mat.ROAD].mean(0)
    assert tree[1] > tree[0] and tree[1] > tree[2]          # green
    assert np.ptp(road) < 25                                # grey


@pytest.mark.parametrize('option, value, expected', [
    ('--frames', '0', 'frames: expected 1 to'), ('--size', '8x8', 'width: expected 32 to'),
    ('--height', '3', 'height of flight'), ('--voxel-scale', '50', 'height of flight'),
    ('--rate', 'nan', 'rate: expected'), ('--difficulty', '-1', 'difficulty: expected 0 to'),
    ('--seed', '-1', 'seed: expected 0 to')])
def test_command_refuses(tmp_path, capsys, option, value, expected):
    assert main(['simulate', str(tmp_path / 'out'), option, value]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and expected in lines[0]
    assert not list(tmp_path.iterdir())


def test_command_refuses_a_folder_in_the_way(tmp_path, capsys):
    (tmp_path / 'precious.txt').write_text('mine', encoding='utf-8')
    assert main(['simulate', str(tmp_path)]) == 1
    assert 'not empty' in capsys.readouterr().err


def test_command_says_what_is_not_installed(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'persem_ros.simulate.flight', None)
    assert main(['simulate', str(tmp_path / 'out')]) == 1
    assert 'pip install trimesh embreex' in capsys.readouterr().err


@pytest.mark.parametrize('size', ['640', '640x', 'ax4', '-1x5'])
def test_command_usage(tmp_path, size):
    assert main(['simulate', str(tmp_path / 'out'), f'--size={size}']) == 2


def test_plan_refused_without_the_command():
    with pytest.raises(PersemError, match='tilt: expected 25 to 90 degrees, got 5'):
        Flight(replace(PLAN, tilt=5))


def test_a_loop_that_is_closed(exact):
    """Poses begin right, drift smoothly, and what comes at the end is the true path."""
    poses = [exact.body(stamp) for stamp in exact.pose_stamps[:6000:10]]
    drifted = recorded(poses, PoseErrors(odometry=1.0), np.random.default_rng(0))
    away = np.stack(drifted)[:, :3, 3] - np.stack(poses)[:, :3, 3]
    assert (away[0] == 0).all() and 1.0 < np.linalg.norm(away[-1]) < 30.0
    steps = np.diff(away, axis=0)
    assert np.linalg.norm(np.diff(steps, axis=0), axis=1).max() < 0.02      # no jumps, no noise
    twice = recorded(poses, PoseErrors(odometry=2.0), np.random.default_rng(0))
    assert np.linalg.norm(twice[-1][:3, 3] - poses[-1][:3, 3]) > np.linalg.norm(away[-1])


def test_the_recording_of_a_loop(exact, tmp_path):
    flight = Flight(replace(PLAN, frames=3, width=32, height=32,
                            pose_errors=PoseErrors(odometry=1.0)), world=exact.world)
    with RecordingWriter(tmp_path / 'loop') as out:
        flight.record(out)
    with AnyReader([tmp_path / 'loop']) as reader:
        found = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in
                 reader.messages() if c.topic in ('/corrected_path', '/true_pose')]
    assert [topic for topic, *_ in found] == ['/true_pose'] * 3 + ['/corrected_path']
    path = found[-1][2]
    for pose, stamp, (_, _, true) in zip(path.poses, flight.stamps, found):
        assert messages.stamp_ns(pose) == messages.stamp_ns(true) == stamp
        x = pose.pose.position
        assert np.allclose([x.x, x.y], [true.pose.pose.position.x, true.pose.pose.position.y])
    assert path.header.frame_id == 'map' and len(path.poses) == 3


def test_options_reach_the_plan():
    from persem_ros.cli import _parser
    from persem_ros.commands.simulate import plan_of
    words = ['simulate', 'out', '--size', '64x32', '--height', '70', '--difficulty', '1.5',
             '--depth-noise', '2', '--pose-noise', '.1', '--attitude-noise', '.2',
             '--pose-drift', '.3', '--loop-closure', '--tilt', '80', '--fov', '60', '--seed', '4']
    plan = plan_of(_parser(words).parse_args(words))
    assert (plan.width, plan.height, plan.altitude, plan.tilt, plan.field_of_view, plan.seed) \
        == (64, 32, 70.0, 80.0, 60.0, 4)
    assert plan.mistakes.difficulty == 1.5 and plan.depth_errors.scale == 2.0
    assert plan.pose_errors == PoseErrors(0.1, 0.2, 0.3, 1.0)
    words.append('--no-noise')
    assert plan_of(_parser(words).parse_args(words)) == plan.without_errors()
    assert START == 1_700_000_000_000_000_000


def test_help_shows_the_defaults(capsys):
    assert main(['simulate', '--help']) == 0
    text = ' '.join(capsys.readouterr().out.split())
    plan = Plan()
    for words in (
            f'--frames N images (default: {plan.frames})',
            f'--rate HZ images per second (default: {plan.rate:g})',
            f'--height M height of flight (default: {plan.altitude:g})',
            f'--tilt DEG how far the camera looks below the horizon; 90: straight down (default: '
            f'{plan.tilt:g})',
            f'0: exact (default: {plan.depth_errors.scale:g})',
            f'--size WxH of the images, in pixels (default: {plan.width}x{plan.height})',
            'storage of the recording (default: mcap)'):
        assert words in text
    assert text.count('(default: ') == 16
