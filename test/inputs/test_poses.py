"""Poses: interpolation between neighbours, frames, gaps, and what may still come."""

from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.transforms import inverse, matrix_to_quaternion, slerp, transform
from persem_ros.errors import PersemError
from persem_ros.inputs.sync.mount import fixed
from persem_ros.inputs.sync.no_pose import explain, mount_sentence
from persem_ros.inputs.sync.poses import NO_MOUNT, PoseBuffer, UNSAID
from persem_ros.inputs.sync.track import Lookup, NO_POSE, POSE_GAP
from persem_ros.settings.config import Config, updated
import pytest

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def turn(degrees, x=0.0, axis=2):
    q = np.zeros(4)
    q[axis], q[3] = np.sin(np.radians(degrees) / 2), np.cos(np.radians(degrees) / 2)
    return transform([x, 0.0, 0.0], q)


def filled(values=None, stamps=(0.0, 0.1, 0.2), child='', parent='map', **options):
    """Return a buffer with a pose of x = 10 t and a turn of 100 t degrees at each stamp."""
    buffer = PoseBuffer(updated(Config(), values or {}), **options)
    for t in stamps:
        buffer.add(at(t), turn(100 * t, 10 * t), parent, child)
    return buffer


def at(t):
    return START + round(t * SECOND)


@pytest.mark.parametrize('t', [0.0, 0.02, 0.1, 0.15, 0.2])
def test_between_two_poses(t):
    T = filled().lookup(at(t), 'camera').T
    np.testing.assert_allclose(T, turn(100 * t, 10 * t), atol=1e-12)


def test_a_pose_at_the_stamp_is_taken_as_it_is():
    np.testing.assert_array_equal(filled().lookup(at(0.1), 'camera').T, turn(10.0, 1.0))


def test_slerp_is_not_lerp():
    buffer = PoseBuffer(Config())
    T0, T1 = turn(0), turn(170, axis=0)
    buffer.add(at(0), T0, 'map', '')
    buffer.add(at(0.4), T1, 'map', '')
    expected = slerp(matrix_to_quaternion(T0[:3, :3]), matrix_to_quaternion(T1[:3, :3]), 0.25)
    np.testing.assert_allclose(buffer.lookup(at(0.1), 'c').T, transform(np.zeros(3), expected),
                               atol=1e-12)
    np.testing.assert_allclose(buffer.lookup(at(0.1), 'c').T, turn(42.5, axis=0), atol=1e-9)


def test_nothing_is_extrapolated():
    buffer = filled()
    assert buffer.lookup(at(0.201), 'camera') == Lookup(None, False, NO_POSE)     # may still come
    assert buffer.lookup(at(-0.001), 'camera') == Lookup(None, True, NO_POSE)     # never will
    assert PoseBuffer(Config()).lookup(at(0), 'camera') == Lookup(None, False, NO_POSE)


def test_gaps():
    buffer = filled(stamps=(0.0, 0.5, 1.0 + 2e-9))
    np.testing.assert_allclose(buffer.lookup(at(0.25), 'camera').T, turn(25, 2.5), atol=1e-9)
    assert buffer.lookup(at(0.75), 'camera') == Lookup(None, True, POSE_GAP)
    assert filled({'pose.max_gap': 0.6}, (0.0, 0.5, 1.0 + 2e-9)).lookup(
        at(0.75), 'camera').T is not None


def test_order_of_arrival_does_not_matter():
    ordered, shuffled = filled(), filled(stamps=(0.2, 0.0, 0.1))
    for t in (0.0, 0.05, 0.17):
        np.testing.assert_array_equal(ordered.lookup(at(t), 'c').T, shuffled.lookup(at(t), 'c').T)


def test_a_repeated_stamp_is_said_and_ignored():
    buffer = filled()
    assert not buffer.add(at(0.1), turn(90, 50), 'map', '')
    np.testing.assert_array_equal(buffer.lookup(at(0.1), 'c').T, turn(10.0, 1.0))


