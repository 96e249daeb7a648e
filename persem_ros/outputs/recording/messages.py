"""Arrays to ROS messages, through the message classes of a rosbags typestore."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import matrix_to_quaternion
from persem_ros.errors import PersemError

PIXELS = {'mono8': ('<u1', 1), '8UC1': ('<u1', 1), 'mono16': ('<u2', 1), '16UC1': ('<u2', 1),
          '16SC1': ('<i2', 1), '32SC1': ('<i4', 1), '32FC1': ('<f4', 1),
          'rgb8': ('<u1', 3), 'bgr8': ('<u1', 3)}
DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


class MessageFactory:
    """
    Builds messages; stamps are integer nanoseconds, transforms 4x4 float64.

    Parameters
    ----------
    types : mapping
        Full type name ('sensor_msgs/msg/Image') to message class.

    """

    def __init__(self, types: dict[str, type[Any]]) -> None:
        self._types = types

    def make(self, name: str, *values: Any, **fields: Any) -> Any:
        """Return a message of the type *name*, e.g. 'std_msgs/msg/String'."""
        return self._types[name](*values, **fields)

    def header(self, stamp: int, frame_id: str) -> Any:
        """Return a std_msgs/Header."""
        seconds, nanoseconds = divmod(int(stamp), 1_000_000_000)
        time = self.make('builtin_interfaces/msg/Time', seconds, nanoseconds)
        return self.make('std_msgs/msg/Header', time, frame_id)

    def image(self, stamp: int, frame_id: str, array: NDArray[Any], encoding: str) -> Any:
        """
        Return a sensor_msgs/Image, little-endian, rows without padding.

        Parameters
        ----------
        stamp : int
            Nanoseconds.
        frame_id : str
            Header frame.
        array : ndarray, shape (H, W) or (H, W, 3)
            Values of the encoding's type; another type is refused, never converted.
        encoding : str
            A key of PIXELS.

        """
        if encoding not in PIXELS:
            raise PersemError(f'image encoding {encoding!r}: expected one of {", ".join(PIXELS)}')
        code, channels = PIXELS[encoding]
        array = np.asarray(array)
        shape = array.shape if channels == 1 else array.shape[:-1]
        if len(shape) != 2 or array.dtype.newbyteorder('<') != np.dtype(code) \
                or (channels > 1 and array.shape[-1] != channels):
            raise PersemError(
                f'image of encoding {encoding}: expected {np.dtype(code).name} of shape (H, W'
                f'{", 3" if channels > 1 else ""}), got {array.dtype.name} of {array.shape}')
        data = np.ascontiguousarray(array, code).reshape(-1).view(np.uint8)
        step = shape[1] * channels * np.dtype(code).itemsize
        return self.make('sensor_msgs/msg/Image', self.header(stamp, frame_id), *shape, encoding,
                         0, step, data)

    def compressed(self, stamp: int, frame_id: str, image_format: str,
                   data: bytes | NDArray[np.uint8]) -> Any:
        """Return a sensor_msgs/CompressedImage of what has been encoded."""
        return self.make('sensor_msgs/msg/CompressedImage', self.header(stamp, frame_id),
                         image_format, np.frombuffer(data, np.uint8))

    def camera_info(self, stamp: int, frame_id: str, width: int, height: int,
                    K: NDArray[np.float64], D: NDArray[np.float64] | Sequence[float] = (),
                    model: str = 'plumb_bob', P: NDArray[np.float64] | None = None) -> Any:
        """Return a sensor_msgs/CameraInfo; K (3, 3), D any length, P (3, 4), default [K 0]."""
        K = np.asarray(K, float).reshape(3, 3)
        P = np.hstack([K, np.zeros((3, 1))]) if P is None else np.asarray(P, float).reshape(3, 4)
        roi = self.make('sensor_msgs/msg/RegionOfInterest', 0, 0, 0, 0, False)
        return self.make(
            'sensor_msgs/msg/CameraInfo', self.header(stamp, frame_id), int(height), int(width),
            model, np.asarray(D, float).reshape(-1), K.reshape(-1), np.eye(3).reshape(-1),
            P.reshape(-1), 0, 0, roi)

    def _place(self, T: NDArray[np.float64], vector: str) -> tuple[Any, Any]:
        T = np.asarray(T, float)
        x, y, z, w = map(float, matrix_to_quaternion(T[:3, :3]))
        return (self.make(f'geometry_msgs/msg/{vector}', *map(float, T[:3, 3])),
                self.make('geometry_msgs/msg/Quaternion', x, y, z, w))

    def transform(self, stamp: int, parent: str, child: str, T: NDArray[np.float64]) -> Any:
        """Return a geometry_msgs/TransformStamped; *T* maps child points to the parent."""
        value = self.make('geometry_msgs/msg/Transform', *self._place(T, 'Vector3'))
        return self.make('geometry_msgs/msg/TransformStamped', self.header(stamp, parent), child,
                         value)

    def pose(self, stamp: int, frame_id: str, T: NDArray[np.float64], kind: str = 'PoseStamped',
             child_frame: str = '') -> tuple[str, Any]:
        """
        Return (type name, message) of a pose.

        Parameters
        ----------
        stamp : int
            Nanoseconds.
        frame_id : str
            The frame that the pose is given in.
        T : ndarray, shape (4, 4)
            Maps points of the posed frame to *frame_id*, metres.
        kind : str
            PoseStamped, PoseWithCovarianceStamped, Odometry or TransformStamped.
        child_frame : str
            The posed frame; only Odometry and TransformStamped carry it.

        """
        if kind == 'TransformStamped':
            return (f'geometry_msgs/msg/{kind}', self.transform(stamp, frame_id, child_frame, T))
        name, header = f'geometry_msgs/msg/{kind}', self.header(stamp, frame_id)
        pose = self.make('geometry_msgs/msg/Pose', *self._place(T, 'Point'))
        if kind == 'PoseStamped':
            return name, self.make(name, header, pose)
        pose = self.make('geometry_msgs/msg/PoseWithCovariance', pose, np.zeros(36))
        if kind == 'PoseWithCovarianceStamped':
            return name, self.make(name, header, pose)
        if kind != 'Odometry':
            raise PersemError(f'pose type {kind!r}: expected PoseStamped, '
                              'PoseWithCovarianceStamped, Odometry or TransformStamped')
        still = self.make('geometry_msgs/msg/Vector3', 0.0, 0.0, 0.0)
        twist = self.make('geometry_msgs/msg/TwistWithCovariance',
                          self.make('geometry_msgs/msg/Twist', still, still), np.zeros(36))
        return 'nav_msgs/msg/Odometry', self.make('nav_msgs/msg/Odometry', header, child_frame,
                                                  pose, twist)

    def path(self, stamp: int, frame_id: str, poses: list[tuple[int, NDArray[np.float64]]],
             own_frame: str | None = None) -> Any:
        """Return a nav_msgs/Path of (stamp, T); poses name *own_frame*, where it is given."""
        own = frame_id if own_frame is None else own_frame
        items = [self.pose(at, own, T)[1] for at, T in poses]
        return self.make('nav_msgs/msg/Path', self.header(stamp, frame_id), items)

    def cloud(self, stamp: int, frame_id: str, points: NDArray[np.void]) -> Any:
        """
        Return a sensor_msgs/PointCloud2 with one field per field of *points*.

        Parameters
        ----------
        stamp : int
            Nanoseconds.
        frame_id : str
            Header frame.
        points : structured ndarray, shape (N,)
            Little-endian; offsets and point_step are those of its dtype.

        """
        points = np.ascontiguousarray(points).reshape(-1)
        fields = []
        for name, (kind, offset, *_) in (points.dtype.fields or {}).items():
            base, count = (kind.base, int(np.prod(kind.shape)))
            if base.str[1:] not in DATATYPES or base.str[0] == '>':
                raise PersemError(f'point field {name!r}: expected a little-endian type of '
                                  f'{", ".join(DATATYPES)}, got {base.str}')
            fields.append(self.make('sensor_msgs/msg/PointField', name, int(offset),
                                    DATATYPES[base.str[1:]], count))
        step = points.dtype.itemsize
        return self.make('sensor_msgs/msg/PointCloud2', self.header(stamp, frame_id), 1,
                         len(points), fields, False, step, step * len(points),
                         points.view(np.uint8).reshape(-1), True)
