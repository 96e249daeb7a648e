"""A camera, a segmenter and a localisation that a test drives frame by frame, stamped with now."""

import threading
import time

import bags
from geometry_msgs.msg import PoseStamped, TransformStamped
from harness import RELIABLE
from nav_msgs.msg import Odometry
import numpy as np
from persem_ros.outputs.recording.messages import MessageFactory
from rclpy.time import Time
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

S = 1_000_000_000
LATE = S // 5
STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageFactory(STORE.types)


class Camera:
    """
    Publishes frames of bags.py as a running robot does.

    Parameters
    ----------
    client : harness.Client
    pose : str
        'PoseStamped', 'Odometry' or 'tf'.
    frame : str
        The frame that the poses are in.
    offset : float
        Seconds by which the clock of the poses is ahead.
    labels_offset : float
        Seconds by which label images are stamped later.
    names : dict
        Other names of the topics 'labels', 'depth', 'info', 'pose'.
    size : (int, int)
        Width and height of the images.
    qos : QoSProfile
        Of the images.

    """

    def __init__(self, client, pose='PoseStamped', frame='map', offset=0.0, labels_offset=0.0,
                 names=None, size=(bags.WIDTH, bags.HEIGHT), qos=RELIABLE):
        """Advertise the topics and wait until the node listens to each."""
        names = {'labels': '/semantic/image', 'depth': '/depth/image',
                 'info': '/depth/camera_info', 'pose': '/tf' if pose == 'tf' else '/pose',
                 **(names or {})}
        kinds = {'tf': TFMessage, 'Odometry': Odometry, 'PoseStamped': PoseStamped}
        self.pose, self.frame = pose, frame
        self._offset, self._labels_offset = offset, labels_offset
        self._width, self._height = size
        topics = {'labels': (Image, qos), 'depth': (Image, qos), 'info': (CameraInfo, RELIABLE),
                  'pose': (kinds[pose], RELIABLE)}
        self._out = {name: client.publisher(kind, names[name], profile)
                     for name, (kind, profile) in topics.items()}
        scale = self._width / bags.WIDTH
        self._K = bags.K * np.array([[scale], [scale], [1.0]])
        self._number = 0

    def send_info(self, stamp):
        """Publish a camera info."""
        self._send('info', MAKE.camera_info(stamp, 'camera', self._width, self._height, self._K),
                   'CameraInfo')

    def send_depth(self, stamp):
        """Publish a depth image: a wall 2 m ahead."""
        self._send('depth', MAKE.image(stamp, 'camera', np.full(
            (self._height, self._width), 2.0, np.float32), '32FC1'), 'Image')

    def send_labels(self, stamp):
        """Publish a label image: stripes."""
        self._number += 1
        self._send('labels', MAKE.image(
            stamp + round(self._labels_offset * S), 'camera',
            bags.labels(self._number, self._width, self._height), 'mono16'), 'Image')

    def send_pose(self, stamp):
        """Publish a pose at the origin."""
        header = Time(nanoseconds=stamp + round(self._offset * S)).to_msg()
        if self.pose == 'tf':
            message = transform(header, self.frame, 'camera')
        elif self.pose == 'Odometry':
            message = Odometry(child_frame_id='camera')
        else:
            message = PoseStamped()
        if self.pose != 'tf':
            message.header.stamp, message.header.frame_id = header, self.frame
        self._out['pose'].publish(message)

    def fly(self, seconds, hz=10.0, depth_every=1, labels_every=1, delay=0.0, until=None,
            poses=True):
        """
        Publish at a rate until the time is over or until() is true; return the frames sent.

        Labels come *delay* seconds late. Poses come at 50 Hz. Frames that a busy machine is late
        with are left out whole, as a camera does.

        """
        begin, due, sent = time.time_ns(), [], 0
        for i in range(round(seconds * 50) + 10):
            stamp = begin + i * S // 50
            if poses:
                due.append((stamp, 0, self.send_pose, stamp))
        for i in range(round(seconds * hz)):
            stamp = begin + round(i / hz * S)
            due.append((stamp, 1, self.send_info, stamp))
            if i % depth_every == 0:
                due.append((stamp, 2, self.send_depth, stamp))
            if i % labels_every == 0:
                due.append((stamp + round(delay * S), 3, self.send_labels, stamp))
        missed = set()
        for at, kind, send, stamp in sorted(due, key=lambda item: item[:2]):
            if until is not None and until():
                break
            time.sleep(max(0.0, (at - time.time_ns()) / S))
            if kind == 1 and time.time_ns() - at > LATE:
                missed.add(stamp)
            if kind and stamp in missed:
                continue
            send(stamp)
            sent += kind == 3
        return sent

    def _send(self, name, message, kind):
        self._out[name].publish(bytes(STORE.serialize_cdr(message, f'sensor_msgs/msg/{kind}')))


class Repeating:
    """Publishes one thing again and again, stamped with now, until the block ends."""

    def __init__(self, publish, hz=20.0):
        """Take publish(stamp)."""
        self._publish, self._period = publish, 1 / hz
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        """Begin."""
        self._thread.start()
        return self

    def __exit__(self, *_):
        """End."""
        self._end.set()
        self._thread.join()

    def _run(self):
        while not self._end.wait(self._period):
            self._publish(time.time_ns())


def transform(stamp, parent, child, y=0.0):
    """Return a TFMessage with one transform; *stamp* as a message or in ns."""
    one = TransformStamped(child_frame_id=child)
    one.header.frame_id = parent
    one.header.stamp = Time(nanoseconds=stamp).to_msg() if isinstance(stamp, int) else stamp
    one.transform.translation.y = y
    one.transform.rotation.w = 1.0
    return TFMessage(transforms=[one])
