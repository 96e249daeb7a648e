"""Whatever arrives, the node stays up: ten thousand broken messages and then good ones."""

import random
import time

import bags
from geometry_msgs.msg import PoseStamped
from harness import Player, until
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image

FRAMES = 10
ROUNDS = 2500       # times four topics
ALL = QoSProfile(depth=2 * ROUNDS)      # nothing is overwritten before it was taken
ENCODINGS = ('mono8', 'mono16', '16UC1', '32FC1', '16SC1', '32SC1', 'rgb8', 'bayer', '', 'é')


def image(random, sec):
    """Return an Image with anything wrong that can be."""
    message = Image()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, random.randrange(10 ** 9)
    message.header.frame_id = random.choice(('camera', '/camera', '', 'other'))
    message.height, message.width = random.choice((0, 1, 12, 13, 2 ** 31)), \
        random.choice((0, 1, 16, 17, 2 ** 31))
    message.encoding = random.choice(ENCODINGS)
    message.is_bigendian = random.choice((0, 1, 255))
    message.step = random.choice((0, 16, 32, 64, 2 ** 32 - 1))
    message.data = random.randbytes(random.choice((0, 1, 16 * 12, 32 * 12, 64 * 12)))
    return message


def info(random, sec):
    """Return a CameraInfo of nonsense."""
    message = CameraInfo()
    message.header.stamp.sec = sec
    message.width, message.height = random.choice(((16, 12), (0, 0), (2 ** 31, 1), (12, 16)))
    message.distortion_model = random.choice(('plumb_bob', 'equidistant', 'fish', ''))
    message.d = [random.choice((0.0, float('nan'), 1e30)) for _ in range(random.randrange(16))]
    message.k = [random.choice((0.0, 20.0, float('inf'), -1.0)) for _ in range(9)]
    message.roi.width, message.roi.height = random.choice(((0, 0), (4, 2 ** 31)))
    return message


def pose(random, sec):
    """Return a PoseStamped without a length, a place or a frame."""
    message = PoseStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, random.randrange(10 ** 9)
    message.header.frame_id = random.choice(('map', '', 'nowhere'))
    values = (0.0, 1.0, float('nan'), float('inf'), 1e300, -1.0)
    for part, names in ((message.pose.position, 'xyz'), (message.pose.orientation, 'xyzw')):
        for name in names:
            setattr(part, name, random.choice(values))
    return message


def test_ten_thousand_broken_messages(ros, tmp_path):
    mapper = ros.mapper({'sync.max_wait': 0.2, 'map.on_time_jump': 'keep', 'qos.queue': ALL.depth,
                         'pose.type': 'PoseStamped'}).ready()
    dice = random.Random(1)
    out = {kind: ros.client.publisher(kind, topic, ALL) for kind, topic in (
        (CameraInfo, '/depth/camera_info'), (PoseStamped, '/pose'))}
    depth = ros.client.publisher(Image, '/depth/image', ALL)
    labels = ros.client.publisher(Image, '/semantic/image', ALL)
    sent = 0
    for i in range(ROUNDS):
        sec = dice.choice((1, 1, 1, 0, -5, 2 ** 31 - 1)) if i % 50 == 0 else 1000 + i // 10
        for publisher, message in ((out[CameraInfo], info(dice, sec)),
                                   (out[PoseStamped], pose(dice, sec)),
                                   (depth, image(dice, sec)), (labels, image(dice, sec))):
            data = bytearray(serialize_message(message))
            if dice.random() < 0.5:         # damaged on the way, too
                for _ in range(dice.randrange(1, 9)):
                    data[dice.randrange(4, len(data))] = dice.randrange(256)
                if dice.random() < 0.3:
                    del data[dice.randrange(4, len(data)):]
            publisher.publish(bytes(data))
            sent += 1
    assert sent == 4 * ROUNDS == 10_000
    until(lambda: received(mapper) == sent, mapper.values)
    assert mapper.running and int(mapper.values()['dropped']) > 1000, mapper.values()
    assert 'Traceback' not in mapper.output and 'internal error' not in mapper.output
    # Throttled: far fewer warnings than faults.
    assert mapper.output.count('dropped, ') < 400
    assert mapper.call('reset')[0]
    before = int(mapper.values()['frames'])
    time.sleep(0.5)                         # longer than sync.max_wait: nothing of it waits
    player = Player(ros.client, bags.write(tmp_path / 'bag', FRAMES))
    player.play()
    mapper.frames(before + FRAMES - 1)


def received(mapper):
    """Return the number of messages that the node says it has received."""
    return sum(int(value) for key, value in mapper.values().items() if key.endswith(' messages')
               and not key.startswith('queue'))


def test_sizes_and_encodings_that_change_in_flight(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper({'sync.max_wait': 0.5}).ready()
    player = Player(ros.client, path)
    third = len(player.messages) // 3
    whole = player.messages
    player.messages = whole[:third]
    player.play()
    mapper.frames(2)
    from persem_ros.outputs.recording.messages import MessageFactory
    from rosbags.typesys import get_typestore, Stores
    import numpy as np
    store = get_typestore(Stores.ROS2_JAZZY)
    make = MessageFactory(store.types)
    for i, (width, height) in enumerate(((32, 24), (8, 6), (16, 12)), start=4):
        stamp = bags.stamp(i)
        for topic, array, encoding in (
                ('/depth/image', np.full((height, width), 2000, np.uint16), '16UC1'),
                ('/semantic/image', np.full((height, width), 3, np.uint8), 'mono8')):
            message = make.image(stamp, 'camera', array, encoding)
            player._out[topic].publish(bytes(store.serialize_cdr(message,
                                                                 'sensor_msgs/msg/Image')))
    player.messages = [m for m in whole[third:] if m[0] == '/pose']
    player.play()
    mapper.frames(2 + 3)
    assert mapper.running
