"""LiDARs, labels of another camera and tables of names: live as in a replay."""

from harness import LATCHED, Player, until
import numpy as np
from persem_ros.inputs.decode import clouds
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.legend import Legend
import pytest
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import String
from test_live_equals_replay import assert_same_maps, replayed
import test_other_sensors as other

FRAMES = 6
POSE = {'topics.pose': 'odom', 'memory.voxel_size': 0.5}


def lidar(path):
    """Write label images and a LiDAR's clouds."""
    return other.write(path, lambda out, i: out.cloud(
        'livox/points', other.bags.stamp(i), 'lidar', other.cloud(other.scan(i))))


def labelled(path):
    """Write labelled clouds and nothing else, of a LiDAR that names its points."""
    with RecordingWriter(path) as out:
        for i in range(FRAMES):
            points = other.scan(i)
            made = other.cloud(points, other.classes(points[:, 0] + 0.2 * i))
            out.pose('odom', other.bags.stamp(i), 'map', other.body(i), 'Odometry', 'lidar')
            out.cloud('points', other.bags.stamp(i), 'lidar', made)
    return path


@pytest.mark.parametrize('write, settings', [
    (lidar, {'depth.source': 'cloud', 'topics.points': 'livox/points'}),
    (labelled, {'topics.points': 'points'}),
    (lambda path: other.write(path, other.depth_image, labels_info='semantic/image/camera_info'),
     {})], ids=['lidar', 'labelled_clouds', 'another_camera'])
def test_the_map_of_a_replay(ros, tmp_path, write, settings):
    path, saved = write(tmp_path / 'bag'), tmp_path / 'live.persem'
    expected = replayed(path, tmp_path / 'replay', **POSE, **settings)
    mapper = ros.mapper({**POSE, **settings, 'map.path': str(saved)}).ready()
    refined = ros.client.listen(PointCloud2, '/mapper/points')
    Player(ros.client, path, LATCHED_DEEP).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    assert len(expected.saved.cell) > 300
    assert_same_maps(expected, store.load(saved))
    if write is labelled:
        until(lambda: len(refined) == FRAMES, mapper.values)
        cloud = clouds.structured(refined[-1])
        assert cloud.shape == (1, 3000) and cloud.dtype.itemsize == other.POINT.itemsize
        assert (cloud['ring'] == 7).all() and set(cloud['label'].ravel()) == {1, 2}
        assert refined[-1].header.frame_id == 'lidar'


LATCHED_DEEP = type(LATCHED)(depth=1000, durability=LATCHED.durability)
GRASS, ROAD = '{"1": {"class": "grass"}, "2": {"class": "road"}}', \
    '{"1": {"class": "road"}, "7": {"class": "grass"}, "8": {"class": "car"}}'


def names_of(text):
    """Return {id: name} of a legend's YAML."""
    return {item.id: item.name for item in Legend.from_yaml(text).classes} if text else {}


def test_names_in_json_keep_their_ids_when_the_network_renumbers(ros, tmp_path):
    path = labelled(tmp_path / 'bag')
    mapper = ros.mapper({**POSE, 'topics.points': 'points'}).ready()
    texts = ros.client.listen(String, '/mapper/legend', LATCHED)
    tables = ros.client.publisher(String, '/semantic/legend', LATCHED)
    tables.publish(String(data=GRASS))
    until(lambda: texts and names_of(texts[-1].data) == {1: 'grass', 2: 'road'}, mapper.values)
    tables.publish(String(data=ROAD))
    until(lambda: names_of(texts[-1].data) == {1: 'grass', 2: 'road', 0: 'car'}, mapper.values)
    refined = ros.client.listen(PointCloud2, '/mapper/points')
    Player(ros.client, path).play()
    mapper.frames(FRAMES)
    until(lambda: len(refined) == FRAMES, mapper.values)
    found = set(clouds.structured(refined[0])['label'].ravel())
    assert 2 in found and 1 not in found        # the cloud's 1 is the map's road


def test_label_info_in_and_out(ros, tmp_path):
    vision = pytest.importorskip('vision_msgs.msg')
    saved = tmp_path / 'map.persem'
    settings = {**POSE, 'topics.points': 'points', 'map.path': str(saved)}
    mapper = ros.mapper(settings).ready()
    infos = ros.client.listen(vision.LabelInfo, '/mapper/label_info', LATCHED)
    tables = ros.client.publisher(vision.LabelInfo, '/semantic/legend', LATCHED, 1)
    tables.publish(vision.LabelInfo(class_map=[
        vision.VisionClass(class_id=1, class_name='grass'),
        vision.VisionClass(class_id=2, class_name='road')]))
    told = {1: 'grass', 2: 'road'}
    until(lambda: infos and names_in(infos[-1]) == told, mapper.values)
    Player(ros.client, labelled(tmp_path / 'bag')).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    until(lambda: names_in(infos[-1]) == told, 'the names after a refinement')
    assert {c.id: c.name for c in store.load(saved).legend.classes} == told
    assert mapper.stop() == 0
    # A second run knows the names of the file before any table comes.
    infos.clear()
    again = ros.mapper({**settings, 'map.load': True}).ready()
    until(lambda: infos and names_in(infos[-1]) == told, again.values)


def names_in(info):
    """Return {id: name} of a LabelInfo."""
    return {item.class_id: item.class_name for item in info.class_map}


def test_what_is_no_table_of_names_is_one_warning(ros):
    mapper = ros.mapper().ready()
    tables = ros.client.publisher(String, '/semantic/legend', LATCHED)
    tables.publish(String(data='{"tree": 3}'))
    mapper.says('is no id with a name')
    assert 'Traceback' not in mapper.output


def test_labels_of_another_camera_without_its_info_are_refused_in_log_and_diagnostics(
        ros, tmp_path):
    path = other.write(tmp_path / 'bag', other.depth_image, labels_info='')
    mapper = ros.mapper(POSE).ready()
    images = ros.client.listen(Image, '/mapper/labels')
    Player(ros.client, path, LATCHED_DEEP).play()
    mapper.says('-p topics.labels_info:=')
    assert not images and '--set' not in mapper.output
    until(lambda: any(value.value for array in ros.diagnostics[-2:] for status in array.status
                      if status.name == 'mapper: mapping' for value in status.values
                      if value.key.startswith('dropped: labels of another')), mapper.values)


def test_ids_of_the_map_are_those_of_the_points(ros, tmp_path):
    mapper = ros.mapper({**POSE, 'topics.points': 'points', 'map.rate': 5.0}).ready()
    found = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    Player(ros.client, labelled(tmp_path / 'bag')).play()
    mapper.frames(FRAMES)
    until(lambda: found and found[-1].width == int(mapper.values()['voxels']), mapper.values)
    assert set(np.unique(clouds.structured(found[-1])['label'])) == {1, 2}
