"""Which frame is which: what replay and info find out by themselves, refuse, or say."""

from contextlib import closing
import re

import bags
import numpy as np
from persem_ros.cli import main
from persem_ros.core.transforms import inverse, transform
from persem_ros.errors import PersemError
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
import pytest

DOWN = transform([0.1, 0.0, -0.05], [1.0, 0.0, 0.0, 0.0])       # the camera below a body
W, H, F = 32, 24, 25.0
K = np.array([[F, 0, 15.5], [0, F, 11.5], [0, 0, 1]])


def turned(roll=0.0, pitch=0.0, yaw=0.0, xyz=(0.0, 0.0, 10.0)):
    """Return T_map_body of angles in degrees."""
    T = np.eye(4)
    for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
        q = np.zeros(4)
        q[axis], q[3] = np.sin(np.radians(angle) / 2), np.cos(np.radians(angle) / 2)
        T = T @ transform([0.0, 0.0, 0.0], q)
    T[:3, 3] = xyz
    return T


def swaying(i):
    """Return T_map_body of a multirotor that brakes and turns."""
    return turned(14 * np.sin(i), 14 * np.cos(0.7 * i), 5 * i, (0.3 * i, 0.1 * i, 10 + np.sin(i)))


def straight(i):
    """Return T_map_body of a flight without a turn."""
    return turned(xyz=(0.1 * i, 0.0, 10.0))


def ground(T_map_camera):
    """Return the depth (H, W) of flat ground at z = 0."""
    rays = np.stack([*np.meshgrid((np.arange(W) - 15.5) / F, (np.arange(H) - 11.5) / F),
                     np.ones((H, W))], -1)
    return (-T_map_camera[2, 3] / (rays @ T_map_camera[:3, :3].T)[..., 2]).astype(np.float32)


def images(out, i, T_map_camera, frames=('camera',) * 3):
    """Write frame *i*; *frames* are those of labels, depth and camera info."""
    at = bags.stamp(i)
    out.camera_info('depth/camera_info', at, frames[2], W, H, K)
    out.image('depth/image', at, frames[1], ground(T_map_camera), '32FC1')
    out.image('semantic/image', at, frames[0], np.ones((H, W), np.uint8), 'mono8')


def written(path, body=straight, n=20, extra=None, frames=('camera',) * 3, pose=True, child=''):
    """Write a flight whose poses are those of the body, the camera mounted in /tf_static."""
    with RecordingWriter(path) as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(n):
            if pose:
                out.pose('pose', bags.stamp(i), 'map', body(i), *(('Odometry', child)
                                                                  if child else ()))
            if extra:
                extra(out, i)
            images(out, i, body(i) @ DOWN, frames)
    return path


def looked(path, **values):
    """Return the frames and the settings in force; dots in names are double underscores."""
    config = updated(Config(), {k.replace('__', '.'): v for k, v in values.items()})
    with closing(opened(path, config)) as recording:
        return list(recording.frames()), recording


def test_a_body_pose_is_told_from_a_camera_pose_by_depth(tmp_path, caplog):
    frames, recording = looked(written(tmp_path / 'bag', swaying))
    assert recording.config.pose.child_frame == 'base_link'
    assert "'base_link', because" in caplog.text
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-9)


def test_a_camera_pose_is_told_from_a_body_pose_by_depth(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'map', swaying(i) @ DOWN)
            images(out, i, swaying(i) @ DOWN)
    frames, recording = looked(tmp_path / 'bag')
    assert recording.config.pose.child_frame == 'camera'
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-9)


def test_what_the_images_do_not_tell_is_refused_with_both_commands(tmp_path):
    path = written(tmp_path / 'bag')
    with pytest.raises(PersemError) as refusal:
        looked(path)
    for flag in ('--set pose.child_frame=base_link', '--set pose.child_frame=camera'):
        assert flag in str(refusal.value)
    for child, height in (('base_link', 9.95), ('camera', 10.0)):
        frames, _ = looked(path, pose__child_frame=child)
        assert len(frames) == 20 and frames[5].T_map_camera[2, 3] == pytest.approx(height)


def test_a_mount_without_distance_asks_nothing(tmp_path, caplog):
    path = bags.write(tmp_path / 'bag', extra=lambda out: out.tf(
        bags.stamp(0), 'base_link', 'camera', np.eye(4), static=True))
    assert len(looked(path)[0]) == 5 and not caplog.text


