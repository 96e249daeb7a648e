"""Whose frame the poses are in, and whose time they tell: a wrong map is refused with a reason."""

from camera import Camera, Repeating, transform
from harness import LATCHED, until
import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from test_map_topics import points_of
from tf2_msgs.msg import TFMessage

LIVE = {'sync.max_wait': 1.0, 'sync.queue': 2.0, 'map.rate': 5.0}


def test_odometry_in_odom_follows_a_moving_map_to_odom(ros):
    mapper = ros.mapper(LIVE, ['-r', 'pose:=/odom']).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    tf = ros.client.publisher(TFMessage, '/tf')
    with Repeating(lambda stamp: tf.publish(transform(stamp, 'map', 'odom', 100.0))):
        camera = Camera(ros.client, 'Odometry', 'odom', names={'pose': '/odom'})
        camera.fly(60, until=lambda: int(mapper.values().get('frames', 0)) >= 5)
    until(lambda: clouds and clouds[-1].width, mapper.values)
    assert clouds[-1].header.frame_id == 'map'
    assert np.abs(points_of(clouds[-1])['y'].mean() - 100.0) < 2.0


def test_odometry_in_odom_without_a_way_to_the_map_is_refused(ros):
    mapper = ros.mapper(LIVE).ready()
    Camera(ros.client, 'Odometry', 'odom').fly(60, until=lambda: "in the frame 'odom'" in
                                               mapper.output)
    mapper.says('-p frames.map:=odom')
    assert '--set' not in mapper.output and mapper.values()['voxels'] == '0'


def test_with_the_setting_that_it_names_it_maps(ros):
    mapper = ros.mapper({**LIVE, 'frames.map': 'odom'}).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    Camera(ros.client, 'Odometry', 'odom').fly(
        60, until=lambda: int(mapper.values().get('frames', 0)) >= 5)
    until(lambda: clouds and clouds[-1].width, mapper.values)
    assert clouds[-1].header.frame_id == 'odom'


@pytest.mark.parametrize('kind', ['tf', 'PoseStamped'])
def test_a_clock_ahead_is_refused(ros, kind):
    source = {'pose.source': 'tf'} if kind == 'tf' else {}
    mapper = ros.mapper({**LIVE, **source}).ready()
    camera = Camera(ros.client, kind, offset=5.0)
    with Repeating(camera.send_pose, 50.0):     # the localisation has run for long
        camera.fly(8, poses=False)
        camera.fly(60, poses=False, until=lambda: 'the clocks differ' in mapper.output)
    assert 's newer than the depth image' in mapper.output
    assert '-p pose.max_ahead:=' in mapper.output
    assert mapper.values()['frames'] == '0'


@pytest.mark.parametrize('kind', ['tf', 'PoseStamped'])
def test_a_clock_behind_is_told_with_its_distance(ros, kind):
    source = {'pose.source': 'tf'} if kind == 'tf' else {}
    mapper = ros.mapper({**LIVE, **source}).ready()
    camera = Camera(ros.client, kind, offset=-5.0)
    camera.fly(60, until=lambda: 'older than the image' in mapper.output)
    mapper.says('do the clocks differ')
    camera.fly(60, until=lambda: found(ros))        # the look at the first messages says so, too
    assert found(ros) and mapper.values()['frames'] == '0'


def found(ros):
    """Return what /diagnostics tells of the look at the first messages."""
    return [value.value for array in ros.diagnostics[-2:] for status in array.status
            if status.name == 'mapper: preflight' for value in status.values]
