"""What the node says: names after remapping, ready, flags of ROS, whose diagnostics they are."""

import bags
from camera import Camera
from harness import Player, until
import numpy as np
from persem_ros.settings.palette import GREY
from sensor_msgs.msg import Image
from test_parameters import param

REMAPPED = ['-r', 'semantic/image:=/seg/labels', '-r', 'depth/image:=/cam/depth',
            '-r', 'depth/camera_info:=/cam/info', '-r', 'pose:=/odom']


def test_it_says_what_it_listens_to_and_that_it_is_ready(ros):
    mapper = ros.mapper(arguments=REMAPPED).ready()
    first = mapper.output.splitlines()[0]
    for words in ('/seg/labels (labels)', '/cam/depth (depth)', '/cam/info (camera_info)',
                  '/odom (pose)', '/mapper/'):
        assert words in first, first
    mapper.says('ready')
    mapper.says('no complete set of messages')
    line = next(line for line in mapper.output.splitlines() if 'no complete set' in line)
    assert '/seg/labels (labels): 0 messages' in line and '/odom (pose)' in line
    assert 'semantic/image' not in line


def test_transports_are_looked_for_below_the_remapped_name(ros):
    from sensor_msgs.msg import CompressedImage
    ros.mapper({'qos.labels': 'auto', 'qos.depth': 'auto'}, REMAPPED).ready()
    for topic in ('/seg/labels/compressed', '/cam/depth/compressedDepth'):
        ros.client.publisher(CompressedImage, topic)    # returns when the node listens


def test_diagnostics_tell_two_robots_apart(ros):
    for name in ('one', 'two'):
        ros.mapper(arguments=['-r', f'__ns:=/{name}'])

    def found():
        return {(status.name, status.hardware_id) for array in ros.diagnostics
                for status in array.status if status.name.endswith(': mapping')}
    until(lambda: len(found()) == 2, found)
    names, hardware = zip(*sorted(found()))
    assert names == ('one/mapper: mapping', 'two/mapper: mapping')
    assert hardware[0].endswith('/one') and hardware[1].endswith('/two')


def test_whole_numbers_are_taken_for_doubles(ros):
    ros.mapper({'refine.period': 2}).ready()        # '2' on the command line is an integer
    assert 'Double value is: 2.0' in param(ros, 'get', 'refine.period')
    assert 'Set parameter successful' in param(ros, 'set', 'memory.max_depth', '20')
    assert 'Double value is: 20.0' in param(ros, 'get', 'memory.max_depth')
    answer = param(ros, 'set', 'refine.eta', '2')
    assert 'successful' not in answer and 'out of range' in answer


def test_after_a_recording_nothing_is_missing_it_has_ended(ros, tmp_path):
    mapper = ros.mapper().ready()
    Player(ros.client, bags.write(tmp_path / 'bag', 6)).play()
    mapper.frames(6)
    mapper.says('nothing comes any more: 6 frames were mapped')
    until(lambda: mapper.values()['message'] == 'nothing comes any more', mapper.values)
    assert 'no complete set' not in mapper.output.split('6 frames were mapped')[1]


def test_ids_that_are_ignored_are_grey(ros):
    mapper = ros.mapper({'memory.ignore_labels': [2, 255]}).ready()
    labels = ros.client.listen(Image, '/mapper/labels')
    colors = ros.client.listen(Image, '/mapper/labels_color')
    Camera(ros.client).fly(60, until=lambda: labels and colors)
    until(lambda: labels and colors, mapper.values)
    ids = np.frombuffer(labels[0].data, np.uint16)
    shown = np.frombuffer(colors[0].data, np.uint8).reshape(-1, 3)
    assert (ids == 2).any()
    assert {tuple(color) for color in shown[ids == 2]} == {GREY}
    assert GREY not in {tuple(color) for color in shown[ids == 1]}