def test_a_gimbal_on_tf_is_followed(tmp_path):
    def gimbal(i):
        return turned(3 * i)

    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'gimbal', 'camera', DOWN, static=True)
        for i in range(12):
            out.pose('odom', bags.stamp(i), 'map', straight(i), 'Odometry', 'base_link')
            out.tf(bags.stamp(i), 'base_link', 'gimbal', gimbal(i))
            images(out, i, straight(i) @ gimbal(i) @ DOWN)
    frames, _ = looked(tmp_path / 'bag', topics__pose='odom')
    np.testing.assert_allclose(frames[7].T_map_camera, straight(7) @ gimbal(7) @ DOWN, atol=1e-9)
    assert len(frames) == 12


def test_the_only_root_is_the_map_frame(tmp_path, caplog):
    path = written(tmp_path / 'bag', pose=False, extra=lambda out, i: out.tf(
        bags.stamp(i), 'odom', 'base_link', straight(i)))
    frames, recording = looked(path, pose__source='tf')
    assert len(frames) == 20 and recording.config.frames.map == 'odom'
    assert "there is no 'map': the map is in 'odom'" in caplog.text


def test_several_roots_are_refused_with_the_candidates(tmp_path):
    path = written(tmp_path / 'bag', pose=False, extra=lambda out, i: (
        out.tf(bags.stamp(i), ('odom', 'world')[i % 2], 'base_link', straight(i))))
    with pytest.raises(PersemError, match='--set frames.map=odom, or --set frames.map=world'):
        looked(path, pose__source='tf')


@pytest.mark.parametrize('camera, robot', [('r2', 'r2'), ('', 'r2')])
def test_transforms_are_those_of_the_robot_with_the_camera(tmp_path, camera, robot):
    """Of /r1/tf and /r2/tf: by the namespace of the images, else by the frames in them."""
    frame = 'camera' if camera else 'r2/camera'
    prefix = f'{camera}/' if camera else ''
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(10):
            for name, shift in (('r1', 100.0), ('r2', 0.0)):
                child = 'camera' if camera else f'{name}/camera'
                T = straight(i) @ DOWN
                T[0, 3] += shift
                out.message(f'{name}/tf', bags.stamp(i), 'tf2_msgs/msg/TFMessage', out.make.make(
                    'tf2_msgs/msg/TFMessage', [
                        out.make.transform(bags.stamp(i), 'map', child, T)]))
            at = bags.stamp(i)
            out.camera_info(f'{prefix}depth/camera_info', at, frame, W, H, K)
            out.image(f'{prefix}depth/image', at, frame, ground(straight(i) @ DOWN), '32FC1')
            out.image(f'{prefix}semantic/image', at, frame, np.ones((H, W), np.uint8), 'mono8')
    frames, _ = looked(tmp_path / 'bag', pose__source='tf')
    assert len(frames) == 10 and frames[0].T_map_camera[0, 3] == pytest.approx(0.1)


