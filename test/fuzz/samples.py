"""What inputs that mean harm are made from: small whole files and messages."""

import bags
import core_worlds as cw
import cv2
import numpy as np
from persem_ros.core.refine.job import refine
from persem_ros.inputs.decode import camera, clouds, legends, messages
from persem_ros.inputs.decode.labels import LabelReader
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, Labels, Refine
from persem_ros.settings.legend import load_legend
from rosbags.typesys import get_typestore, Stores


def small_map(path):
    """Write a refined map of a dozen voxels in several blocks; return its path."""
    rng, memory = np.random.default_rng(1), cw.core_of([])
    for t in range(5):
        seen = {tuple(voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.SHARES)))
                for voxel in rng.integers(-1, 2, (9, 3)).tolist()}
        memory.add(cw.observations(10 ** 18 + 10 ** 8 * t, seen, [1, 2], f'cam {t % 2}'))
    refine(memory, Refine())
    store.save(path, memory, Config(), load_legend('town'))
    return path


def small_recordings(folder):
    """Write recordings of 3 frames; return {(storage, compress): {file name: bytes}}."""
    found = {}
    for storage in ('mcap', 'sqlite3'):
        for compress in (False, True):
            path = bags.write(folder / f'{storage}-{compress}', 3, storage=storage,
                              compress=compress, extra=lambda out: out.text(
                                  'semantic/legend', load_legend('town').to_yaml(), latched=True))
            found[storage, compress] = {file.name: file.read_bytes()
                                        for file in path.iterdir()}
    return found


def _clouded(msg):
    cloud = clouds.structured(msg)
    clouds.positions(cloud)
    clouds.labels(cloud, 'label')


def _camera(msg):
    for rectified in (False, True):
        camera.check(msg, rectified)
        camera.camera(msg, 8, 6, rectified)


READERS = {
    'sensor_msgs/msg/Image': (messages.labels, messages.depth, messages.color,
                              messages.confidence, messages.depth_confidence,
                              lambda msg: LabelReader(Labels())(msg)),
    'geometry_msgs/msg/PoseStamped': (messages.pose,),
    'geometry_msgs/msg/TransformStamped': (messages.pose,),
    'nav_msgs/msg/Odometry': (messages.pose,),
    'tf2_msgs/msg/TFMessage': (messages.transforms,),
    'sensor_msgs/msg/CameraInfo': (_camera,),
    'sensor_msgs/msg/PointCloud2': (_clouded,),
    'std_msgs/msg/String': (legends.table,)}
READERS['sensor_msgs/msg/CompressedImage'] = (
    messages.labels, messages.depth, messages.color, READERS['sensor_msgs/msg/Image'][-1])


def serialized():
    """Return [(type, bytes)]: messages of each type that is read."""
    typestore = get_typestore(Stores.ROS2_JAZZY)
    make = MessageFactory(typestore.types)
    ids = np.arange(48, dtype=np.uint8).reshape(6, 8)
    wide = ids.astype(np.uint16)
    points = np.zeros(5, [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u2')])
    rvl = bytes(12) + np.array([8, 6], '<u4').tobytes() + bytes(range(40))

    def packed(form, data):
        return 'sensor_msgs/msg/CompressedImage', make.compressed(1, 'camera', form, bytes(data))

    def image(array, encoding):
        return 'sensor_msgs/msg/Image', make.image(1, 'camera', array, encoding)

    found = [
        image(ids, 'mono8'), image(wide, '16UC1'), image(ids.astype(np.float32), '32FC1'),
        image(np.stack([ids] * 3, axis=2), 'rgb8'),
        packed('mono8; png compressed', cv2.imencode('.png', ids)[1]),
        packed('bgr8; jpeg compressed bgr8', cv2.imencode('.jpg', np.stack([ids] * 3, axis=2))[1]),
        packed('16UC1; compressedDepth png', bytes(12) + cv2.imencode('.png', wide)[1].tobytes()),
        packed('16UC1; compressedDepth rvl', rvl),
        make.pose(1, 'map', np.eye(4)), make.pose(1, 'map', np.eye(4), 'Odometry', 'base'),
        make.pose(1, 'map', np.eye(4), 'TransformStamped', 'base'),
        ('tf2_msgs/msg/TFMessage', make.make(
            'tf2_msgs/msg/TFMessage', [make.transform(1, 'map', 'base', np.eye(4))])),
        ('sensor_msgs/msg/CameraInfo', make.camera_info(1, 'camera', 8, 6, bags.K)),
        ('sensor_msgs/msg/PointCloud2', make.cloud(1, 'camera', points)),
        ('std_msgs/msg/String', make.make('std_msgs/msg/String', load_legend('town').to_yaml())),
        ('std_msgs/msg/String', make.make('std_msgs/msg/String',
                                          '{"2": {"class": "tree"}, "time_stamp": {"sec": 1}}'))]
    return [(kind, bytes(typestore.serialize_cdr(message, kind))) for kind, message in found]
