"""A click into the map is answered with the sentences of persem map query and markers."""

import bags
from geometry_msgs.msg import PointStamped, TransformStamped
from harness import LATCHED, Player, until
import numpy as np
from persem_ros.outputs.map.cloud import POINT
import pytest
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

FRAMES = 6


@pytest.fixture
def asked(ros, tmp_path):
    """Return (ask, a point of the map): ask(xyz, frame) gives the (text, markers) of a click."""
    mapper = ros.mapper({'map.rate': 10.0}).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    texts = ros.client.listen(String, '/mapper/explanation')
    markers = ros.client.listen(MarkerArray, '/mapper/explanation_marker')
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0]
    voxels = int(mapper.values()['voxels'])
    until(lambda: clouds and clouds[-1].width == voxels, mapper.values)
    points = np.frombuffer(clouds[-1].data, POINT)
    out = ros.client.publisher(PointStamped, '/clicked_point')

    def ask(xyz, frame='map'):
        before = len(texts), len(markers)
        click = PointStamped()
        click.header.frame_id = frame
        click.point.x, click.point.y, click.point.z = (float(x) for x in xyz)
        out.publish(click)
        until(lambda: len(texts) > before[0] and len(markers) > before[1], 'an answer')
        return texts[-1].data, markers[-1].markers
    return ask, points[np.argmax(points['observations'])]


def test_a_click_is_explained(asked):
    ask, point = asked
    middle = np.array([point[axis] for axis in 'xyz'])
    text, (cube, words, rays) = ask(middle + 0.02)
    assert f'label {point["label"]} class {point["label"]}' in text
    assert f'{point["observations"]} observations' in text and 'majority:' in text
    assert (cube.type, words.type, rays.type) == (
        Marker.CUBE, Marker.TEXT_VIEW_FACING, Marker.LINE_LIST)
    place = cube.pose.position
    assert np.allclose([place.x, place.y, place.z], middle, atol=1e-5)
    assert cube.header.frame_id == 'map' and 'observations' in words.text
    assert len(rays.points) == len(rays.colors) == 2 * point['observations']
    eyes = {(round(p.x, 3), round(p.y, 3), round(p.z, 3)) for p in rays.points[::2]}
    assert eyes <= {(i / 10, 0.0, 1.0) for i in range(FRAMES)}
    end = np.array([rays.points[1].x, rays.points[1].y, rays.points[1].z])
    assert (np.abs(end - middle) <= 0.0501).all()


def test_a_click_beside_the_map_and_from_elsewhere(ros, asked):
    client, (ask, point) = ros.client, asked
    middle = np.array([point[axis] for axis in 'xyz'])
    text, _ = ask(middle - [0.0, 0.0, 0.13])        # in front of the wall, two voxels away
    assert 'label ' in text
    text, found = ask(middle + 50)
    assert 'nothing was observed within 2 voxels of' in text
    assert [marker.action for marker in found] == [Marker.DELETEALL]
    assert "frame 'moon' is not connected to 'map'" in ask(middle, 'moon')[0]
    assert 'expected three finite numbers' in ask([np.nan, 0, 0])[0]
    # A frame that /tf_static ties to the map: 10 m along its x.
    out = client.publisher(TFMessage, '/tf_static', LATCHED)
    tied = TransformStamped(child_frame_id='survey')
    tied.header.frame_id = 'map'
    tied.transform.translation.x, tied.transform.rotation.w = 10.0, 1.0
    out.publish(TFMessage(transforms=[tied]))
    until(lambda: 'label ' in ask(middle - [10.0, 0.0, 0.0], 'survey')[0], 'the transform')