def test_robots_that_nothing_tells_apart_are_refused(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            for name in ('r1', 'r2'):
                out.message(f'{name}/tf', bags.stamp(i), 'tf2_msgs/msg/TFMessage', out.make.make(
                    'tf2_msgs/msg/TFMessage', [out.make.transform(
                        bags.stamp(i), 'map', 'camera', np.eye(4))]))
            images(out, i, straight(i) @ DOWN)
    with pytest.raises(PersemError, match='--set topics.tf=/r1/tf, or --set topics.tf=/r2/tf'):
        looked(tmp_path / 'bag', pose__source='tf')
    assert len(looked(tmp_path / 'bag', pose__source='tf', topics__tf='/r2/tf')[0]) == 3


def test_the_right_camera_info_is_found(tmp_path):
    def extra(out, i):
        out.camera_info('aligned/camera_info', bags.stamp(i), 'camera', W, H, K)

    frames = ('camera', 'camera', 'color')
    path = written(tmp_path / 'bag', frames=frames, child='base_link', extra=extra)
    recording = looked(path)[1]
    assert recording.config.topics.camera_info == '/aligned/camera_info'


def test_labels_of_a_camera_beside_are_no_silent_mistake(tmp_path):
    beside = transform([1.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    path = written(tmp_path / 'bag', frames=('color', 'camera', 'camera'), child='base_link',
                   extra=lambda out, i: i or out.tf(bags.stamp(0), 'base_link', 'color', beside,
                                                    static=True))
    with pytest.raises(PersemError, match="'color'.*'camera'"):
        looked(path)


def test_a_slow_link_is_named_with_both_settings_and_may_be_held(tmp_path):
    def extra(out, i):
        out.tf(bags.stamp(i), 'odom', 'base_link', straight(i))
        if i % 10 == 0:
            out.tf(bags.stamp(i) - 10_000_000, 'map', 'odom', np.eye(4))

    path = written(tmp_path / 'bag', pose=False, extra=extra, n=30)
    with pytest.raises(PersemError, match=r'map -> odom.*--set pose.max_gap=1.2.*pose.hold=odom'):
        looked(path, pose__source='tf')
    assert len(looked(path, pose__source='tf', pose__hold=['odom'])[0]) == 30


def test_a_transform_sent_once_is_held_on_demand(tmp_path):
    def extra(out, i):
        out.tf(bags.stamp(i), 'odom', 'base_link', straight(i))
        if i == 0:
            out.tf(bags.stamp(0), 'map', 'odom', np.eye(4))

    path = written(tmp_path / 'bag', pose=False, extra=extra)
    frames, recording = looked(path, pose__source='tf')
    assert len(frames) == 1 and 'one sample only' in recording.examples['no pose']
    assert len(looked(path, pose__source='tf', pose__hold=['odom'])[0]) == 20


def test_poses_that_jump_are_not_interpolated_and_said(tmp_path, caplog):
    def jumping(i):
        T = straight(i)
        T[0, 3] += 40.0 if i > 9.7 else 0.0
        return T

    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(20):
            out.pose('pose', bags.stamp(i - 0.5), 'map', jumping(i - 0.5) @ DOWN)
            images(out, i, jumping(i) @ DOWN)
        out.pose('pose', bags.stamp(19.5), 'map', jumping(19.5) @ DOWN)
    frames, recording = looked(tmp_path / 'bag')
    assert len(frames) == 19 and recording.dropped['pose jumps'] == 1
    assert 'jump 1 times' in caplog.text and 'topics.trajectory' in caplog.text
    assert 'pose.max_speed' in recording.examples['pose jumps']


@pytest.mark.parametrize('x', [1e300, 1e6, -3000.0])
def test_one_wild_pose_costs_one_frame(tmp_path, x):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(12):
            T = straight(i) @ DOWN
            images(out, i, T)
            T[0, 3] = x if i == 6 else T[0, 3]
            out.pose('pose', bags.stamp(i), 'map', T)
    frames, recording = looked(tmp_path / 'bag')
    assert len(frames) == 11 and sum(recording.dropped.values()) == 1
    assert inverse(frames[6].T_map_camera)[0, 3] == pytest.approx(-0.8)


def aside(T):
    T[0, 3] += 3.0


def elsewhere(T):
    T[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]


@pytest.mark.parametrize('wrong, words', [
    (aside, 'the poses jump 2 times, by up to 3.'), (elsewhere, '1 of 12 poses look elsewhere')])
def test_one_pose_that_is_a_little_wild_is_said(tmp_path, caplog, wrong, words):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(12):
            T = straight(3 * i) @ DOWN
            images(out, i, T)
            if i == 6:
                wrong(T)
            out.pose('pose', bags.stamp(i), 'map', T)
    looked(tmp_path / 'bag')
    assert words in caplog.text
    if wrong is aside:
        speed = float(re.search(r'pose.max_speed=(\S+) does not', caplog.text)[1])
        frames, recording = looked(tmp_path / 'bag', pose__max_speed=speed)
        assert len(frames) == 11 and sum(recording.dropped.values()) == 1


@pytest.mark.parametrize('where', ['tf', 'tf_static'])
def test_odometry_is_carried_to_the_map_by_the_transform_above_it(tmp_path, where):
    """The poses are in odom, map -> odom is on /tf."""
    above = transform([100.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])

    def extra(out, i):
        if where == 'tf' or i == 0:
            out.tf(bags.stamp(i), 'map', 'odom', above, static=where == 'tf_static')

    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(12):
            out.pose('pose', bags.stamp(i), 'odom', straight(i), 'Odometry', 'base_link')
            extra(out, i)
            images(out, i, straight(i) @ DOWN)
    frames, _ = looked(tmp_path / 'bag')
    np.testing.assert_allclose(frames[5].T_map_camera, above @ straight(5) @ DOWN, atol=1e-9)
    frames, _ = looked(tmp_path / 'bag', frames__map='odom')
    np.testing.assert_allclose(frames[5].T_map_camera, straight(5) @ DOWN, atol=1e-9)


def test_a_localisation_that_comes_late_leaves_no_frames_elsewhere(tmp_path, caplog):
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'odom', straight(i), 'Odometry', 'base_link')
            if i >= 8:
                out.tf(bags.stamp(i), 'map', 'odom', turned(xyz=(50.0, 0.0, 0.0)))
            images(out, i, straight(i) @ DOWN)
    frames, _ = looked(tmp_path / 'bag')
    assert len(frames) == 12 and all(f.T_map_camera[0, 3] > 49 for f in frames)
    assert '--set frames.map=odom' in caplog.text


def test_poses_in_another_frame_are_the_maps_and_info_says_so(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            out.pose('pose', bags.stamp(i), 'world', straight(i) @ DOWN)
            images(out, i, straight(i) @ DOWN)
    assert main(['info', str(tmp_path / 'bag')]) == 0
    assert '--set frames.map=world says so' in capsys.readouterr().out


@pytest.mark.parametrize('root, shift', [('odom', 0.0), ('vicon', 50.0)])
def test_two_parents_that_take_turns_are_both_followed(tmp_path, root, shift):
    def extra(out, i):
        out.tf(bags.stamp(i), 'odom', 'base_link', straight(i))
        T = straight(i)
        T[0, 3] += 50.0
        out.tf(bags.stamp(i) + 1000, 'vicon', 'base_link', T)

    path = written(tmp_path / 'bag', pose=False, extra=extra)
    frames, _ = looked(path, pose__source='tf', frames__map=root)
    assert len(frames) >= 19
    for frame in frames:
        own = straight((frame.stamp - bags.START) / bags.STEP) @ DOWN
        assert frame.T_map_camera[0, 3] - own[0, 3] == pytest.approx(shift, abs=1e-3)


def test_images_that_name_no_frame_are_given_one(tmp_path):
    path = written(tmp_path / 'bag', frames=('',) * 3, child='base_link')
    with pytest.raises(PersemError, match='--set camera.frame=camera names it'):
        looked(path)
    frames, _ = looked(path, camera__frame='camera')
    np.testing.assert_allclose(frames[3].T_map_camera, straight(3) @ DOWN, atol=1e-9)


FLU = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize('optical', [True, False])
def test_a_frame_that_is_not_optical_is_noticed(tmp_path, caplog, optical):
    """Gazebo stamps images with the camera's link, x forward."""
    link = DOWN @ inverse(FLU)
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera_link', link, static=True)
        if optical:
            out.tf(bags.stamp(0), 'camera_link', 'camera_optical', FLU, static=True)
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'map', swaying(i), 'Odometry', 'base_link')
            images(out, i, swaying(i) @ DOWN, ('camera_link',) * 3)
    looked(tmp_path / 'bag')
    assert 'x forward, y left, z up' in caplog.text
    if optical:
        assert '--set camera.frame=camera_optical' in caplog.text
        settings = {'camera__frame': 'camera_optical'}
    else:
        text = caplog.text.split('pose.extrinsic=[')[1].split(']')[0]
        settings = {'pose__extrinsic': [float(x) for x in text.split(',')]}
    caplog.clear()
    frames, _ = looked(tmp_path / 'bag', **settings)
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-5)
    assert not caplog.text


def test_poses_of_a_body_with_the_axes_of_ros_are_noticed(tmp_path, caplog):
    """A PoseStamped of AirSim: no child frame, nothing on /tf, x forward."""
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'map', swaying(i) @ DOWN @ inverse(FLU))
            images(out, i, swaying(i) @ DOWN)
    looked(tmp_path / 'bag')
    assert '--set pose.child_frame=base_link' in caplog.text
    assert "--set 'pose.extrinsic=[0,0,0,-0.5,0.5,-0.5,0.5]'" in caplog.text
    frames, _ = looked(tmp_path / 'bag', pose__child_frame='base_link',
                       pose__extrinsic=[0, 0, 0, -0.5, 0.5, -0.5, 0.5])
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-9)


