"""~/map, ~/map_changes, ~/legend and the other images."""

import bags
from harness import LATCHED, Player, until
import numpy as np
from persem_ros.outputs.map.cloud import POINT
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.legend_files import load_legend
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import String

FRAMES = 12
HISTORY = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def points_of(cloud):
    """Return a cloud's points."""
    return np.frombuffer(cloud.data, POINT)


def test_a_late_subscriber_gets_the_latched_map(ros, tmp_path):
    mapper = ros.mapper({'map.rate': 10.0}).ready()
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    early = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    voxels = int(mapper.values()['voxels'])
    until(lambda: early and early[-1].width == voxels, mapper.values)
    # Nothing changes any more, so nothing is published: this one gets what is latched.
    late = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    until(lambda: late, 'the latched map')
    points = points_of(late[-1])
    assert len(points) == voxels
    index = np.stack([np.floor(points[axis] / 0.1 + 1e-3) for axis in 'xyz'], axis=1)
    assert np.array_equal(index, index[np.lexsort(index.T[::-1])])
    assert points['observations'].sum() == int(mapper.values()['observations'])
    assert late[-1].header.frame_id == 'map'


def test_changes_add_up_to_the_map(ros, tmp_path):
    mapper = ros.mapper({'map.rate': 10.0, 'refine.period': 0.2}).ready()
    whole = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    changes = ros.client.listen(PointCloud2, '/mapper/map_changes')
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0]
    voxels = int(mapper.values()['voxels'])

    def summed():
        state = {}
        for cloud in list(changes):
            for point in points_of(cloud):
                key = tuple(np.round([point['x'], point['y'], point['z']], 3))
                state[key] = tuple(point)
                if point['observations'] == 0:
                    del state[key]
        return state
    until(lambda: whole and whole[-1].width == voxels and len(summed()) == voxels, mapper.values)
    until(lambda: sorted(summed().values()) == sorted(map(tuple, points_of(whole[-1]))),
          'changes that add up to the map')
    assert mapper.call('reset')[0]
    Player(ros.client, bags.write(tmp_path / 'other', 1)).play()
    until(lambda: 0 < len(summed()) < voxels, 'voxels that are gone')


@pytest.mark.parametrize('settings, check', [
    ({'map.max_voxels': 50}, lambda p: len(p) == 50),
    ({'map.min_observations': FRAMES - 2},
     lambda p: len(p) and p['observations'].min() >= FRAMES - 2),
    ({'map.crop': 2.25}, lambda p: len(p) and np.linalg.norm(
        [p['x'] - (FRAMES - 1) / 10, p['y'], p['z'] - 1], axis=0).max() < 2.2501)])
def test_map_within_bounds(ros, tmp_path, settings, check):
    mapper = ros.mapper({'map.rate': 10.0, **settings}).ready()
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    until(lambda: clouds and check(points_of(clouds[-1])), mapper.values)
    assert clouds[-1].width < int(mapper.values()['voxels'])


def test_far_voxels_are_forgotten(ros, tmp_path):
    mapper = ros.mapper({'memory.max_voxels': 300, 'refine.period': 0.1}).ready()
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    until(lambda: int(mapper.values().get('forgotten voxels', 0)) > 0
          and int(mapper.values()['voxels']) <= 300, mapper.values)


def test_colours_overlay_source_and_legend(ros, tmp_path):
    path = tmp_path / 'bag'
    legend = load_legend('town')
    with RecordingWriter(path) as out:
        out.text('semantic/legend', legend.to_yaml(), latched=True)
        for i in range(FRAMES):
            out.pose('pose', bags.stamp(i - 0.5), 'map', bags.pose(i - 0.5))
            red = np.zeros((bags.HEIGHT, bags.WIDTH, 3), np.uint8)
            red[..., 0] = 200
            out.image('color/image', bags.stamp(i), 'camera', red, 'rgb8')
            bags.write_images(out, i)
        out.pose('pose', bags.stamp(FRAMES), 'map', bags.pose(FRAMES))
    mapper = ros.mapper({'qos.color': 'reliable', 'render.fill': 'input'}).ready()
    found = {name: ros.client.listen(Image, f'/mapper/{name}')
             for name in ('labels', 'labels_color', 'overlay', 'source')}
    texts = ros.client.listen(String, '/mapper/legend', LATCHED)
    # The node listens to colours as soon as it notices that somebody wants the overlay.
    player = Player(ros.client, path, HISTORY)
    whole = player.messages
    player.messages = [message for message in whole if message[0] == '/color/image']
    player.play()       # first, so that every frame finds its own however the topics are served
    until(lambda: mapper.values().get('color/image messages') == str(FRAMES), mapper.values)
    player.messages = [message for message in whole if message[0] != '/color/image']
    player.play()
    mapper.frames(FRAMES)
    until(lambda: all(len(images) == FRAMES for images in found.values()), mapper.values)
    until(lambda: texts and texts[-1].data == legend.to_yaml(), 'the legend of the recording')
    until(lambda: mapper.values()['frames'] == str(FRAMES), mapper.values)
    labels = np.frombuffer(found['labels'][-1].data, np.uint16)
    colors = np.frombuffer(found['labels_color'][-1].data, np.uint8).reshape(-1, 3)
    assert np.array_equal(colors, legend.colors(labels))
    mixed = np.frombuffer(found['overlay'][-1].data, np.uint8).reshape(-1, 3)
    assert np.abs(mixed[:, 0].astype(int) - (colors[:, 0] + 200.0) / 2).max() <= 1
    sources = np.frombuffer(found['source'][-1].data, np.uint8)
    assert set(sources) <= {0, 1, 2, 3, 4, 255} and (sources != 255).mean() > 0.9
    assert found['source'][-1].encoding == 'mono8'
