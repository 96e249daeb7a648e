"""persem convert frames: layouts, units, stamps, conventions, refusals."""

import logging
from pathlib import Path
import re

import cv2
import numpy as np
from persem_ros.convert import stamps, units
from persem_ros.convert.checks import check_up
from persem_ros.convert.files import files_of
from persem_ros.convert.frames.convert import convert_frames
from persem_ros.convert.frames.layout import FramesOptions
from persem_ros.convert.images import nearest, parse_unit, read_depth, scaled_K
from persem_ros.convert.intrinsics import read_intrinsics
from persem_ros.convert.poses import pose_of_numbers
from persem_ros.convert.trajectories import poses_from_trajectory
from persem_ros.core import agreement
from persem_ros.core.transforms import (
    inverse, matrix_to_quaternion, quaternion_to_matrix, transform)
from persem_ros.errors import PersemError
from persem_ros.settings.legend_files import load_legend
import pytest
from rosbags.highlevel import AnyReader

WIDTH, HEIGHT, FOCAL = 64, 48, 40.0
K = np.array([[FOCAL, 0, 31.5], [0, FOCAL, 23.5], [0, 0, 1]])
FRD = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


def read(path):
    """Return {topic: [(stamp, message)]} of a recording, by header stamp where there is one."""
    result = {}
    with AnyReader([Path(path)]) as reader:
        for connection, log_time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = log_time
            if hasattr(message, 'header'):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                assert stamp == log_time
            result.setdefault(connection.topic, []).append((stamp, message))
    return result


def pixels(message):
    """Return the array of a sensor_msgs/Image."""
    dtype = {'mono8': 'u1', 'mono16': 'u2', '16UC1': 'u2', '32SC1': 'i4', '32FC1': 'f4',
             'bgr8': 'u1'}[message.encoding]
    array = message.data.view(dtype)
    return array.reshape(message.height, message.width, -1).squeeze()