def test_one_pose_that_is_hours_ahead_costs_nothing():
    buffer = filled()
    buffer.add(at(10_800), turn(0), 'map', '')
    buffer.add(at(0.3), turn(30, 3), 'map', '')
    assert buffer.lookup(at(0.35), 'camera') == Lookup(None, False, POSE_GAP)  # the next may come
    buffer.add(at(0.4), turn(40, 4), 'map', '')
    np.testing.assert_allclose(buffer.lookup(at(0.35), 'camera').T, turn(35, 3.5), atol=1e-12)


def test_the_buffer_is_bounded_in_seconds():
    buffer = PoseBuffer(Config(), keep=5.0)
    for i in range(20_000):
        buffer.add(at(i / 100), turn(0, i), 'map', '')
    assert buffer.lookup(at(199.0), 'c').T is not None
    assert buffer.lookup(at(100.0), 'c').T is None
    assert len(buffer._poses.stamps) < 2500


def test_forgetting_keeps_what_the_next_frame_needs():
    buffer = filled()
    buffer.forget(at(0.15))
    assert buffer.lookup(at(0.16), 'c').T is not None
    assert buffer.lookup(at(0.05), 'c').T is None
    buffer.clear()
    assert buffer.lookup(at(0.16), 'c') == Lookup(None, False, NO_POSE)


MOUNT = transform([0.2, 0.0, -0.1], np.array([0.5, -0.5, 0.5, -0.5]))


@pytest.mark.parametrize('child, values', [('', {}), ('camera', {}),
                                           ('base_link', {'pose.child_frame': 'camera'})])
def test_poses_of_the_camera_itself(child, values):
    buffer = filled(values, child=child)
    np.testing.assert_array_equal(buffer.lookup(at(0.1), 'camera').T, turn(10, 1))


@pytest.mark.parametrize('child, values', [('base_link', {}),
                                           ('', {'pose.child_frame': 'base_link'})])
def test_the_static_chain_leads_to_the_camera(child, values):
    buffer = filled(values, child=child)
    buffer.add_static(turn(30, 1), 'base_link', 'gimbal')
    buffer.add_static(MOUNT, 'gimbal', 'camera')
    np.testing.assert_allclose(buffer.lookup(at(0.1), 'camera').T,
                               turn(10, 1) @ turn(30, 1) @ MOUNT, atol=1e-12)


def test_the_chain_may_go_up_and_down():
    buffer = filled(child='imu')
    buffer.add_static(turn(30, 1), 'base_link', 'imu')
    buffer.add_static(MOUNT, 'base_link', 'camera')
    np.testing.assert_allclose(buffer.lookup(at(0.1), 'camera').T,
                               turn(10, 1) @ inverse(turn(30, 1)) @ MOUNT, atol=1e-12)


def test_the_extrinsic_setting_goes_before_tf_static():
    values = {'pose.extrinsic': [0.2, 0.0, -0.1, 0.5, -0.5, 0.5, -0.5]}
    buffer = filled(values, child='base_link')
    buffer.add_static(turn(77), 'base_link', 'camera')
    np.testing.assert_allclose(buffer.lookup(at(0.1), 'camera').T, turn(10, 1) @ MOUNT,
                               atol=1e-12)
    assert not buffer.notes


def test_an_extrinsic_without_a_child_frame_is_not_used_and_that_is_said():
    buffer = filled({'pose.extrinsic': [1.0, 0, 0, 0, 0, 0, 1]})
    np.testing.assert_array_equal(buffer.lookup(at(0.1), 'camera').T, turn(10, 1))
    assert 'pose.child_frame' in buffer.notes['extrinsic']


def test_an_extrinsic_that_is_no_rotation_is_refused():
    with pytest.raises(PersemError, match='pose.extrinsic'):
        PoseBuffer(updated(Config(), {'pose.extrinsic': [1.0, 0, 0, 0, 0, 0, 0.5]}))


