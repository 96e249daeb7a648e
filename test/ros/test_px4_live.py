"""A PX4's odometry, published as its agent does, with px4_msgs of the workspace."""

import bags
from harness import Player
import numpy as np
from persem_ros.core.transforms import matrix_to_quaternion
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from test_frames_and_poses import DOWN, images, swaying
from test_live_equals_replay import replayed
from test_sensors_live import LATCHED_DEEP

try:
    from px4_msgs.msg import VehicleOdometry
except ImportError:
    VehicleOdometry = None

pytestmark = pytest.mark.skipif(VehicleOdometry is None, reason='no px4_msgs in this workspace')
TOPIC = '/fmu/out/vehicle_odometry'
# What the agent (uXRCE-DDS) gives to everything that leaves the autopilot.
AGENT = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT,
                   durability=DurabilityPolicy.TRANSIENT_LOCAL)
TO_NED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FLIP = np.diag([1.0, -1.0, -1.0])
FRAMES = 12
# The ground, at z = 0, lies in the middle of voxels: PX4 says it in float32, ROS in float64.
WORLD = {'memory.voxel_size': 0.5, 'map.origin': [0.0, 0.0, 0.25]}


def odometry(at, T):
    """Return the message of a body (forward, left, up) that is at T, east, north, up."""
    x, y, z, w = matrix_to_quaternion(TO_NED @ T[:3, :3] @ FLIP)
    return VehicleOdometry(
        timestamp=at // 1000 + 4000, timestamp_sample=at // 1000,
        pose_frame=VehicleOdometry.POSE_FRAME_NED,
        position=(TO_NED @ T[:3, 3]).astype(np.float32),
        q=np.array([w, x, y, z], np.float32))


def recorded(path, poses):
    """Write what a camera below a body sees; with *poses* as an Odometry, the replay's."""
    with RecordingWriter(path) as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', DOWN, static=True)
        for i in range(-1, FRAMES + 1):
            if poses:
                out.pose('pose', bags.stamp(i), 'map', swaying(i), 'Odometry', 'base_link')
            if 0 <= i < FRAMES:
                images(out, i, swaying(i) @ DOWN)
    return path


def test_the_map_is_that_of_the_same_poses_in_ros_axes(ros, tmp_path):
    saved = tmp_path / 'live.persem'
    expected = replayed(recorded(tmp_path / 'odometry', True), tmp_path / 'replay',
                        **WORLD, **{'topics.pose': 'pose'})
    mapper = ros.mapper({**WORLD, 'topics.pose': TOPIC, 'qos.pose': 'auto',
                         'map.path': str(saved)}).ready()
    out = ros.client.publisher(VehicleOdometry, TOPIC, AGENT)
    out.publish(VehicleOdometry(q=np.full(4, np.nan, np.float32)))      # no estimate, yet
    for i in range(-1, FRAMES + 1):
        out.publish(odometry(bags.stamp(i), swaying(i)))
    Player(ros.client, recorded(tmp_path / 'images', False), LATCHED_DEEP).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0] and mapper.call('save_map')[0]
    found = store.load(saved)
    cells, wanted = (set(map(tuple, one.saved.voxels().tolist())) for one in (found, expected))
    assert len(wanted) > 100 and len(cells ^ wanted) <= 0.02 * len(wanted)
    assert (found.saved.label == 1).all()
    assert 'no estimate' in mapper.output or 'no known frame' in mapper.output
