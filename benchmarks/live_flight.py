"""The flight over waves that benchmarks/live.py plays to the node, on four topics."""

import time

import numpy as np
from persem_ros.core.transforms import transform
from persem_ros.outputs.recording.messages import MessageFactory
from rclpy.qos import QoSProfile
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import CameraInfo, Image

WIDTH = 640             # to which the focal length belongs
FOCAL = 525.0
ALTITUDE = 20.0         # m above the waves' mean
PERIOD = 50             # frames after which the ground repeats, not the place
ADVANCE = 1.0           # m from frame to frame: half a million voxels after 60 s at 10 Hz
POSE_RATE = 100         # Hz
RELIABLE = QoSProfile(depth=50)
START = 1_700_000_000_000_000_000


def intrinsics(size):
    """Return K of images of a size that see what those of 640 pixels width see."""
    focal = FOCAL * size[0] / WIDTH
    return np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])


def scene(size):
    """Return PERIOD pairs of (depth (H, W) float32 in metres, labels (H, W) uint8)."""
    width, height_px = size
    K = intrinsics(size)
    u, v = np.meshgrid((np.arange(width) - K[0, 2]) / K[0, 0],
                       (np.arange(height_px) - K[1, 2]) / K[1, 1])
    noise = np.random.default_rng(1)
    wave = 2 * np.pi / (PERIOD * ADVANCE)
    images = []
    for i in range(PERIOD):
        depth = np.full(u.shape, ALTITUDE)
        for _ in range(6):      # towards the point where the ray meets the ground
            x, y = u * depth + i * ADVANCE, v * depth
            height = 2 * np.sin(4 * wave * x) + np.sin(9 * wave * x) * np.cos(0.7 * y)
            depth = ALTITUDE - height
        labels = (1 + (height + 3.5) * 8 / 7).astype(np.uint8)
        wrong = noise.random((height_px // 16, width // 16)).repeat(16, 0).repeat(16, 1) < 0.15
        labels[wrong] = noise.integers(1, 9, np.count_nonzero(wrong))
        images.append((depth.astype(np.float32), labels))
    return images


def pose_at(seconds, rate):
    """Return T_map_camera, looking down, at a time of the flight."""
    T = transform([seconds * rate * ADVANCE, 0.0, ALTITUDE], [1.0, 0.0, 0.0, 0.0])
    return T


class Flight:
    """
    Plays the flight on four topics.

    Parameters
    ----------
    node : rclpy.node.Node
    size : (int, int)
        Width and height of the images.

    """

    def __init__(self, node, size):
        """Prepare all messages."""
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._make = MessageFactory(self._store.types)
        self._node = node
        pack = self._serialized
        self._images = [
            (pack(self._make.image(0, 'camera', depth, '32FC1'), 'sensor_msgs/msg/Image'),
             pack(self._make.image(0, 'camera', labels, 'mono8'), 'sensor_msgs/msg/Image'))
            for depth, labels in scene(size)]
        self._info = pack(self._make.camera_info(0, 'camera', *size, intrinsics(size)),
                          'sensor_msgs/msg/CameraInfo')
        from geometry_msgs.msg import PoseStamped
        self._out = {topic: node.create_publisher(cls, topic, RELIABLE) for topic, cls in (
            ('/depth/image', Image), ('/semantic/image', Image),
            ('/depth/camera_info', CameraInfo), ('/pose', PoseStamped))}

    def close(self):
        """Take the publishers back."""
        for out in self._out.values():
            self._node.destroy_publisher(out)

    def wait(self):
        """Wait until the node listens to every topic."""
        while not all(out.get_subscription_count() for out in self._out.values()):
            time.sleep(0.02)

    def play(self, seconds, rate, first=START, until=None):
        """
        Play for some time; return {stamp: when the last input of that frame was sent}.

        Parameters
        ----------
        seconds : float
            How long.
        rate : float
            Frames per second.
        first : int
            The first stamp, ns.
        until : callable, optional
            until() ends the flight early.

        """
        sent, waiting, begin, frames, poses, newest = {}, [], time.monotonic(), 0, -1, 0
        while time.monotonic() - begin < seconds and not (until and until()):
            frame_due, pose_due = begin + frames / rate, begin + poses / POSE_RATE
            due = min(frame_due, pose_due)
            time.sleep(max(0.0, due - time.monotonic()))
            if pose_due <= frame_due:
                at = poses / POSE_RATE
                stamp = first + round(at * 1e9)
                name, message = self._make.pose(stamp, 'map', pose_at(at, rate))
                self._out['/pose'].publish(self._serialized(message, name))
                waiting = [s for s in waiting if not self._done(s, stamp, sent)]
                newest = stamp
                poses += 1
            else:
                stamp = first + round(frames / rate * 1e9)
                depth, labels = self._images[frames % PERIOD]
                self._out['/depth/camera_info'].publish(stamped(self._info, stamp))
                self._out['/depth/image'].publish(stamped(depth, stamp))
                self._out['/semantic/image'].publish(stamped(labels, stamp))
                sent[stamp] = time.monotonic_ns()
                if newest < stamp:      # else the pose was there before the images
                    waiting.append(stamp)
                frames += 1
        return sent

    @staticmethod
    def _done(stamp, pose, sent):
        """Whether a pose completes the frame of *stamp*; then it was its last input."""
        if pose < stamp:
            return False
        sent[stamp] = time.monotonic_ns()
        return True

    def _serialized(self, message, name):
        return bytes(self._store.serialize_cdr(message, name))


def stamped(data, stamp):
    """Return a serialized message with another header stamp."""
    return data[:4] + (stamp // 10**9).to_bytes(4, 'little') + \
        (stamp % 10**9).to_bytes(4, 'little') + data[12:]