def test_a_camera_whose_mount_was_published_and_not_heard_is_not_mapped_without_it():
    buffer = filled()
    assert buffer.lookup(at(0.1), 'camera').T is not None       # it is mounted on nothing
    buffer.unheard = 'rosbag2_player'
    assert buffer.lookup(at(0.1), 'camera') == Lookup(None, False, NO_MOUNT)
    assert not fixed(buffer, 'camera')
    sentence = mount_sentence(buffer, 'camera')
    for part in ('rosbag2_player publishes /tf_static volatile', '--delay 3', 'transient_local',
                 '--qos-profile-overrides-path', '--set pose.child_frame=camera'):
        assert part in sentence
    buffer.add_static(MOUNT, 'base_link', 'camera')
    assert buffer.lookup(at(0.1), 'camera') == Lookup(None, False, UNSAID)
    buffer = filled({'pose.child_frame': 'camera'})
    buffer.unheard = 'rosbag2_player'
    assert buffer.lookup(at(0.1), 'camera').T is not None       # the settings say so


def test_a_chain_that_lacks_what_was_not_heard_says_so():
    buffer = filled({'pose.source': 'tf'}, stamps=())
    buffer.add_tf(at(0.0), turn(0), 'map', 'base_link')
    assert 'volatile' not in explain(buffer, at(0.0), 'camera')
    buffer.unheard = 'rosbag2_player'
    assert 'rosbag2_player publishes /tf_static volatile' in explain(buffer, at(0.0), 'camera')


def test_an_unknown_mounting_is_said_with_the_flags_that_help():
    buffer = filled(child='base_link')
    buffer.add_static(MOUNT, 'base_link', 'lidar')
    assert buffer.lookup(at(0.1), 'camera') == Lookup(None, False, NO_MOUNT)
    sentence = mount_sentence(buffer, 'camera')
    for part in ('base_link', 'camera', 'base_link -> lidar', '--set pose.extrinsic=',
                 '--set pose.child_frame=camera'):
        assert part in sentence
    buffer.add_static(MOUNT, 'lidar', 'camera')      # a late /tf_static is enough
    assert buffer.lookup(at(0.1), 'camera').T is not None


def test_poses_in_another_frame_than_the_map():
    buffer = filled(parent='odom')
    np.testing.assert_array_equal(buffer.lookup(at(0.1), 'camera').T, turn(10, 1))
    assert '--set frames.map=odom' in buffer.notes['map']
    placed = filled(parent='odom')
    placed.add_static(turn(90, 5), 'map', 'odom')
    np.testing.assert_allclose(placed.lookup(at(0.1), 'camera').T, turn(90, 5) @ turn(10, 1),
                               atol=1e-12)
    assert not placed.notes


def tf_buffer():
    """Return a buffer with map -> odom at 10 Hz, odom -> base_link at 20 Hz, a fixed camera."""
    buffer = PoseBuffer(updated(Config(), {'pose.source': 'tf'}))
    buffer.add_static(MOUNT, 'base_link', 'camera')
    for i in range(5):
        buffer.add_tf(at(i / 10), turn(i, i), 'map', 'odom')
    for i in range(9):
        buffer.add_tf(at(i / 20), turn(2 * i, 3 * i), 'odom', 'base_link')
    return buffer


def test_every_moving_transform_is_interpolated_by_itself():
    T = tf_buffer().lookup(at(0.175), 'camera').T
    np.testing.assert_allclose(T, turn(1.75, 1.75) @ turn(7, 10.5) @ MOUNT, atol=1e-6)


