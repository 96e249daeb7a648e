"""Depth of another camera or of a LiDAR, labelled clouds: points of the right place and class."""

import bags
import numpy as np
from persem_ros.cli import main
from persem_ros.core.frame import images
from persem_ros.core.transforms import inverse, transform
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
import pytest

DOWN = (1.0, 0.0, 0.0, 0.0)                 # image right is east, image up is north
MOUNT = transform((1.5, 0.2, 0.0), DOWN)    # of the label camera on the body
DEPTH_MOUNT = transform((0.0, 0.0, 0.0), DOWN)
K = np.array([[40.0, 0, 31.5], [0, 40.0, 23.5], [0, 0, 1]])
POINT = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'),
                  ('label', '<u2'), ('ring', 'u1')])
EDGE = 0.37             # metres east, where class 1 ends and class 2 begins


def body(i):
    """Return T_map_body of frame i: 10 m up, flying east."""
    return transform((0.2 * i, 0.0, 10.0), (0, 0, 0, 1))


def ground(T_map_camera, shape, K):
    """Return depth (H, W) and east (H, W) of what a camera sees of the flat ground at 0."""
    v, u = np.mgrid[:shape[0], :shape[1]]
    rays = np.dstack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(shape)])
    directions = rays @ T_map_camera[:3, :3].T
    depth = -T_map_camera[2, 3] / directions[..., 2]
    return depth, T_map_camera[0, 3] + directions[..., 0] * depth


def classes(east):
    """Return the class of ground."""
    return np.where(east < EDGE, 1, 2).astype(np.uint16)


def write(path, out_depth, frames=6, labels_info='semantic/camera_info', tied=True):
    """Write labels of a camera 1.5 m ahead of what out_depth(out, i) writes."""
    with RecordingWriter(path) as out:
        for name, mount in (('depth_cam', DEPTH_MOUNT), ('color_cam', MOUNT),
                            ('lidar', np.eye(4)))[:3 if tied else 0]:
            out.tf(bags.stamp(0), 'base_link', name, mount, static=True)
        for i in range(frames):
            at = bags.stamp(i)
            out.pose('odom', at, 'map', body(i), 'Odometry', 'base_link' if tied else '')
            if labels_info:
                out.camera_info(labels_info, at, 'color_cam', 64, 48, K)
            out.image('semantic/image', at, 'color_cam',
                      classes(ground(body(i) @ MOUNT, (48, 64), K)[1]), 'mono16')
            out_depth(out, i)
    return path


def depth_image(out, i):
    """Write the depth of the camera at the body."""
    K2 = np.diag([0.5, 0.5, 1.0]) @ K
    out.camera_info('depth/camera_info', bags.stamp(i), 'depth_cam', 32, 24, K2)
    out.image('depth/image', bags.stamp(i), 'depth_cam',
              ground(body(i) @ DEPTH_MOUNT, (24, 32), K2)[0].astype(np.float32), '32FC1')


def scan(i, part=0.0, seed=0):
    """Return points of the ground around the body at frame i + part, in the LiDAR's frame."""
    rng = np.random.default_rng((seed, i))
    points = np.column_stack([rng.uniform(-6, 9, 3000), rng.uniform(-6, 6, 3000),
                              np.zeros(3000)]) + (0.2 * i, 0, 0)
    T = inverse(body(i + part))
    return points @ T[:3, :3].T + T[:3, 3]


def cloud(points, labels=0):
    """Return a structured array."""
    made = np.zeros(len(points), POINT)
    for axis, name in enumerate('xyz'):
        made[name] = points[:, axis]
    made['label'], made['ring'] = labels, 7
    return made


def frames_of(path, **values):
    """Return the frames of a recording."""
    config = updated(Config(), {'topics.pose': 'odom', **values})
    with Recording(path, config) as recording:
        return list(recording.frames()), config


def places(frame, config):
    """Return counted points in the map (n, 3) and their labels."""
    points, labels = images.points(frame, config.memory)
    good = (labels >= 0) & np.isfinite(points).all(1)
    T = frame.T_map_camera
    return points[good] @ T[:3, :3].T + T[:3, 3], labels[good]


def check_places(frames, config, off, least):
    """Assert that counted points lie on the ground and have its class but within *off* metres."""
    for frame in frames:
        at, labels = places(frame, config)
        assert len(at) >= least and np.abs(at[:, 2]).max() < 1e-3
        sure = np.abs(at[:, 0] - EDGE) > off
        assert sure.sum() > least / 2 and set(labels) == {1, 2}
        np.testing.assert_array_equal(labels[sure], classes(at[sure, 0]))


@pytest.mark.parametrize('info', ['semantic/camera_info', 'semantic/image/camera_info',
                                  'other/camera_info'])
