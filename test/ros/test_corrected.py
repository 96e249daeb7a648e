"""Corrected trajectories on a topic: the node's map moves as persem map move would move it."""

import bags
from camera import Camera, MAKE, Repeating, STORE, transform as tf
from harness import LATCHED, Player
from nav_msgs.msg import Path
import numpy as np
from persem_ros.core.transforms import transform
from persem_ros.inputs.trajectory import from_path, PATH
from persem_ros.outputs.map import store
from persem_ros.outputs.map.move import move_session
from test_live_equals_replay import replayed
from tf2_msgs.msg import TFMessage

FRAMES = 20


def test_the_map_moves_with_the_path(ros, tmp_path):
    bag, saved = bags.write(tmp_path / 'bag', FRAMES), tmp_path / 'live.persem'
    mapper = ros.mapper({'map.path': str(saved), 'topics.trajectory': '/slam/path',
                         'trajectory.period': 0.1}).ready()
    Player(ros.client, bag).play()
    mapper.frames(FRAMES)
    drift = [(bags.stamp(i), transform((0.0, 0.05 * i, 0.0), (0.0, 0.0, 0.0, 1.0)) @ bags.pose(i))
             for i in (0, 7, FRAMES - 1)]
    message = MAKE.path(drift[-1][0], 'map', drift)
    out = ros.client.publisher(Path, '/slam/path', LATCHED)
    out.publish(bytes(STORE.serialize_cdr(message, PATH)))
    mapper.says('the map moved with /slam/path: ')
    for service in ('refine', 'save_map'):
        assert mapper.call(service)[0], mapper.output
    stored = replayed(bag, tmp_path / 'replay', **{'memory.max_history': 0})
    wanted = move_session(stored, 0, from_path(message, 'map', ''))
    found = store.load(saved).saved
    for name in ('block_index', 'cell', 'history_frame', 'history_label', 'history_confidence',
                 'history_offset', 'evidence_sum', 'starts', 'changes'):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name
    assert np.array_equal(found.frames.placed, wanted.frames.placed) and found.rho is not None
    assert found.max_history == 0       # the default bounds only what a refinement reads
    assert mapper.values()['dropped'] == '0'
    out.publish(bytes(STORE.serialize_cdr(MAKE.path(0, 'odom', drift), PATH)))
    mapper.says("the path is in the frame 'odom'")


def test_a_localisation_that_jumps_is_said_once(ros):
    mapper = ros.mapper().ready()
    out = ros.client.publisher(TFMessage, '/tf')
    camera = Camera(ros.client, frame='odom')
    at = [0.0]
    with Repeating(lambda stamp: out.publish(tf(stamp, 'map', 'odom', at[0]))):
        camera.fly(20, until=lambda: int(mapper.values().get('frames', 0)) > 2)
        at[0] = 1.5
        mapper.says('map -> odom on /tf jumped by 1.5 m')
        at[0] = 3.0
        camera.fly(1)
    assert mapper.output.count('jumped by') == 1