def test_tf_waits_for_the_slowest_and_knows_gaps():
    buffer = tf_buffer()
    buffer.add_tf(at(0.45), turn(0, 24), 'odom', 'base_link')
    assert buffer.lookup(at(0.42), 'camera') == Lookup(None, False, NO_POSE)
    buffer.add_tf(at(2.0), turn(0), 'map', 'odom')
    assert buffer.lookup(at(0.42), 'camera') == Lookup(None, True, POSE_GAP)
    assert buffer.lookup(at(0.1), 'nowhere') == Lookup(None, False, NO_POSE)
    assert "from 'map' to 'nowhere'" in explain(buffer, at(0.1), 'nowhere')
    assert 'base_link -> camera, map -> odom, odom -> base_link' in explain(buffer, at(0), 'x')


def test_the_explanation_names_the_times():
    text = explain(filled(stamps=(0.0, 0.25)), at(9), 'camera')
    for part in ('1700000009.000000000', '1700000000.000000000', '1700000000.250000000'):
        assert part in text


def test_tf_below_the_map_only():
    """What lies above both frames is not asked for, even where it does not reach."""
    buffer = tf_buffer()
    buffer.add_tf(at(0), turn(0), 'earth', 'map')
    assert buffer.lookup(at(0.2), 'camera').T is not None


def test_tf_whose_map_hangs_below_the_robot():
    buffer = PoseBuffer(updated(Config(), {'pose.source': 'tf'}))
    for t in (0.0, 0.1):
        buffer.add_tf(at(t), turn(10, 1), 'camera', 'map')
    np.testing.assert_allclose(buffer.lookup(at(0.05), 'camera').T, inverse(turn(10, 1)),
                               atol=1e-12)


def test_a_loop_in_tf_ends():
    buffer = PoseBuffer(updated(Config(), {'pose.source': 'tf'}))
    buffer.add_tf(at(0), turn(0), 'a', 'b')
    buffer.add_tf(at(0), turn(0), 'b', 'a')
    assert buffer.lookup(at(0), 'a').T is None


@given(st.lists(st.integers(0, 3000), min_size=2, max_size=30, unique=True),
       st.integers(0, 3000))
def test_against_a_plain_search(stamps, asked):
    buffer = PoseBuffer(Config())
    for s in stamps:
        buffer.add(s * 1_000_000, turn(0, s / 100), 'map', '')
    found = buffer.lookup(asked * 1_000_000, 'c')
    before = max((s for s in stamps if s <= asked), default=None)
    after = min((s for s in stamps if s >= asked), default=None)
    inside = before is not None and after is not None and after - before <= 500
    assert (found.T is not None) == inside
    if inside:
        assert found.T[0, 3] == pytest.approx(asked / 100)


def test_a_pose_comes_with_the_mount_of_the_camera():
    assert filled().lookup(at(0.1), 'camera').mount.tolist() == np.eye(4).tolist()
    buffer = filled({'pose.extrinsic': [0.2, 0.0, -0.1, 0.5, -0.5, 0.5, -0.5]}, child='body')
    found = buffer.lookup(at(0.1), 'camera')
    assert found.mount[:3, 3].tolist() == [0.2, 0.0, -0.1]
    placed = turn(10, 1.0) @ found.mount
    np.testing.assert_allclose(found.T, placed, atol=1e-9)


@pytest.mark.parametrize('source', ['topic', 'tf'])
def test_a_copy_goes_its_own_way(source):
    buffer = filled({'pose.source': source})
    for t in (0.0, 0.2):
        buffer.add_tf(at(t), turn(0.0, t), 'map', 'camera')
    copied = buffer.copy()
    known, later = copied.lookup(at(0.15), 'camera'), copied.lookup(at(0.3), 'camera')
    assert later.T is None
    np.testing.assert_array_equal(known.T, buffer.lookup(at(0.15), 'camera').T)
    buffer.add(at(0.4), turn(10.0), 'map', '')
    buffer.add_tf(at(0.4), turn(10.0), 'map', 'camera')
    assert buffer.lookup(at(0.3), 'camera').T is not None
    assert copied.lookup(at(0.3), 'camera').T is None
    buffer.clear()
    np.testing.assert_array_equal(copied.lookup(at(0.15), 'camera').T, known.T)