def matrix(pose):
    """Return the 4x4 matrix of a geometry_msgs/Pose."""
    p, q = pose.position, pose.orientation
    return transform([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def place(i):
    """Return T_map_camera of frame i: a walk and a turn through a room."""
    a = 0.11 * i
    q = np.array([np.sin(0.1 * a), np.sin(a / 2), 0.2 * np.sin(a), np.cos(a / 2)])
    return transform([0.1 * i - 0.5, 0.05 * i, 0.4 * np.sin(a)], q / np.linalg.norm(q))


def room(T, size=(WIDTH, HEIGHT)):
    """Return the depth (metres) and the wall (1 .. 6) that a camera in a box sees."""
    u, v = np.meshgrid((np.arange(size[0]) - K[0, 2]) / FOCAL,
                       (np.arange(size[1]) - K[1, 2]) / FOCAL)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ T[:3, :3].T
    half = np.array([4.0, 2.5, 5.0])
    with np.errstate(divide='ignore'):
        t = (np.where(rays > 0, half, -half) - T[:3, 3]) / rays
    wall = t.argmin(-1)
    positive = np.take_along_axis(rays, wall[..., None], -1)[..., 0] > 0
    return t.min(-1), (1 + 2 * wall + positive).astype(np.uint8)


@pytest.fixture
def seven(tmp_path):
    """Return a 7-Scenes folder of 12 frames, every fifth of the original."""
    folder = tmp_path / 'seven'
    folder.mkdir()
    np.savetxt(folder / 'camera-intrinsics.txt', K)
    for i in range(12):
        depth, wall = room(place(i))
        name = str(folder / f'frame-{5 * i:06d}')
        millimetres = np.rint(depth * 1000).astype(np.uint16)
        millimetres[0, 0], millimetres[0, 1] = 65535, 0
        cv2.imwrite(f'{name}.depth.png', millimetres)
        cv2.imwrite(f'{name}.label.png', wall)
        cv2.imwrite(f'{name}.truth.png', 7 - wall)
        cv2.imwrite(f'{name}.color.jpg', np.full((HEIGHT // 2, WIDTH // 2, 3), 10 * i, np.uint8))
        np.savetxt(f'{name}.pose.txt', place(i))
    return folder


def rewrite(folder, change):
    """Replace every pose of a 7-Scenes folder by change(pose)."""
    for i in range(12):
        np.savetxt(folder / f'frame-{5 * i:06d}.pose.txt', change(place(i)))


def refusal(folder, tmp_path, text, **options):
    """Check that a conversion is refused with *text*, in one line, and leaves nothing."""
    with pytest.raises(PersemError, match=text) as error:
        convert_frames(folder, tmp_path / 'out', FramesOptions(**options))
    assert '\n' not in str(error.value)
    assert not (tmp_path / 'out').exists()
    assert not list(tmp_path.glob('.out*'))


def test_seven_scenes_without_flags(seven, tmp_path):
    summary = convert_frames(seven, tmp_path / 'out', legend=load_legend('town'))
    assert '12 labels' in summary and '12 poses' in summary
    topics = read(tmp_path / 'out')
    assert set(topics) == {
        '/semantic/image', '/semantic/truth', '/semantic/legend', '/depth/image',
        '/depth/camera_info', '/color/image', '/pose', '/tf'}
    expected = [10**9 + round(5 * i * 1e9 / 30) for i in range(12)]
    for topic in set(topics) - {'/semantic/legend', '/tf'}:
        assert [stamp for stamp, _ in topics[topic]] == expected, topic
    for i in range(12):
        depth, wall = room(place(i))
        stored = pixels(topics['/depth/image'][i][1])
        assert topics['/depth/image'][i][1].encoding == '16UC1'
        assert stored[0, 0] == 0 and stored[0, 1] == 0
        assert np.abs(stored / 1000.0 - depth).ravel()[2:].max() <= 0.00051
        np.testing.assert_array_equal(pixels(topics['/semantic/image'][i][1]), wall)
        np.testing.assert_array_equal(pixels(topics['/semantic/truth'][i][1]), 7 - wall)
        assert np.allclose(matrix(topics['/pose'][i][1].pose), place(i), atol=1e-9)
    info = topics['/depth/camera_info'][0][1]
    assert (info.width, info.height, info.k.tolist()) == (WIDTH, HEIGHT, K.ravel().tolist())
    image, pose, tf = (topics[t][3][1] for t in ('/semantic/image', '/pose', '/tf'))
    assert image.header.frame_id == info.header.frame_id == tf.transforms[0].child_frame_id
    assert pose.header.frame_id == tf.transforms[0].header.frame_id == 'map'
    assert topics['/color/image'][3][1].height == HEIGHT // 2
    assert load_legend('town').to_yaml() == topics['/semantic/legend'][0][1].data


def test_poses_come_before_what_they_place(seven, tmp_path):
    """A recording that breaks off keeps the pose of every image that it kept."""
    convert_frames(seven, tmp_path / 'out', storage='sqlite3')
    import sqlite3
    with sqlite3.connect(next((tmp_path / 'out').glob('*.db3'))) as database:
        rows = database.execute('SELECT name, timestamp FROM messages JOIN topics ON '
                                'topics.id = topic_id ORDER BY messages.id').fetchall()
    database.close()
    posed = set()
    for topic, stamp in rows:
        if topic == '/pose':
            posed.add(stamp)
        elif topic != '/tf':
            assert stamp in posed


def tum(tmp_path, unit=5000):
    """Return a TUM folder: images with stamps of their own, poses at 50 Hz."""
    folder = tmp_path / 'tum'
    for name in ('depth', 'rgb', 'labels'):
        (folder / name).mkdir(parents=True)
    begin = 1305031102_160407000
    for i in range(8):
        depth, wall = room(place(i))
        label_stamp, depth_stamp = begin + i * 10**8, begin + i * 10**8 - 7_000_000
        text = f'{label_stamp // 10**9}.{label_stamp % 10**9 // 1000:06d}'
        cv2.imwrite(str(folder / f'labels/{text}.png'), wall)
        cv2.imwrite(str(folder / f'rgb/{text}.png'), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        text = f'{depth_stamp // 10**9}.{depth_stamp % 10**9 // 1000:06d}'
        cv2.imwrite(str(folder / f'depth/{text}.png'), np.rint(depth * unit).astype(np.uint16))
    lines = ['# timestamp tx ty tz qx qy qz qw']
    for j in range(-5, 40):
        T = place(j / 5)
        stamp = begin + j * 20_000_000
        lines.append(f'{stamp // 10**9}.{stamp % 10**9:09d} '
                     + ' '.join(f'{v:.9f}' for v in (*T[:3, 3], *matrix_to_quaternion(T[:3, :3]))))
    (folder / 'groundtruth.txt').write_text('\n'.join(lines))
    (folder / 'camera.txt').write_text(f'# fx fy cx cy\n{FOCAL} {FOCAL} 31.5 23.5\n')
    return folder, begin


def test_tum_with_clocks_of_their_own(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    folder, begin = tum(tmp_path)
    convert_frames(folder, tmp_path / 'out')
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/semantic/image']] == [begin + i * 10**8 for i in range(8)]
    assert [s for s, _ in topics['/depth/image']] == [begin + i * 10**8 - 7_000_000
                                                      for i in range(8)]
    assert len(topics['/pose']) == 45       # every pose, at its own stamp: a replay interpolates
    assert [s for s, _ in topics['/pose']][0] == begin - 100_000_000
    depth = topics['/depth/image'][2][1]
    assert depth.encoding == '32FC1'
    assert np.abs(pixels(depth) - room(place(2))[0]).max() < 2e-4
    assert 'agree' in caplog.text and '5000' in caplog.text


def test_a_frame_beyond_the_trajectory_or_the_tolerance_is_left_out(tmp_path, caplog):
    folder, begin = tum(tmp_path)
    lines = (folder / 'groundtruth.txt').read_text().splitlines()
    (folder / 'groundtruth.txt').write_text('\n'.join(lines[:32]))
    first = sorted((folder / 'depth').iterdir())[0]
    first.rename(first.with_name(f'{(begin - 21_000_000) / 1e9:.6f}.png'))
    convert_frames(folder, tmp_path / 'out')
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/semantic/image']] == [begin + i * 10**8 for i in range(1, 6)]
    assert '1 frames left out: without depth' in caplog.text
    assert '2 frames left out: without a pose' in caplog.text


@pytest.mark.parametrize('direction, name, world', [
    ('camera-to-world', 'opengl', 'enu'), ('camera-to-world', 'ned', 'enu'),
    ('world-to-camera', 'opencv', 'enu'), ('world-to-camera', 'opengl', 'ned'),
    ('world-to-camera', 'ned', 'ned')])
def test_conventions_come_out_as_the_same_poses(seven, tmp_path, direction, name, world):
    """Poses written in another convention, by hand, and read with its flags are the same."""
    def change(T):
        result = T.copy()
        if name != 'opencv':        # columns: the file's camera axes in the world
            right, down, forward = T[:3, :3].T
            result[:3, :3] = np.column_stack(
                [right, -down, -forward] if name == 'opengl' else [forward, right, down])
        if world == 'ned':          # rows: east, north, up to north, east, down
            result = np.array([result[1], result[0], -result[2], result[3]])
        return np.linalg.inv(result) if direction == 'world-to-camera' else result

    rewrite(seven, change)
    convert_frames(seven, tmp_path / 'out', FramesOptions(direction=direction, axes=name,
                                                          world=world))
    for i, (_, pose) in enumerate(read(tmp_path / 'out')['/pose']):
        assert np.allclose(matrix(pose.pose), place(i), atol=1e-9)


@pytest.mark.parametrize('change, flags', [
    (lambda T: T @ np.diag([1.0, -1, -1, 1]), ['--axes opengl']),
    (np.linalg.inv, ['--pose-is world-to-camera']),
    (lambda T: np.linalg.inv(T @ np.diag([1.0, -1, -1, 1])),
     ['--pose-is world-to-camera', '--axes opengl']),
    (lambda T: T @ np.block([[FRD.T, np.zeros((3, 1))], [np.zeros(3), 1]]), ['--axes ned'])])
def test_wrong_axes_are_noticed_and_the_flag_is_named(seven, tmp_path, caplog, change, flags):
    rewrite(seven, change)
    convert_frames(seven, tmp_path / 'out')
    warning, = (r.getMessage() for r in caplog.records if r.levelno == logging.WARNING)
    assert 'the camera axes look wrong' in warning
    assert warning.endswith(' '.join(flags))


def test_right_axes_are_not_warned_about(seven, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    convert_frames(seven, tmp_path / 'out', FramesOptions(world='opencv'))
    assert 'the camera axes agree' in caplog.text
    assert not [r for r in caplog.records if r.levelno >= logging.WARNING]
    caplog.clear()
    convert_frames(seven, tmp_path / 'two', FramesOptions(check=False))
    assert 'axes' not in caplog.text


def test_a_camera_that_stands_still_tells_nothing(seven, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    depth = cv2.imread(str(seven / 'frame-000000.depth.png'), -1)
    for i in range(12):
        cv2.imwrite(str(seven / f'frame-{5 * i:06d}.depth.png'), depth)
    rewrite(seven, lambda T: place(0))
    convert_frames(seven, tmp_path / 'out')
    assert 'cannot be told from the motion' in caplog.text


def test_depth_that_fits_nothing_is_warned_about(seven, tmp_path, caplog):
    rng = np.random.default_rng(0)
    for i in range(12):
        noise = rng.integers(500, 9000, (HEIGHT, WIDTH)).astype(np.uint16)
        cv2.imwrite(str(seven / f'frame-{5 * i:06d}.depth.png'), noise)
    convert_frames(seven, tmp_path / 'out')
    assert 'do not agree with each other under any camera axes' in caplog.text


@pytest.mark.parametrize('unit', ['m', 'cm', '10000', '100000', '1000000'])
def test_a_wrong_depth_unit_is_noticed_and_the_right_one_named(seven, tmp_path, caplog, unit):
    """Ten and more times too far, where little moves, and too near, where all leaves the image."""
    convert_frames(seven, tmp_path / 'out', FramesOptions(depth_unit=unit, world='opencv'))
    warning, = (r.getMessage() for r in caplog.records if r.levelno == logging.WARNING)
    assert re.fullmatch(r'the depth unit looks wrong: depth of one frame meets that of another '
                        r'(nowhere )?within \d+\.\d %, but within \d\.\d % with --depth-unit mm',
                        warning)
    before, after = map(float, re.findall(r'([0-9.]+) %', warning))
    assert after < 0.8 * before


@pytest.mark.parametrize('factor, name', [(100.0, 'cm'), (1.0, 'm'), (5000.0, '5000')])
def test_the_better_unit_has_its_name(factor, name, caplog):
    poses = {i: place(i) for i in range(12)}
    depths = {i: 10 * room(T)[0] for i, T in poses.items()}
    assert units.check_unit(depths, poses, K, factor / 10)[0] == 0.1
    assert caplog.text.rstrip().endswith(f'--depth-unit {name}')


def test_a_unit_that_the_motion_does_not_tell_is_not_warned_about(caplog):
    """A flat wall that the camera moves along, a camera that turns, a single frame, nothing."""
    flat = {i: np.full((HEIGHT, WIDTH), 20.0) for i in range(12)}
    along = {i: transform([0.8 * i, 0, 0], [0, 0, 0, 1]) for i in range(12)}
    assert units.check_unit(flat, along, K, 1000.0)[0] == 1.0
    turning = {i: transform([0, 0, 0], [0, np.sin(i / 20), 0, np.cos(i / 20)]) for i in range(12)}
    seen = {i: room(T)[0] for i, T in turning.items()}
    assert units.check_unit(seen, turning, K, 1000.0)[0] == 1.0
    assert units.check_unit({0: flat[0]}, along, K, 1000.0)[0] == 1.0
    assert units.check_unit({}, {}, K, 1000.0)[0] == 1.0
    assert not caplog.records


@pytest.mark.parametrize('unit, scale', [('', 1), ('cm', 10)])
def test_the_depth_range_is_said(seven, tmp_path, unit, scale):
    summary = convert_frames(seven, tmp_path / 'out', FramesOptions(depth_unit=unit))
    depths = np.concatenate([room(place(i))[0].ravel()[2:] for i in range(12)])
    low, high, middle = (float(x) for x in re.search(
        r'; depth (\S+) to (\S+) m, median (\S+) m$', summary).groups())
    assert np.allclose([low, high, middle], np.array(
        [depths.min(), depths.max(), np.median(depths)]) * scale, rtol=0.06)


def test_no_depth_at_all_is_said(seven, tmp_path):
    for path in seven.glob('*.depth.png'):
        cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH), np.uint16))
    assert convert_frames(seven, tmp_path / 'out').endswith('; no depth was measured')


Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])      # of the room, whose y is down


@pytest.mark.parametrize('turn, world, said', [
    (np.eye(3), 'enu', 'up is -y of the world, not z: the map from above would look sideways; '
                       '--world opencv turns it'),
    (np.diag([1.0, -1, -1]) @ Z_UP, 'enu', 'up is -z of the world, not z: .*; --world ned turns'),
    (Z_UP, 'enu', ''), (np.eye(3), 'opencv', ''),
    (np.diag([1.0, -1, -1]) @ Z_UP, 'ned', '')])
def test_a_world_that_is_not_z_up_is_noticed(seven, tmp_path, caplog, turn, world, said):
    rewrite(seven, lambda T: np.block([[turn @ T[:3, :3], (turn @ T[:3, 3])[:, None]],
                                       [np.array([0, 0, 0, 1.0])]]))
    convert_frames(seven, tmp_path / 'out', FramesOptions(world=world))
    warnings = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert len(warnings) == bool(said)
    assert not said or re.match(f"the cameras' {said}", warnings[0])


def test_the_world_of_a_camera_is_turned_to_z_up(seven, tmp_path):
    convert_frames(seven, tmp_path / 'out', FramesOptions(world='opencv'))
    for i, (_, pose) in enumerate(read(tmp_path / 'out')['/pose']):
        x, y, z = place(i)[:3, 3]
        assert np.allclose(matrix(pose.pose)[:3, 3], [x, z, -y], atol=1e-9)
        assert matrix(pose.pose)[2, 1] < -0.9       # the image's down is down


def test_cameras_that_look_down_say_nothing_of_up(caplog):
    """The image's up is the heading there, level, whatever the world."""
    down = np.eye(4)
    down[:3, :3] = [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]
    assert not check_up([down] * 5)
    sideways = np.eye(4)
    sideways[:3, :3] = np.column_stack([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert check_up([sideways] * 5)
    assert caplog.text.rstrip().endswith(
        "the cameras' up is -y of the world, not z: the map from above would look sideways; "
        '--world opencv turns it')
    sideways[:3, :2] *= -1
    assert check_up([sideways] * 5, 'ned')
    assert caplog.text.rstrip().endswith('up is x of the world, not -z: the map from above would '
                                         'look sideways; turn the poses so that z is up')


def reprojection_error(*what):
    """Return what misses() gives, without the pixels that meet no measurement, cut at WORST."""
    error = agreement.misses(*what)
    return np.minimum(error[~np.isnan(error)], agreement.WORST)


def test_reprojection_error_by_hand():
    """A plane at 2 m, the camera 0.5 m nearer: all pixels agree, or miss by the step."""
    far, near = np.full((5, 5), 2.0), np.full((5, 5), 1.5)
    pinhole = np.array([[5.0, 0, 2], [0, 5, 2], [0, 0, 1]])
    step = transform([0, 0, -0.5], [0, 0, 0, 1])
    error = reprojection_error(far, near, step, pinhole)
    # Corners move from 2 to 2.67 pixels off the centre: still the outermost pixel is 2.5 away.
    inside = np.count_nonzero(error < 1e-12)
    assert inside == 9 and np.all(error[error > 1e-12] == agreement.WORST)
    close = reprojection_error(far, near * 1.02, step, pinhole)
    assert np.allclose(np.sort(close)[:9], 0.02 / 1.02)
    assert reprojection_error(far, np.zeros((5, 5)), np.eye(4), pinhole).size == 0


@pytest.mark.parametrize('unit, factor', [('mm', 1000), ('cm', 100), ('5000', 5000), ('m', 1)])
def test_depth_units(tmp_path, unit, factor):
    cv2.imwrite(str(tmp_path / 'd.png'), np.array([[0, 65535, 400, 12]], np.uint16))
    depth, encoding = read_depth(tmp_path / 'd.png', parse_unit(unit))
    if unit == 'mm':
        assert encoding == '16UC1' and depth.tolist() == [[0, 0, 400, 12]]
    else:
        assert encoding == '32FC1'
        np.testing.assert_array_equal(depth, np.float32([[0, 0, 400 / factor, 12 / factor]]))


def test_floating_point_depth_is_metres(tmp_path):
    np.save(tmp_path / 'd.npy', np.array([[0.0, np.nan, 1.25, np.inf]]))
    depth, encoding = read_depth(tmp_path / 'd.npy')
    assert encoding == '32FC1' and depth.dtype == np.float32
    np.testing.assert_array_equal(depth, np.float32([[0, np.nan, 1.25, np.inf]]))


def test_large_ids_keep_their_width(seven, tmp_path):
    for i in range(12):
        np.save(seven / f'frame-{5 * i:06d}.ids.npy', np.full((HEIGHT, WIDTH), 70000 * i))
        cv2.imwrite(str(seven / f'frame-{5 * i:06d}.wide.png'),
                    np.full((HEIGHT, WIDTH), 300, np.uint16))
    convert_frames(seven, tmp_path / 'out', FramesOptions(labels='frame-*.ids.npy',
                                                          truth='frame-*.wide.png'))
    topics = read(tmp_path / 'out')
    assert topics['/semantic/image'][3][1].encoding == '32SC1'
    assert np.unique(pixels(topics['/semantic/image'][3][1])).tolist() == [210000]
    assert topics['/semantic/truth'][3][1].encoding == 'mono16'
    assert np.unique(pixels(topics['/semantic/truth'][3][1])).tolist() == [300]


def test_names_match_by_number_across_folders(tmp_path, seven):
    folder = tmp_path / 'scan'
    for name in ('depth', 'label', 'pose', 'intrinsic'):
        (folder / name).mkdir(parents=True)
    full = np.eye(4)
    full[:3, :3] = K
    np.savetxt(folder / 'intrinsic/intrinsic_depth.txt', full)
    for i in range(12):
        source = seven / f'frame-{5 * i:06d}'
        (folder / f'depth/depth_{i}.png').write_bytes(Path(f'{source}.depth.png').read_bytes())
        (folder / f'label/{i}.png').write_bytes(Path(f'{source}.label.png').read_bytes())
        (folder / f'pose/{i:05d}.txt').write_bytes(Path(f'{source}.pose.txt').read_bytes())
    np.savetxt(folder / 'pose/00004.txt', np.full((4, 4), -np.inf))
    convert_frames(folder, tmp_path / 'out', FramesOptions(rate=10.0, start=0.0))
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/depth/image']] == [i * 10**8 for i in range(12) if i != 4]
    np.testing.assert_array_equal(pixels(topics['/semantic/image'][10][1]), room(place(11))[1])


def test_lost_poses_are_counted(seven, tmp_path, caplog):
    np.savetxt(seven / 'frame-000010.pose.txt', np.full((4, 4), np.nan))
    (seven / 'frame-000015.pose.txt').unlink()
    (seven / 'frame-000020.depth.png').unlink()
    convert_frames(seven, tmp_path / 'out')
    assert len(read(tmp_path / 'out')['/semantic/image']) == 9
    for text in ('1 frames left out: with a lost pose (NaN, Inf) (frame-000010)',
                 '1 frames left out: without a pose (frame-000015)',
                 '1 frames left out: without depth (frame-000020)'):
        assert text in caplog.text


@pytest.mark.parametrize('frames, every, expected', [
    ('', 1, range(12)), ('2:5', 1, [2, 3, 4]), ('-3:', 1, [9, 10, 11]), ('', 5, [0, 5, 10]),
    ('1:9', 3, [1, 4, 7])])
def test_part_of_the_frames(seven, tmp_path, frames, every, expected):
    convert_frames(seven, tmp_path / 'out', FramesOptions(frames=frames, every=every))
    topics = read(tmp_path / 'out')
    expected = [10**9 + round(5 * i * 1e9 / 30) for i in expected]
    assert [s for s, _ in topics['/depth/image']] == expected
    assert [s for s, _ in topics['/pose']] == expected


def test_kitti_trajectories_by_line_and_by_number(tmp_path):
    path = tmp_path / 'poses.txt'
    np.savetxt(path, [place(i)[:3].ravel() for i in range(11)])
    poses = poses_from_trajectory(path, [f'{i:04d}' for i in range(0, 11, 5)], False)
    assert set(poses.by_key) == {'0000', '0005', '0010'}
    assert np.allclose(poses.by_key['0005'], place(5))
    poses = poses_from_trajectory(path, [f'{100 + i}' for i in range(11)], False)
    assert np.allclose(poses.by_key['103'], place(3))
    with pytest.raises(PersemError, match='11 poses for 2 frames'):
        poses_from_trajectory(path, ['20', '30'], False)


def test_numbered_trajectories(tmp_path):
    path = tmp_path / 'poses.txt'
    path.write_text('7 1 2 3 0 0 0 1\n9, 4, 5, 6, 0, 0, 0, 1\n11 nan 0 0 0 0 0 1\n')
    poses = poses_from_trajectory(path, ['0007', '0009', '0011'], False)
    assert poses.by_key['0009'][:3, 3].tolist() == [4, 5, 6]
    assert poses.lost == ['0011'] and set(poses.by_key) == {'0007', '0009'}


def test_interpolation_is_between_neighbours_only(tmp_path):
    path = tmp_path / 'poses.txt'
    half = np.sqrt(0.5)
    path.write_text(f'1.0 0 0 0 0 0 0 1\n2.0 2 0 4 0 0 {half} {half}\n2.0 9 9 9 0 0 0 1\n')
    poses = poses_from_trajectory(path, ['1.5'], True)
    T = poses.at('1.5', 1_500_000_000)
    assert np.allclose(T[:3, 3], [1, 0, 2])
    assert np.allclose(T[:3, :3], quaternion_to_matrix([0, 0, np.sin(np.pi / 8),
                                                        np.cos(np.pi / 8)]))
    assert poses.at('', 2_000_000_000)[0, 3] == 2
    assert poses.at('', 999_999_999) is None and poses.at('', 2_000_000_001) is None


def test_small_errors_of_rotations_are_mended():
    T = place(3)
    mended = pose_of_numbers((T + 1e-4).ravel()[:12], 'file')
    assert np.allclose(mended[:3, :3] @ mended[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.allclose(mended, T, atol=1e-3)
    assert np.allclose(inverse(mended) @ mended, np.eye(4))


@pytest.mark.parametrize('values, text', [
    (np.ones(5), r'expected 16 or 12 numbers .* got 5'),
    (1.1 * np.eye(4).ravel(), 'expected 0 0 0 1 as the last row'),
    (np.diag([1.1, 1.1, 1.1, 1]).ravel(), 'expected a rotation .* but the matrix is off'),
    (np.diag([1, 1, -1, 1]).ravel(), 'the matrix mirrors'),
    (np.zeros(12), 'expected a rotation'),
    (np.array([0, 0, 0, 1, 1, 0, 0]), 'expected a quaternion of norm 1')])
def test_what_is_no_pose_is_refused(values, text):
    with pytest.raises(PersemError, match=f'^file: .*{text}|^file: {text}'):
        pose_of_numbers(values, 'file')


@pytest.mark.parametrize('name, ns', [
    ('1658137057.641204937', 1_658_137_057_641_204_937), ('1305031102.1604', 1305031102_160400000),
    ('0.5', 500_000_000), ('1658137057', 1_658_137_057_000_000_000),
    ('1658137057641', 1_658_137_057_641_000_000), ('1658137057641204', 1_658_137_057_641_204_000),
    ('1658137057641204937', 1_658_137_057_641_204_937), ('000005', None), ('frame-1.5', None),
    ('9999999999.5', None), ('9999999999', None)])
def test_names_that_are_stamps(name, ns):
    assert stamps.stamp_of_name(name) == ns


def test_stamps_from_a_rate():
    assert stamps.stamps_from_rate(['a0', 'a3', 'a6'], 30, 1.0) == {
        'a0': 1_000_000_000, 'a3': 1_100_000_000, 'a6': 1_200_000_000}
    # Without numbers, or with one twice, the position counts.
    assert stamps.stamps_from_rate(['x', 'y'], 10, 0.0) == {'x': 0, 'y': 100_000_000}
    assert stamps.stamps_from_rate(['a1', 'b1'], 10, 0.0) == {'a1': 0, 'b1': 100_000_000}
    one_third = stamps.stamps_from_rate(['1', '2', '3'], 3, 0.0)
    assert list(one_third.values()) == [333_333_333, 666_666_667, 1_000_000_000]


@pytest.mark.parametrize('text', [
    '1.25 frame-000000.label.png\n3.5 labels/frame-000005.png\n', '1.25\n3.5\n',
    '# stamp file\n000000 1.25\n5, 3.5\n', 'frame-000000.png 1.25\nframe-000005.png 3.5'])
def test_stamps_from_a_file(tmp_path, text):
    (tmp_path / 'times.txt').write_text(text)
    assert stamps.stamps_from_file(tmp_path / 'times.txt', ['000000', '000005']) == {
        '000000': 1_250_000_000, '000005': 3_500_000_000}


@pytest.mark.parametrize('text, message', [
    ('1.5\n', '1 stamps for 2 frames'), ('1.5 000000\n', 'no stamp for 1 of 2 frames'),
    ('soon 000000\n2 000005\n', 'line 1: expected seconds'), ('', 'the file is empty'),
    ('-1\n2\n', 'line 1: expected seconds'), ('nan\n2\n', 'expected seconds')])
def test_broken_stamp_files_are_refused(tmp_path, text, message):
    (tmp_path / 'times.txt').write_text(text)
    with pytest.raises(PersemError, match=message):
        stamps.stamps_from_file(tmp_path / 'times.txt', ['000000', '000005'])


def test_patterns(tmp_path):
    for name in ('a-10.png', 'a-9.png', 'b-1.png', '.a-3.png', 'a-.txt'):
        (tmp_path / name).write_text('x')
    assert list(files_of(tmp_path, 'a-*.png')) == ['9', '10']
    assert list(files_of(tmp_path, '.')) == ['a-', 'a-9', 'a-10', 'b-1']
    assert files_of(tmp_path, 'nowhere/*.png') == {}
    assert list(files_of('/elsewhere', str(tmp_path / 'b-*.png'))) == ['1']
    for pattern in ('*-*.png', '*/a.png', 'a.png'):
        with pytest.raises(PersemError, match="expected one '\\*'"):
            files_of(tmp_path, pattern)


def test_resizing_keeps_pixel_centres():
    image = np.arange(24).reshape(4, 6)
    np.testing.assert_array_equal(nearest(image, (3, 2)), image[1::2, 1::2])
    np.testing.assert_array_equal(nearest(image, (12, 8)), image.repeat(2, 0).repeat(2, 1))
    np.testing.assert_array_equal(nearest(image, (2, 4)), image[:, [1, 4]])
    half = scaled_K([[100, 0, 31.5], [0, 100, 23.5], [0, 0, 1]], (64, 48), (32, 24))
    assert half.tolist() == [[50, 0, 15.5], [0, 50, 11.5], [0, 0, 1]]


def test_intrinsics_in_all_forms(tmp_path):
    (tmp_path / 'four.txt').write_text('40 41 31.5 23.5')
    (tmp_path / 'nine.txt').write_text('40 0 31.5\n0 41 23.5\n0 0 1\n')
    (tmp_path / 'ros.yaml').write_text(
        'image_width: 64\nimage_height: 48\ndistortion_model: rational_polynomial\n'
        'camera_matrix: {rows: 3, cols: 3, data: [40, 0, 31.5, 0, 41, 23.5, 0, 0, 1]}\n'
        'distortion_coefficients: {data: [0.1, 0, 0, 0, 0, 0, 0, 0]}\n')
    for source in (tmp_path / 'four.txt', tmp_path / 'nine.txt', tmp_path / 'ros.yaml',
                   '40,41,31.5,23.5'):
        assert read_intrinsics(source).K.tolist() == [[40, 0, 31.5], [0, 41, 23.5], [0, 0, 1]]
    ros = read_intrinsics(tmp_path / 'ros.yaml')
    assert (ros.size, ros.model, len(ros.D)) == ((64, 48), 'rational_polynomial', 8)


def test_a_ros_calibration_of_a_larger_image_is_scaled(seven, tmp_path):
    (seven / 'camera-intrinsics.txt').unlink()
    (seven / 'camera.yaml').write_text(
        'image_width: 128\nimage_height: 96\ndistortion_model: plumb_bob\n'
        'camera_matrix: {data: [80, 0, 63.5, 0, 80, 47.5, 0, 0, 1]}\n'
        'distortion_coefficients: {data: [0.1, 0.2, 0, 0, 0]}\n')
    convert_frames(seven, tmp_path / 'out')
    info = read(tmp_path / 'out')['/depth/camera_info'][0][1]
    assert info.k.tolist() == [40, 0, 31.5, 0, 40, 23.5, 0, 0, 1]
    assert info.d.tolist() == [0.1, 0.2, 0, 0, 0]


@pytest.mark.parametrize('source, text', [
    ('40,0,1,1', 'expected positive focal lengths'), ('a,b,c,d', 'expected numbers'),
    ('40,40,nan,3', 'expected positive focal lengths')])
def test_broken_intrinsics_are_refused(source, text):
    with pytest.raises(PersemError, match=text):
        read_intrinsics(source)


@pytest.mark.parametrize('name, content, text', [
    ('a.txt', '1 2 3', 'got 3 numbers'), ('a.txt', '40 3 31 0 40 23 0 0 1', 'pinhole matrix'),
    ('a.yaml', 'camera: 3', 'expected a ROS camera calibration'), ('a.txt', '', 'file is empty'),
    ('a.yaml', '{', 'expected a ROS camera calibration')])
def test_broken_intrinsics_files_are_refused(tmp_path, name, content, text):
    (tmp_path / name).write_text(content)
    with pytest.raises(PersemError, match=text):
        read_intrinsics(tmp_path / name)


def test_refusals_of_folders(seven, tmp_path):
    refusal(tmp_path / 'nowhere', tmp_path, 'no such folder')
    refusal(seven, tmp_path, r'no label files like x-\*.png; name them with --labels',
            labels='x-*.png')
    refusal(seven, tmp_path, 'no depth files', depth='x-*.png')
    refusal(seven, tmp_path, 'no color files', color='x-*.png')
    refusal(seven, tmp_path, 'no poses like x.txt', pose='x.txt')
    refusal(seven, tmp_path, 'no intrinsics like x.txt', intrinsics='x.txt')
    for text, count in (('585,585,320', 'three'), ('585,585,320,', 'three'), ('585', 'one'),
                        ('1,2,3,4,5', 'five'), ('1,2,3,4,5,6,7', '7')):
        refusal(seven, tmp_path, f'expected four numbers fx,fy,cx,cy, got {count}$',
                intrinsics=text)
    refusal(seven, tmp_path, 'expected m, cm, mm', depth_unit='feet')
    refusal(seven, tmp_path, "'frame-000000' is not a stamp", stamps='names')
    refusal(seven, tmp_path, 'no frame is left of 12', frames='20:30')
    refusal(seven, tmp_path, 'expected A:B', frames='3')
    refusal(seven, tmp_path, 'expected 1 or more', every=0)
    refusal(seven, tmp_path, 'expected a rate above 0', rate=0.0)
    refusal(seven, tmp_path, 'cannot be read', stamps='nowhere.txt')
    refusal(seven, tmp_path, r'principal point \(31.5, 100\) lies outside',
            intrinsics='40,40,31.5,100')


def test_refusals_of_files(seven, tmp_path):
    def broken(name, content):
        path = seven / name
        before = path.read_bytes()
        if isinstance(content, np.ndarray):
            cv2.imwrite(str(path), content)
        else:
            path.write_bytes(content)
        return path, before

    for name, content, text in (
            ('frame-000005.pose.txt', b'1 2 three 4', 'expected numbers'),
            ('frame-000005.pose.txt', b'', 'the file is empty'),
            ('frame-000005.pose.txt', b'\xff\xfe\x00', 'expected a text file'),
            ('frame-000005.pose.txt', b'1 0 0 0 0 2 0 0 0 0 1 0', 'expected a rotation'),
            ('frame-000005.depth.png', b'no image', 'not an image that can be decoded'),
            ('frame-000005.depth.png', b'', 'not an image'),
            ('frame-000005.depth.png', np.zeros((HEIGHT, WIDTH), np.uint8), 'of 16-bit or'),
            ('frame-000005.depth.png', np.zeros((HEIGHT, WIDTH + 2), np.uint16), 'one size'),
            ('frame-000005.label.png', np.zeros((HEIGHT, WIDTH, 3), np.uint8), 'of class ids'),
            ('frame-000005.label.png', np.zeros((HEIGHT, HEIGHT), np.uint8), 'one aspect ratio'),
            ('frame-000005.truth.png', np.zeros((9, 3), np.uint8), 'one aspect ratio')):
        path, before = broken(name, content)
        refusal(seven, tmp_path, f'{path.name}.*{text}')
        refusal(seven, tmp_path, f'{path.name}.*{text}', check=False)
        path.write_bytes(before)
    convert_frames(seven, tmp_path / 'out')


@pytest.mark.parametrize('change', [
    lambda data: data[:len(data) // 2], lambda data: data[:-8],
    lambda data: data[:80] + bytes([data[80] ^ 1]) + data[81:]])
def test_a_damaged_image_is_one_line(seven, tmp_path, capfd, change):
    path = seven / 'frame-000005.label.png'
    path.write_bytes(change(path.read_bytes()))
    refusal(seven, tmp_path, f'{path.name}: not an image that can be decoded')
    assert 'libpng' not in capfd.readouterr().err


def test_frames_that_do_not_match_are_shown(seven, tmp_path):
    for i, path in enumerate(sorted(seven.glob('*.depth.png'))):
        path.rename(seven / f'other-{i}x.range.png')
    text = (r'no frame is complete: 12 label files \(frame-000000, frame-000005, frame-000010, '
            r'…\), 12 depth files \(0x, 1x, 2x, …\), 0 poses')
    for path in seven.glob('*.pose.txt'):
        path.unlink()
    (seven / 'poses.txt').write_text('90 0 0 0 0 0 0 1\n')
    refusal(seven, tmp_path, text, depth='other-*.range.png')


def test_a_few_numbers_in_common_are_chance(seven, tmp_path):
    """Depth counted from 0 in ones, labels in fives: three numbers agree and mean nothing."""
    for i, path in enumerate(sorted(seven.glob('*.depth.png'))):
        path.rename(seven / f'other-{i}x.range.png')
    refusal(seven, tmp_path, 'no frame is complete', depth='other-*.range.png')


def test_frames_go_out_in_order_of_stamps(seven, tmp_path):
    path = seven / 'times.txt'
    path.write_text(''.join(f'{20 - i}\n' for i in range(12)))
    convert_frames(seven, tmp_path / 'out', FramesOptions(stamps=str(path), frames='0:2'))
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/semantic/image']] == [9 * 10**9, 10 * 10**9]
    np.testing.assert_array_equal(pixels(topics['/semantic/image'][0][1]), room(place(11))[1])


def test_a_depth_image_belongs_to_one_frame(tmp_path, caplog):
    """Two label images within the tolerance of one depth image: the nearer one has it."""
    folder, begin = tum(tmp_path)
    label = sorted((folder / 'labels').iterdir())[3]
    copy = label.with_name(f'{(begin + 3 * 10**8) // 1000 / 1e6 - 0.005:.6f}.png')
    copy.write_bytes(label.read_bytes())
    convert_frames(folder, tmp_path / 'out')
    stamps_out = [s for s, _ in read(tmp_path / 'out')['/semantic/image']]
    assert len(stamps_out) == 8 and begin + 3 * 10**8 not in stamps_out
    assert f'1 frames left out: without depth ({label.stem})' in caplog.text


def test_stamps_that_repeat_are_refused(seven, tmp_path):
    path = seven / 'times.txt'
    path.write_text('1.5\n' * 12)
    refusal(seven, tmp_path, 'frames frame-000000 and frame-000005 have the same stamp',
            stamps=str(path))
