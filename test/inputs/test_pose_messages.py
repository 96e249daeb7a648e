"""Pose messages to matrices: every type, and what is refused."""

from types import SimpleNamespace

from message_forms import MAKE, STAMP
import numpy as np
from persem_ros.core.transforms import transform
from persem_ros.inputs.decode import pose_messages
from persem_ros.inputs.decode.messages import BadMessage
import pytest


@pytest.mark.parametrize('kind, child', [
    ('PoseStamped', ''), ('PoseWithCovarianceStamped', ''), ('Odometry', 'base_link'),
    ('TransformStamped', 'base_link')])
def test_poses_of_every_type(form, kind, child):
    T = transform([1.0, -2.0, 3.0], np.array([0.5, -0.5, 0.5, 0.5]))
    _, msg = MAKE.pose(STAMP, '/map', T, kind, '/base_link')
    at, found, parent, below = pose_messages.pose(form(msg))
    assert (at, parent, below) == (STAMP, 'map', child)
    np.testing.assert_allclose(found, T, atol=1e-15)


def with_quaternion(*q, position=(0.0, 0.0, 0.0)):
    msg = MAKE.pose(STAMP, 'map', np.eye(4))[1]
    msg.pose.orientation = MAKE.make('geometry_msgs/msg/Quaternion', *q)
    msg.pose.position = MAKE.make('geometry_msgs/msg/Point', *position)
    return msg


def test_a_quaternion_near_length_one_is_normalised():
    T = pose_messages.pose(with_quaternion(0.0, 0.0, 0.0, 0.991))[1]
    np.testing.assert_array_equal(T, np.eye(4))


@pytest.mark.parametrize('q', [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.98), (0.0, 0.0, 0.0, 1.02),
                               (np.nan, 0.0, 0.0, 1.0), (np.inf, 0.0, 0.0, 1.0)])
def test_other_quaternions_are_refused(q):
    with pytest.raises(BadMessage, match='quaternion') as caught:
        pose_messages.pose(with_quaternion(*q))
    assert caught.value.reason == 'quaternion not of length 1'


def test_a_position_that_is_not_finite_is_refused():
    with pytest.raises(BadMessage, match='position'):
        pose_messages.pose(with_quaternion(0.0, 0.0, 0.0, 1.0, position=(0.0, np.nan, 0.0)))


def test_one_bad_transform_does_not_spoil_the_others():
    good = MAKE.transform(STAMP, 'map', 'a', np.eye(4))
    bad = MAKE.transform(STAMP, 'map', 'b', np.eye(4))
    bad.transform.rotation = MAKE.make('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 0.0)
    found, faults = pose_messages.transforms(SimpleNamespace(transforms=[bad, good]))
    assert [item[3] for item in found] == ['a'] and len(faults) == 1