def test_a_gimbal_whose_poses_are_unsaid_is_tried_both_ways(tmp_path):
    """Under one reading the views do not turn at all; pairs are those of the other."""
    def gimbal(i):
        return turned(14 * np.sin(i), 14 * np.cos(0.7 * i), 0, (0, 0, 0))

    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'gimbal', 'camera', DOWN, static=True)
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'map', straight(i))
            out.tf(bags.stamp(i), 'base_link', 'gimbal', gimbal(i))
            images(out, i, straight(i) @ gimbal(i) @ DOWN)
    with pytest.raises(PersemError, match=r'by [\d.]+ % and [\d.]+ %\): --set pose.child_frame='):
        looked(tmp_path / 'bag')
    assert len(looked(tmp_path / 'bag', pose__child_frame='base_link')[0]) == 20


@pytest.mark.parametrize('kind, settings, said', [
    ('PoseStamped', {'pose__child_frame': 'base_link'}, 'pose.child_frame says'),
    ('Odometry', {}, '/pose says')])
def test_what_is_said_of_the_poses_and_depth_contradicts(tmp_path, caplog, kind, settings, said):
    """Somebody says that they place the body, and they are the camera's."""
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(20):
            out.pose('pose', bags.stamp(i), 'map', swaying(i) @ DOWN, kind, 'base_link')
            images(out, i, swaying(i) @ DOWN)
    looked(tmp_path / 'bag', **settings)
    assert said in caplog.text and '--set pose.child_frame=camera' in caplog.text
    assert len(caplog.records) == 1         # nothing else is doubted for the same reason
    caplog.clear()
    frames, _ = looked(tmp_path / 'bag', pose__child_frame='camera')
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-9)
    assert not caplog.text


