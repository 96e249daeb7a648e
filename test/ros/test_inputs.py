"""What may arrive: late, latched, compressed, by TF, from four kinds of poses, several cameras."""

import bags
from camera import Camera
from harness import BEST_EFFORT, LATCHED, Player, RELIABLE, until
import numpy as np
from persem_ros.inputs.decode import messages
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from test_compressed import png_of, rvl_of
from test_live_equals_replay import assert_same_maps, replayed

FRAMES = 10


def test_publishers_that_come_late_and_are_best_effort(ros):
    mapper = ros.mapper({f'qos.{name}': 'best_effort'
                         for name in ('labels', 'depth', 'camera_info', 'pose')}).ready()
    mapper.says('no complete set of messages')      # nobody publishes anything yet
    for topic in ('semantic/image (labels)', 'depth/image (depth)', 'pose (pose)',
                  'depth/camera_info (camera_info)'):
        assert f'{topic}: 0 messages, no stamp, 0 publishers, no publisher' in mapper.output
    images = ros.client.listen(Image, '/mapper/labels', BEST_EFFORT)
    # Best effort may lose some on a busy machine: as many as it takes.
    Camera(ros.client, qos=BEST_EFFORT).fly(60, until=lambda: len(images) >= FRAMES)
    mapper.says('complete sets of messages come again')
    assert len(images) >= FRAMES


def test_a_topic_that_comes_later_and_does_not_fit_is_named(ros):
    mapper = ros.mapper().ready()
    mapper.says('depth/image (depth): 0 messages, no stamp, 0 publishers')
    assert 'QoS does not fit' not in mapper.output
    ros.client.node.create_publisher(Image, '/depth/image', BEST_EFFORT)
    mapper.says('see qos.depth')
    assert mapper.output.count('no complete set of messages') == 2


def test_a_topic_that_does_not_fit_is_named(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper().ready()
    ros.client.node.create_publisher(Image, '/depth/image', BEST_EFFORT)
    ros.client.node.create_publisher(String, '/pose', RELIABLE)
    Player(ros.client, path, left_out=('/depth/image', '/pose')).play()
    # The first warning may have come before there was a publisher: then there is a second.
    mapper.says('published as std_msgs/msg/String')
    line = next(line for line in mapper.output.splitlines() if 'published as std_msgs' in line)
    assert f'semantic/image (labels): {FRAMES} messages, last stamp 17000000' in line
    assert '1 publishers, QoS does not fit' in line and 'see qos.depth' in line
    assert 'published as std_msgs/msg/String' in line


def test_a_camera_info_that_was_latched_before_the_node_came(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    out = ros.client.node.create_publisher(CameraInfo, '/depth/camera_info', LATCHED)
    info = CameraInfo(width=bags.WIDTH, height=bags.HEIGHT, distortion_model='plumb_bob')
    info.k = [float(x) for x in bags.K.ravel()]
    out.publish(info)
    mapper = ros.mapper({'qos.camera_info': 'best_effort'}).ready()
    Player(ros.client, path, left_out=('/depth/camera_info',)).play()
    mapper.frames(FRAMES)
    assert mapper.values()['dropped'] == '0'


def test_four_cameras_with_four_kinds_of_poses_share_a_map(ros, tmp_path):
    kinds = ('PoseStamped', 'PoseWithCovarianceStamped', 'Odometry', 'TransformStamped')
    names = ('a', 'b', 'c', 'd')
    path = tmp_path / 'bag'
    with RecordingWriter(path) as out:
        for i in range(-1, 2 * FRAMES + 1):
            for number, (name, kind) in enumerate(zip(names, kinds)):
                at = i / 2 + number / 50
                out.pose(f'{name}/pose', bags.stamp(at), 'map', bags.pose(at), kind, 'camera')
                if i % 2 == 0 and 0 <= i < 2 * FRAMES:
                    frame = i // 2
                    out.camera_info(f'{name}/depth/camera_info', bags.stamp(at), 'camera',
                                    bags.WIDTH, bags.HEIGHT, bags.K)
                    out.image(f'{name}/depth/image', bags.stamp(at), 'camera', bags.depth(frame),
                              '32FC1')
                    out.image(f'{name}/semantic/image', bags.stamp(at), 'camera',
                              bags.labels(frame), 'mono16')
    settings = {'cameras': list(names), 'sync.hold': 8.0,
                **{f'cameras.{name}.topics.pose': f'{name}/pose' for name in names}}
    expected = replayed(path, tmp_path / 'replay', **settings)
    saved = tmp_path / 'live.persem'
    mapper = ros.mapper({**settings, 'map.path': str(saved)}).ready()
    images = {name: ros.client.listen(Image, f'/mapper/{name}/labels') for name in names}
    Player(ros.client, path).play()
    # The last frames of some cameras wait for later ones of the others, and stop waiting.
    mapper.frames(4 * FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    assert_same_maps(expected, store.load(saved))
    until(lambda: all(len(found) == FRAMES for found in images.values()), mapper.values)


def test_poses_from_tf(ros, tmp_path):
    path = tmp_path / 'bag'
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    with RecordingWriter(path) as out:
        out.tf(None, 'base', 'camera', T, static=True)
        for i in range(FRAMES):
            out.tf(bags.stamp(i - 0.5), 'map', 'odom', np.eye(4))
            out.tf(bags.stamp(i - 0.5), 'odom', 'base', bags.pose(i - 0.5))
            bags.write_images(out, i)
        out.tf(bags.stamp(FRAMES), 'map', 'odom', np.eye(4))
        out.tf(bags.stamp(FRAMES), 'odom', 'base', bags.pose(FRAMES))
    expected = replayed(path, tmp_path / 'replay', **{'pose.source': 'tf'})
    saved = tmp_path / 'live.persem'
    mapper = ros.mapper({'pose.source': 'tf', 'map.path': str(saved)}).ready()
    player = ros.run('ros2', 'bag', 'play', '--delay', '3', str(path))
    mapper.frames(FRAMES)
    player.stop()
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    assert_same_maps(expected, store.load(saved))


def test_compressed_transports_and_other_encodings(ros, tmp_path):
    path = tmp_path / 'bag'
    with RecordingWriter(path) as out:
        for i in range(FRAMES):
            out.pose('pose', bags.stamp(i - 0.5), 'map', bags.pose(i - 0.5))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', bags.WIDTH, bags.HEIGHT,
                            bags.K)
            depth = np.round(bags.depth(i) * 1000).astype(np.uint16)
            form, data = rvl_of(depth) if i % 2 else png_of(depth)
            out.compressed('depth/image/compressedDepth', bags.stamp(i), 'camera', form, data)
            form, data = png_of(bags.labels(i).astype(np.uint8), depth=False)
            out.compressed('semantic/image/compressed', bags.stamp(i), 'camera', form, data)
        out.pose('pose', bags.stamp(FRAMES), 'map', bags.pose(FRAMES))
    expected = replayed(path, tmp_path / 'replay')
    saved = tmp_path / 'live.persem'
    mapper = ros.mapper({'map.path': str(saved)}).ready()
    images = ros.client.listen(Image, '/mapper/labels')
    Player(ros.client, path).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    assert_same_maps(expected, store.load(saved))
    until(lambda: len(images) == FRAMES, lambda: len(images))
    assert {image.encoding for image in images} == {'mono8'}
    assert messages.stamp_ns(images[0]) == bags.stamp(0)
