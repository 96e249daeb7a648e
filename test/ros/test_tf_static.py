"""Mounts on /tf_static: published latched, volatile, both, or too early to be heard."""

from camera import Camera, transform
from harness import LATCHED, RELIABLE
import pytest
from tf2_msgs.msg import TFMessage

BODY = {'pose.child_frame': 'base_link'}


def publish(client, parent, child, qos, readers=1):
    """Publish one static transform, once; return its publisher."""
    out = client.publisher(TFMessage, '/tf_static', qos, readers)
    out.publish(transform(0, parent, child))
    return out


def fly(ros, mapper):
    """Let frames come until ten are mapped."""
    Camera(ros.client).fly(60, until=lambda: int(mapper.values().get('frames', 0)) >= 10)
    mapper.frames(10)
    assert 'ncompatible' not in mapper.output and 'no transform' not in mapper.output


def test_a_volatile_publisher_is_heard(ros):
    mapper = ros.mapper(BODY).ready()
    publish(ros.client, 'base_link', 'camera', RELIABLE)
    fly(ros, mapper)


def test_latched_and_volatile_ones_are_heard_beside_each_other(ros):
    early = publish(ros.client, 'base_link', 'camera_link', LATCHED, readers=0)
    mapper = ros.mapper(BODY).ready()
    publish(ros.client, 'camera_link', 'camera', RELIABLE)
    fly(ros, mapper)
    assert early.get_subscription_count() == 2


@pytest.mark.parametrize('settings', [{'sync.max_wait': 1.0}, {**BODY, 'sync.max_wait': 1.0}])
def test_no_frame_is_mapped_without_a_mount_that_came_too_early(ros, settings):
    early = publish(ros.client, 'base_link', 'camera', RELIABLE, readers=0)
    mapper = ros.mapper(settings).ready()
    Camera(ros.client).fly(60, until=lambda: 'publishes /tf_static volatile' in mapper.output)
    mapper.says('client publishes /tf_static volatile')
    mapper.says('--qos-profile-overrides-path')
    assert mapper.values()['frames'] == '0'
    assert early.get_subscription_count() == 1