def test_each_of_several_cameras_has_a_frame(tmp_path):
    """Images that name no frame, of two cameras on one body."""
    side = DOWN @ turned(0, 0, 90, (0, 0.2, 0))
    mounts = {'front': DOWN, 'side': side}
    with RecordingWriter(tmp_path / 'bag') as out:
        for name, mount in mounts.items():
            out.tf(bags.stamp(0), 'base_link', f'{name}_optical', mount, static=True)
        for i in range(6):
            out.pose('pose', bags.stamp(i), 'map', swaying(i), 'Odometry', 'base_link')
            for name, mount in mounts.items():
                at = bags.stamp(i)
                out.camera_info(f'{name}/depth/camera_info', at, '', W, H, K)
                out.image(f'{name}/depth/image', at, '', ground(swaying(i) @ mount), '32FC1')
                out.image(f'{name}/semantic/image', at, '', np.ones((H, W), np.uint8), 'mono8')
    cameras = {'cameras': list(mounts)}
    with pytest.raises(PersemError, match='--set cameras.side.frame=front_optical or --set'):
        looked(tmp_path / 'bag', **cameras)
    with pytest.raises(PersemError, match='expected cameras.front.frame'):
        looked(tmp_path / 'bag', **cameras, camera__frame='front_optical')
    frames, _ = looked(tmp_path / 'bag', **cameras, cameras__front__frame='front_optical',
                       cameras__side__frame='side_optical')
    assert len(frames) == 12
    for frame in frames:
        i = round((frame.stamp - bags.START) / bags.STEP)
        np.testing.assert_allclose(frame.T_map_camera, swaying(i) @ mounts[frame.sensor],
                                   atol=1e-9)


def test_transforms_to_a_frame_that_is_not_optical_are_corrected_by_the_printed_turn(
        tmp_path, caplog):
    link = DOWN @ inverse(FLU)
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(20):
            out.tf(bags.stamp(i), 'map', 'camera_link', swaying(i) @ link)
            images(out, i, swaying(i) @ DOWN, ('camera_link',) * 3)
    looked(tmp_path / 'bag', pose__source='tf')
    assert "--set 'pose.extrinsic=[0,0,0,-0.5,0.5,-0.5,0.5]'" in caplog.text
    frames, _ = looked(tmp_path / 'bag', pose__source='tf',
                       pose__extrinsic=[0, 0, 0, -0.5, 0.5, -0.5, 0.5])
    np.testing.assert_allclose(frames[3].T_map_camera, swaying(3) @ DOWN, atol=1e-9)


@pytest.mark.parametrize('source', ['topic', 'tf'])
@pytest.mark.parametrize('body, seldom', [(swaying, True), (straight, False)])
def test_poses_too_seldom_for_the_motion_are_said(tmp_path, caplog, source, body, seldom):
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(41):
            if i % 5 == 0 and source == 'tf':       # 2 Hz, where images come at 10
                out.tf(bags.stamp(i), 'map', 'base_link', body(i))
            elif i % 5 == 0:
                out.pose('pose', bags.stamp(i), 'map', body(i), 'Odometry', 'base_link')
            images(out, i, body(i) @ DOWN)
    assert len(looked(tmp_path / 'bag', pose__source=source)[0]) == 41
    said = [r.getMessage() for r in caplog.records if 'one every 0.5 s' in r.getMessage()]
    assert len(said) == seldom
    assert all('--set pose.max_gap=0.45 uses frames' in sentence for sentence in said)