def test_depth_of_another_camera_takes_the_label_where_it_is_seen(tmp_path, info):
    frames, config = frames_of(write(tmp_path / 'bag', depth_image, labels_info=info))
    check_places(frames, config, 0.15, 400)
    assert (frames[0].depth.shape, frames[0].labels.shape) == ((24, 32), (48, 64))
    # Refined labels are those of the label camera's view.
    own = images.on_labels(frames[2], images.on_depth(frames[2], frames[2].labels), 99)
    seen = own != 99
    assert seen.mean() > 0.6 and (own[seen] == frames[2].labels[seen]).mean() > 0.97


def test_without_their_camera_info_labels_of_another_camera_are_refused(tmp_path):
    path = write(tmp_path / 'bag', depth_image, labels_info='')
    for look in (lambda: frames_of(path),
                 lambda: opened(path, updated(Config(), {'topics.pose': 'odom'}))):
        with pytest.raises(PersemError, match='color_cam.*depth_cam.*1.51 m.*labels_info=TOPIC'):
            look()


def test_what_the_label_image_does_not_show_gets_no_label(tmp_path):
    frames, config = frames_of(write(tmp_path / 'bag', depth_image))
    frame = frames[0]
    assert (frame.matching.labels_of == -1).any()       # beside the label image
    assert (images.on_depth(frame, frame.labels)[frame.matching.labels_of == -1] == -1).all()


@pytest.mark.parametrize('part', [0.0, 0.1])
def test_a_lidar_gives_the_depth_of_label_images(tmp_path, part):
    """A scan that came a tenth of a frame later is taken back to the labels' stamp."""
    path = write(tmp_path / 'bag', lambda out, i: out.cloud(
        'livox/points', bags.stamp(i + part), 'lidar', cloud(scan(i, part))))
    frames, config = frames_of(path, **{'depth.source': 'cloud', 'topics.points': 'livox/points'})
    check_places(frames, config, 0.25, 800)
    assert len(frames) == (6 if part == 0 else 5)       # no pose after the last scan
    frame = frames[0]
    assert frame.depth.shape == frame.labels.shape and np.isnan(frame.depth).any()


def test_a_lidar_beside_the_labels_needs_a_tolerance_and_no_offset(tmp_path, capsys):
    """Scans lie 40 ms behind the labels by right: poses take them back, nothing is shifted."""
    path = write(tmp_path / 'bag', lambda out, i: out.cloud(
        'livox/points', bags.stamp(i + 0.4), 'lidar', cloud(scan(i, 0.4))))
    assert main(['info', str(path), '--set', 'topics.pose=odom']) == 1
    assert '--set depth.source=cloud --set topics.points=/livox/points' in capsys.readouterr().out
    settings = {'topics.pose': 'odom', 'depth.source': 'cloud', 'topics.points': 'livox/points'}
    with pytest.raises(PersemError, match='sync.tolerance=0.04') as refused:
        opened(path, updated(Config(), settings))
    assert 'offset_labels' not in str(refused.value)


def test_points_behind_a_surface_are_not_labelled_by_it(tmp_path):
    def wall(out, i):
        roof = scan(i, seed=5) + (0, 0, 4.0)
        out.cloud('points', bags.stamp(i), 'lidar', cloud(np.vstack([scan(i), roof])))

    values = {'depth.source': 'cloud', 'topics.points': 'points'}
    path = write(tmp_path / 'bag', wall)
    share = {}
    for splat in (1, 9):
        frames, config = frames_of(path, **{**values, 'points.splat': splat})
        heights = places(frames[1], config)[0][:, 2]
        share[splat] = np.mean(np.abs(heights) < 0.1)
    assert share[9] < 0.01 < 0.2 < share[1]


@pytest.mark.parametrize('kind', ['<u1', '<u2', '<i4', '<f4', '>u4'])
def test_labelled_clouds_are_points_with_labels(tmp_path, kind):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(4):
            points = scan(i)
            made = cloud(points, classes(points[:, 0] + 0.2 * i))
            made['x'][:3] = np.nan
            made = made.astype([(n, kind if n == 'label' else t) for n, t in POINT.descr
                                ]) if kind[0] == '<' else made
            out.pose('odom', bags.stamp(i), 'map', body(i), 'Odometry', 'lidar')
            out.cloud('points', bags.stamp(i), 'lidar', made)
    frames, config = frames_of(tmp_path / 'bag', **{'topics.points': 'points'})
    assert len(frames) == 4 and not frames[0].has_grid
    for i, frame in enumerate(frames):
        at, labels = places(frame, config)
        assert len(at) == 2997
        np.testing.assert_array_equal(labels, classes(at[:, 0].astype(np.float32)))
    refined = frames[0].cloud.with_labels(np.full(frames[0].labels.shape, 5))
    assert (refined['label'] == 5).all() and (refined['ring'] == 7).all()
    with pytest.raises(PersemError, match='label_field=intensity or label or ring'):
        frames_of(tmp_path / 'bag', **{'topics.points': 'points', 'points.label_field': 'no'})
