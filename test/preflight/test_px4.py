"""px4_msgs/VehicleOdometry in a recording: both versions, both storages, no estimate."""

from collections import Counter
from contextlib import closing

import bags
import numpy as np
from persem_ros.core.transforms import matrix_to_quaternion
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import messages, pose_messages, px4
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.live import LiveIntake
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.stamps import stamp_of
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from test_frames_and_poses import DOWN, images, swaying

SINCE = """uint32 MESSAGE_VERSION = 0
uint64 timestamp
uint64 timestamp_sample
uint8 POSE_FRAME_UNKNOWN = 0
uint8 POSE_FRAME_NED = 1
uint8 POSE_FRAME_FRD = 2
uint8 pose_frame
float32[3] position
float32[4] q
uint8 velocity_frame
float32[3] velocity
float32[3] angular_velocity
float32[3] position_variance
float32[3] orientation_variance
float32[3] velocity_variance
uint8 reset_counter
int8 quality
"""
BEFORE = """uint64 timestamp
uint64 timestamp_sample
uint8 LOCAL_FRAME_NED = 0
uint8 LOCAL_FRAME_FRD = 1
uint8 local_frame
float32 x
float32 y
float32 z
float32[4] q
float32[4] q_offset
float32[21] pose_covariance
uint8 velocity_frame
float32 vx
float32 vy
float32 vz
float32 rollspeed
float32 pitchspeed
float32 yawspeed
float32[21] velocity_covariance
uint8 reset_counter
"""
TO_NED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FLIP = np.diag([1.0, -1.0, -1.0])


def store(text):
    """Return a type store that knows one version of the message."""
    found = get_typestore(Stores.ROS2_JAZZY)
    found.register(get_types_from_msg(text, px4.TYPE))
    return found


def message(types, at, T, world=TO_NED, frame=None):
    """Return the message of a body (forward, left, up) that is at T, east, north, up."""
    cls = types.types[px4.TYPE]
    xyz = (world @ T[:3, 3]).astype(np.float32)
    x, y, z, w = matrix_to_quaternion(world @ T[:3, :3] @ FLIP)
    ned = np.allclose(world, TO_NED)
    numbers = {'timestamp': at // 1000 + 4000, 'timestamp_sample': at // 1000,
               'q': np.array([w, x, y, z], np.float32)}
    if hasattr(cls, 'LOCAL_FRAME_NED'):
        numbers |= {'local_frame': (0 if ned else 1) if frame is None else frame,
                    **dict(zip('xyz', map(float, xyz)))}
    else:
        numbers |= {'pose_frame': (1 if ned else 2) if frame is None else frame, 'position': xyz}
    fields = {}
    for name, (_, kind) in types.fielddefs[px4.TYPE][1]:
        lengths = {'pose_covariance': 21, 'velocity_covariance': 21, 'q_offset': 4}
        array = np.zeros(lengths.get(name, 3), np.float32)
        fields[name] = numbers.get(name, array if isinstance(kind[0], tuple) else 0)
    return cls(**fields)


@pytest.mark.parametrize('text', [SINCE, BEFORE])
@pytest.mark.parametrize('world', [TO_NED, FLIP])
def test_axes_are_those_of_ros(text, world):
    types, at = store(text), 1_700_000_000_123_456_000
    data = types.serialize_cdr(message(types, at, swaying(3), world), px4.TYPE)
    stamp, T, parent, child = pose_messages.pose(Decoder()(data, px4.TYPE))
    assert stamp == stamp_of(px4.TYPE, data[:64]) == at
    assert np.allclose(T, swaying(3), atol=1e-5)
    assert (parent, child) == ('', 'base_link')


@pytest.mark.parametrize('text, unknown', [(SINCE, 0), (BEFORE, 2)])
def test_what_is_no_estimate_is_dropped(text, unknown):
    types = store(text)
    lost = swaying(0)
    lost[0, 3] = np.nan
    for T, frame, reason in ((swaying(0), unknown, 'no known frame'), (lost, None, 'no estimate')):
        data = types.serialize_cdr(message(types, 10**15, T, frame=frame), px4.TYPE)
        with pytest.raises(messages.BadMessage) as caught:
            pose_messages.pose(Decoder()(data, px4.TYPE))
        assert caught.value.reason == reason
    with pytest.raises(messages.BadMessage):
        Decoder()(data[:40], px4.TYPE)
    assert stamp_of(px4.TYPE, data[:10]) is None


def recorded(path, storage):
    """Write images in one recording and the odometry of their body in another; both as A+B."""
    types = store(SINCE)
    with RecordingWriter(path / 'images') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(12):
            images(out, i, swaying(i) @ DOWN)
    with Writer(path / 'px4', version=8, storage_plugin=storage) as out:
        topic = out.add_connection('/fmu/out/vehicle_odometry', px4.TYPE, typestore=types)
        for i in np.arange(-1, 13):
            out.write(topic, bags.stamp(i), types.serialize_cdr(
                message(types, bags.stamp(i), swaying(i)), px4.TYPE))
    return f'{path / "images"}+{path / "px4"}'


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_frames_are_where_the_camera_was(tmp_path, storage):
    path = recorded(tmp_path, storage)
    with pytest.raises(PersemError, match='topics.pose=/fmu/out/vehicle_odometry'):
        opened(path, Config())
    config = updated(Config(), {'topics.pose': '/fmu/out/vehicle_odometry'})
    with closing(opened(path, config)) as recording:
        frames = list(recording.frames())
        assert len(frames) == 12
        assert all(np.allclose(f.T_map_camera, swaying(i) @ DOWN, atol=1e-5)
                   for i, f in enumerate(frames))
    with closing(Source(path)) as source:
        assert not source.notes


def test_a_time_beyond_all_stamps_is_no_pose():
    late = px4.VehicleOdometry(2 ** 63, 2 ** 63, 'ned', (0.0,) * 3, (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(messages.BadMessage, match='more than stamps can be'):
        pose_messages.pose(late)
    assert stamp_of(px4.TYPE, b'\0\1\0\0' + b'\xff' * 16) is None


def test_a_node_takes_them_as_they_come():
    types, dropped = store(SINCE), Counter()
    intake = LiveIntake(Config(), Decoder(), dropped, lambda: None)
    poses = PoseBuffer(Config(), strict=True)
    poses.add_static(DOWN, 'base_link', 'camera')
    for i in range(3):
        data = bytes(types.serialize_cdr(message(types, bags.stamp(i), swaying(i)), px4.TYPE))
        intake.take('pose', poses, px4.TYPE, i, data)
    intake.take('pose', poses, px4.TYPE, 3, data[:12])
    found = poses.lookup(bags.stamp(1), 'camera')
    assert np.allclose(found.T, swaying(1) @ DOWN, atol=1e-5)
    assert intake.jumps == 0 and dropped == {'pose: damaged message': 1}
