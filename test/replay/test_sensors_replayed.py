"""Replays of what is not a plain label and depth image: the whole way, from the command line."""

import json

import bags
import numpy as np
from persem_ros.cli import main
from persem_ros.core.transforms import transform
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest
from replays import recorded

N = 2000        # points of a cloud: more than a page of the report is wide
POINT = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u2')])


def replayed(path, out, *settings):
    """Replay; return the status and the map as {(x, y, z) of a voxel: label}."""
    status = main(['replay', str(path), '--out', str(out), '--set', 'memory.voxel_size=0.5',
                   *[word for one in settings for word in ('--set', one)]])
    columns = store.load(out / 'map.persem').memory().voxels() if status == 0 else {}
    return status, {tuple(v): int(c) for v, c in zip(
        columns.get('voxel', np.empty(0)).tolist(), columns.get('label', ()))}


def walls(path, extra, labels=lambda i: bags.labels(0) * 0 + 1 + (np.arange(16) > 7),
          encoding='mono16'):
    """Write a camera that stands before a wall, classes 1 and 2."""
    with RecordingWriter(path) as out:
        for i in range(6):
            at = bags.stamp(i)
            extra(out, i)
            out.pose('pose', at, 'map', transform((0, 0, 1), (0.5, -0.5, 0.5, -0.5)))
            out.camera_info('depth/camera_info', at, 'camera', 16, 12, bags.K)
            out.image('depth/image', at, 'camera', bags.depth(0), '32FC1')
            out.image('semantic/image', at, 'camera', labels(i).astype(np.uint16), encoding)
    return path


def test_names_stay_classes_when_their_numbers_change(tmp_path, capsys):
    still = replayed(walls(tmp_path / 'still', lambda out, i: None), tmp_path / 'a')[1]

    def tables(out, i):
        a, b = (1, 2) if i < 3 else (2, 1)
        out.text('semantic_labels', json.dumps({str(a): {'class': 'tree'},
                                                str(b): {'class': 'road'}}),
                 stamp=bags.stamp(i))

    path = walls(tmp_path / 'turned', tables,
                 lambda i: np.tile(np.where((np.arange(16) > 7) == (i < 3), 2, 1), (12, 1)))
    status, found = replayed(path, tmp_path / 'b')
    assert status == 0 and found == still and set(found.values()) == {1, 2}
    legend = recorded(tmp_path / 'b' / 'refined')[0]['/mapper/legend'][0].data
    assert 'tree' in legend and 'road' in legend


def test_a_table_that_cannot_be_read_is_a_warning(tmp_path, caplog):
    def broken(out, i):
        out.text('semantic/legend', 'no legend', stamp=bags.stamp(i))

    status, found = replayed(walls(tmp_path / 'bag', broken), tmp_path / 'out')
    assert status == 0 and found
    warnings = [r.getMessage() for r in caplog.records if 'semantic/legend' in r.getMessage()]
    assert len(warnings) == 1 and 'expected vision_msgs/LabelInfo' in warnings[0]


@pytest.mark.parametrize('scale', [1, 4])
def test_a_confident_minority_wins_the_vote_of_a_voxel(tmp_path, scale):
    def sure(out, i):
        w = np.where(np.arange(16) % 4 == 0, 255, 40).astype(np.uint8)
        out.image('semantic/confidence', bags.stamp(i), 'camera', np.tile(w, (12, 1)), 'mono8')

    path = walls(tmp_path / 'bag', sure, lambda i: np.tile(
        np.where(np.arange(16) % 4 == 0, 7, 1), (12, 1)))
    size = 'memory.voxel_size=2'
    assert set(replayed(path, tmp_path / 'a', size)[1].values()) == {1}
    assert set(replayed(path, tmp_path / 'b', size, 'topics.confidence=semantic/confidence'
                        )[1].values()) == {7}


@pytest.mark.parametrize('low, high, dtype, encoding, least, classes', [
    (10, 90, np.float32, '32FC1', 50, {2}), (10, 90, np.float32, '32FC1', 0, {1, 2}),
    (10, 90, np.float32, '32FC1', -50, {1}),            # ZED: 1 to 100, large is bad
    (3, 12, np.uint8, 'mono8', 8, {2}),                 # RealSense L500: 0 to 15, large is good
    (90, 250, np.uint8, 'mono8', -200, {1})])           # OAK: 0 to 255, large is bad
def test_depth_that_is_not_to_be_trusted_is_left_out(tmp_path, low, high, dtype, encoding, least,
                                                     classes):
    def doubt(out, i):
        trust = np.where(np.arange(16) > 7, high, low).astype(dtype)
        out.image('trust', bags.stamp(i), 'camera', np.tile(trust, (12, 1)), encoding)

    path, topic = walls(tmp_path / 'bag', doubt), 'topics.depth_confidence=trust'
    assert set(replayed(path, tmp_path / 'out', topic, f'depth.min_confidence={least}'
                        )[1].values()) == classes


def test_a_labelled_cloud_is_mapped_and_its_refined_labels_go_out(tmp_path, capsys):
    rng = np.random.default_rng(0)
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            points = np.zeros(N, POINT)
            points['x'], points['y'] = rng.uniform(-4, 4, (2, N))
            points['z'] = -1.75
            points['label'] = np.where(points['x'] < 0, 3, 4)
            points['label'][:40] = 4 if i == 2 else points['label'][:40]
            out.pose('pose', bags.stamp(i), 'map', transform((0, 0, 2), (0, 0, 0, 1)))
            out.cloud('points', bags.stamp(i), 'lidar', points)
    assert main(['info', str(tmp_path / 'bag')]) == 1
    assert '(--set topics.points=/points)' in capsys.readouterr().out
    assert main(['info', str(tmp_path / 'bag'), '--set', 'topics.points=points']) == 0
    assert 'usable' in capsys.readouterr().out
    status, found = replayed(tmp_path / 'bag', tmp_path / 'out', 'topics.points=points')
    assert status == 0
    assert {(c, v[0] < 0, v[2]) for v, c in found.items()} == {(3, True, 0), (4, False, 0)}
    clouds = recorded(tmp_path / 'out' / 'refined')[0]['/mapper/points']
    assert len(clouds) == 5 and clouds[2].width == N
    refined = clouds[2].data.view(POINT)
    assert (refined['label'] == np.where(refined['x'] < 0, 3, 4)).mean() > 0.95
    metrics = json.loads((tmp_path / 'out' / 'metrics.json').read_text())
    assert metrics['methods']['persem']['flicker'] is None
