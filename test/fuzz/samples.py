"""What inputs that mean harm are made from: small whole files and messages."""

import importlib.util
import io
import struct

import bags
import core_worlds as cw
import cv2
import numpy as np
from persem_ros.core.refine.whole import refine
from persem_ros.inputs.decode import (
    camera, clouds, image_messages as images, legends, messages, pose_messages)
from persem_ros.inputs.decode.labels import LabelReader
from persem_ros.inputs.decode.serialized import VISION
from persem_ros.inputs.trajectory import from_path
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, Labels, Refine
from persem_ros.settings.legend_files import load_legend
from rosbags.typesys import get_types_from_msg, get_typestore, Stores


def small_map(path):
    """Write a refined map of a dozen voxels in several blocks; return its path."""
    rng, memory = np.random.default_rng(1), cw.core_of([])
    for t in range(5):
        seen = {tuple(voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.SHARES)))
                for voxel in rng.integers(-1, 2, (9, 3)).tolist()}
        memory.add(cw.observations(10 ** 18 + 10 ** 8 * t, seen, [1, 2], f'cam {t % 2}'))
    refine(memory, Refine())
    refine(memory, Refine(method='geometry'))       # whose parameters are kept, too
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


def pictures():
    """Return [(name, bytes)]: small pictures and arrays of each kind that is converted."""
    ids = np.arange(48, dtype=np.uint8).reshape(6, 8)
    wide, colors = ids.astype(np.uint16), np.stack([ids] * 3, axis=2)
    found = [(f'a{ending}', cv2.imencode(ending, array)[1].tobytes()) for ending, array in (
        ('.png', ids), ('.png', wide), ('.png', colors), ('.jpg', colors), ('.tiff', wide),
        ('.tiff', ids.astype(np.float32)), ('.bmp', ids), ('.pgm', wide), ('.pfm', ids.astype(
            np.float32)))]
    for array in (ids, wide, ids.astype(np.float32), ids.astype(np.int64)):
        out = io.BytesIO()
        np.save(out, array)
        found.append(('a.npy', out.getvalue()))
    return found


def tracks():
    """Return [(name, text)]: files of poses and of satellite fixes."""
    pose = '0.1 0.2 0.3 0 0 0.6 0.8'
    matrix = '1 0 0 0.1\n0 1 0 0.2\n0 0 1 0.3\n0 0 0 1\n'
    return [
        ('tum.txt', ''.join(f'{1.5 + k} {pose}\n' for k in range(4))),
        ('euroc.csv', '#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z\n' + ''.join(
            f'{(15 + k) * 10 ** 17},{pose.replace(" ", ",")}\n' for k in range(4))),
        ('kitti.txt', ''.join('1 0 0 1 0 1 0 2 0 0 1 3\n' for _ in range(3))),
        ('scene.log', ''.join(f'{k} {k} {k + 1}\n{matrix}' for k in range(3))),
        ('arkit.traj', ''.join(f'{1.5 + k} 0.1 0.2 0.3 1 2 3\n' for k in range(4))),
        ('slam.tum', ''.join(f'{10 ** 9 + 0.1 * k:.1f} {pose}\n' for k in range(5))),
        ('fixes.csv', 'stamp,latitude,longitude,altitude\n' + ''.join(
            f'{10 ** 9 + 0.1 * k:.3f}, {48 + k / 1e5}, {11 + k / 1e5}, {500 + k}\n'
            for k in range(5)))]


def exports(folder):
    """Return the options of persem map export for all formats whose libraries are there."""
    formats = {'ply': None, 'npz': None, 'mesh': None, 'laz': 'laspy', 'geotiff': 'rasterio',
               'parquet': 'pyarrow'}
    endings = {'mesh': 'glb', 'geotiff': 'tif'}
    return [word for name, library in formats.items()
            if library is None or importlib.util.find_spec(library)
            for word in (f'--{name}', str(folder / f'out-{name}.{endings.get(name, name)}'))]


def _clouded(msg):
    cloud = clouds.structured(msg)
    clouds.positions(cloud)
    clouds.labels(cloud, 'label')


def _camera(msg):
    for rectified in (False, True):
        camera.check(msg, rectified)
        camera.camera(msg, 8, 6, rectified)


READERS = {
    'sensor_msgs/msg/Image': (images.labels, images.depth, images.color,
                              images.confidence, images.depth_confidence,
                              lambda msg: LabelReader(Labels())(msg)),
    'geometry_msgs/msg/PoseStamped': (pose_messages.pose,),
    'geometry_msgs/msg/TransformStamped': (pose_messages.pose,),
    'nav_msgs/msg/Odometry': (pose_messages.pose,),
    'tf2_msgs/msg/TFMessage': (pose_messages.transforms,),
    'sensor_msgs/msg/CameraInfo': (_camera,),
    'sensor_msgs/msg/PointCloud2': (_clouded,),
    'vision_msgs/msg/LabelInfo': (legends.table,),
    'nav_msgs/msg/Path': (lambda msg: from_path(msg, 'map', '/path'),),
    'px4_msgs/msg/VehicleOdometry': (pose_messages.pose,),
    'sensor_msgs/msg/NavSatFix': (messages.stamp_ns,),
    'std_msgs/msg/String': (legends.table,)}
READERS['sensor_msgs/msg/CompressedImage'] = (
    images.labels, images.depth, images.color, READERS['sensor_msgs/msg/Image'][-1])


def serialized():
    """Return [(type, bytes)]: messages of each type that is read."""
    typestore = get_typestore(Stores.ROS2_JAZZY)
    for kind, text in VISION.items():
        typestore.register(get_types_from_msg(text, kind))
    make = MessageFactory(typestore.types)
    ids = np.arange(48, dtype=np.uint8).reshape(6, 8)
    wide = ids.astype(np.uint16)
    points = np.zeros(5, [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u2')])
    rvl = bytes(12) + np.array([8, 6], '<u4').tobytes() + bytes(range(40))

    def packed(form, data):
        return 'sensor_msgs/msg/CompressedImage', make.compressed(1, 'camera', form, bytes(data))

    def image(array, encoding):
        return 'sensor_msgs/msg/Image', make.image(1, 'camera', array, encoding)

    names = [make.make('vision_msgs/msg/VisionClass', i, f'class {i}') for i in range(5)]
    px4 = struct.pack('<4xQQB3x7f48x', 10 ** 6, 10 ** 6, 1, 1.0, 2.0, -3.0, 1.0, 0.0, 0.0, 0.0)
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
                                          '{"2": {"class": "tree"}, "time_stamp": {"sec": 1}}')),
        ('vision_msgs/msg/LabelInfo', make.make('vision_msgs/msg/LabelInfo', make.header(
            1, 'camera'), names, 0.5)),
        ('nav_msgs/msg/Path', make.path(1, 'map', [(k, np.eye(4)) for k in (3, 7)], '')),
        ('sensor_msgs/msg/NavSatFix', make.make(
            'sensor_msgs/msg/NavSatFix', make.header(1, 'gps'), make.make(
                'sensor_msgs/msg/NavSatStatus', 0, 1), 48.0, 11.0, 500.0, np.zeros(9), 0))]
    return [*((kind, bytes(typestore.serialize_cdr(message, kind))) for kind, message in found),
            ('px4_msgs/msg/VehicleOdometry', b'\0\1\0\0' + px4[4:])]
