"""A recording played into the node gives the map of `persem replay`, and its images."""

import bags
from harness import LATCHED, SETTINGS
import numpy as np
from persem_ros.inputs.decode import messages
from persem_ros.outputs.map import store
from persem_ros.outputs.map.cloud import POINT
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated
import pytest
from sensor_msgs.msg import Image, PointCloud2

FRAMES = 40
HISTORY = {'memory.max_history': 128}


def replayed(path, folder, **settings):
    """Replay a recording with the node's settings; return its StoredMap."""
    values = {**SETTINGS, **HISTORY, **settings}
    replay(path, folder, updated(Config(), values), report=False)
    return store.load(folder / 'map.persem')


def assert_same_maps(one, other):
    """Compare everything that two map files remember, settings and wall-clock apart."""
    for name, value in vars(one.saved).items():
        again = getattr(other.saved, name)
        if isinstance(value, np.ndarray):
            assert np.array_equal(value, again), name
        elif name == 'frames':
            assert [(f.t, f.sensor, f.stamp) for f in value] == \
                [(f.t, f.sensor, f.stamp) for f in again]
        elif name == 'habits':      # parameters of the method geometry
            assert {k: a.tolist() for k, a in value.items()} == {
                k: a.tolist() for k, a in again.items()}
        elif name != 'session':
            assert value == again, name


@pytest.mark.parametrize(('method', 'height'), [
    ('persem', ''), ('geometry', ''), ('geometry', 'height: [-1, 0.4]')])
def test_played_by_ros2_bag(ros, tmp_path, method, height):
    path, legend = bags.write(tmp_path / 'bag', FRAMES), tmp_path / 'legend.yaml'
    legend.write_text(f'classes:\n- {{id: 1, name: low, {height}}}\n')
    chosen = {'refine.method': method, 'labels.legend': str(legend)}
    expected = replayed(path, tmp_path / 'replay', **chosen)
    saved = tmp_path / 'live.persem'
    mapper = ros.mapper({'map.path': str(saved), 'map.rate': 20.0, **chosen}).ready()
    images = ros.client.listen(Image, '/mapper/labels')
    clouds = ros.client.listen(PointCloud2, '/mapper/map', LATCHED)
    player = ros.run('ros2', 'bag', 'play', '--rate', '2', '--delay', '3', str(path))
    mapper.frames(FRAMES)
    player.stop()
    assert mapper.values()['dropped'] == '0', mapper.output
    done, said = mapper.call('refine')
    assert done and f'refined {len(expected.saved.cell)} voxels' in said
    done, said = mapper.call('save_map')
    assert done and str(saved) in said
    assert_same_maps(expected, store.load(saved))
    assert bool(expected.saved.habits) == (method == 'geometry')
    assert ('1 -10 4' in (expected.saved.fitted_by or ())) == bool(height)
    assert [messages.stamp_ns(m) for m in images] == [bags.stamp(i) for i in range(FRAMES)]
    assert {(m.header.frame_id, m.encoding, m.width, m.height, m.step) for m in images} == \
        {('camera', 'mono16', bags.WIDTH, bags.HEIGHT, 2 * bags.WIDTH)}
    points = final_points(clouds, len(expected.saved.cell), int(expected.saved.label.sum()))
    assert points.dtype.itemsize == 32


def final_points(clouds, count, label_sum):
    """Wait for the map after the refinement; return its points."""
    from harness import until

    def last():
        if not clouds:
            return None
        cloud = clouds[-1]
        points = np.frombuffer(cloud.data, POINT)
        assert [f.name for f in cloud.fields] == list(POINT.names)
        assert (cloud.point_step, cloud.header.frame_id) == (32, 'map')
        return points if len(points) == count and points['label'].sum() == label_sum else None
    return until(lambda: last() is not None and [last()], 'the whole map')[0]
