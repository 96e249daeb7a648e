"""What a look finds before a replay, a node says of its first messages, as ROS wants it typed."""

import bags
from harness import Player, until
import numpy as np
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.legend_files import load_legend
import pytest
from test_frames_and_poses import DOWN, ground, H, K, swaying, W
from test_sensors_live import LATCHED_DEEP

FRAMES = 24         # the look waits for twenty label images
ONES = np.ones((H, W), np.uint8)
TOWN = load_legend('town')
INSTANCES = (1 + np.arange(W) % 2)[None, :].repeat(H, 0).astype(np.int32) * 1000 \
    + np.arange(W, dtype=np.int32)
LENGTHS = np.sqrt(1 + ((np.arange(W) - K[0, 2]) / K[0, 0]) ** 2
                  + ((np.arange(H) - K[1, 2]) / K[1, 1])[:, None] ** 2).astype(np.float32)


def written(path, child='base_link', mount=DOWN, placed=np.eye(4), every=1, depth=lambda d: d,
            labels=ONES, encoding='mono8', info='camera'):
    """Write a flight; *placed* leads from what the poses place to the body."""
    with RecordingWriter(path) as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', mount, static=True)
        for i in range(FRAMES + 2):
            if i % every == 0:
                out.pose('pose', bags.stamp(i), 'map', swaying(i) @ placed, *(
                    ('Odometry', child) if child else ()))
            at, seen = bags.stamp(i), ground(swaying(i) @ mount)
            out.camera_info('depth/camera_info', at, info, W, H, K)
            out.image('depth/image', at, 'camera', depth(seen), '32FC1')
            out.image('semantic/image', at, 'camera', labels, encoding)
    return path


@pytest.mark.parametrize('kind, settings, words', [
    ({'child': ''}, {}, ['-p pose.child_frame:=base_link', '-p pose.child_frame:=camera']),
    ({'placed': DOWN}, {}, ['depth of one frame', '-p pose.child_frame:=camera']),
    ({'every': 4}, {}, ['one every 0.4 s', '-p pose.max_gap:=0.36']),
    ({'depth': lambda d: np.rint(1000 * d)}, {}, ['-p depth.scale:=0.001']),
    ({'depth': lambda d: d * LENGTHS}, {}, ['-p depth.kind:=ray']),
    ({'labels': INSTANCES, 'encoding': '32SC1'}, {}, ['-p labels.divisor:=1000']),
    ({'labels': TOWN.colors(ONES), 'encoding': 'rgb8'}, {}, ['-p labels.legend:=town']),
    ({'info': 'color'}, {}, ["'color'", '-p topics.camera_info:=']),
], ids=['unsaid', 'contradicted', 'seldom', 'millimetres', 'ray', 'instances', 'colours', 'info'])
def test_the_node_says_what_to_type(ros, tmp_path, kind, settings, words):
    path = written(tmp_path / 'bag', **kind)
    mapper = ros.mapper({'topics.pose': 'pose', 'memory.voxel_size': 0.5, **settings}).ready()
    Player(ros.client, path, LATCHED_DEEP).play()
    for said in words:
        mapper.says(said)
    assert '--set' not in mapper.output and 'Traceback' not in mapper.output


@pytest.mark.parametrize('kind, settings', [
    ({'child': ''}, {'pose.child_frame': 'base_link'}),
    ({'placed': DOWN}, {'pose.child_frame': 'camera'}),
    ({'depth': lambda d: np.rint(1000 * d)}, {'depth.scale': 0.001}),
    ({'depth': lambda d: d * LENGTHS}, {'depth.kind': 'ray'}),
    ({'labels': INSTANCES, 'encoding': '32SC1'}, {'labels.divisor': 1000}),
    ({'labels': TOWN.colors(ONES), 'encoding': 'rgb8'}, {'labels.legend': 'town'}),
], ids=['unsaid', 'contradicted', 'millimetres', 'ray', 'instances', 'colours'])
def test_with_what_it_says_it_maps_and_says_no_more(ros, tmp_path, kind, settings):
    path = written(tmp_path / 'bag', **kind)
    mapper = ros.mapper({'topics.pose': 'pose', 'memory.voxel_size': 0.5, **settings}).ready()
    Player(ros.client, path, LATCHED_DEEP).play()
    mapper.frames(FRAMES)
    until(lambda: verdicts(ros) and verdicts(ros)[-1] != 'waiting for the first messages',
          lambda: verdicts(ros))
    assert verdicts(ros)[-1] == 'nothing found'
    assert '-p ' not in mapper.output, mapper.output


def verdicts(ros):
    """Return what /diagnostics said of the look, one after the other."""
    return [status.message for array in ros.diagnostics for status in array.status
            if status.name == 'mapper: preflight']
