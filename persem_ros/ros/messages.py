"""Arrays to messages of rclpy; large data passes through array.array, which rclpy copies once."""

from __future__ import annotations

from array import array
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.recording.messages import DATATYPES, PIXELS
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

if TYPE_CHECKING:
    from persem_ros.settings.legend import Legend

# Not part of every installation; for other modules, too.
try:
    from vision_msgs.msg import LabelInfo as LabelInfo, VisionClass
except ImportError:
    LabelInfo = None
try:
    from px4_msgs.msg import VehicleOdometry as VehicleOdometry
except ImportError:
    VehicleOdometry = None
try:
    from stereo_msgs.msg import DisparityImage as DisparityImage
except ImportError:
    DisparityImage = None
# What to do where a topic has a type whose package is not installed.
INSTALL = {'px4_msgs/msg/VehicleOdometry':
           'put https://github.com/PX4/px4_msgs, of the release of your PX4, into the workspace, '
           'colcon build, source it again',
           'stereo_msgs/msg/DisparityImage': 'sudo apt install ros-jazzy-stereo-msgs'}


def header(stamp: int, frame_id: str) -> Header:
    """Return a Header; *stamp* in ns."""
    seconds, nanoseconds = divmod(int(stamp), 1_000_000_000)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def data_of(values: NDArray[Any]) -> array[int]:
    """
    Return an array's bytes.

    That costs 0.1 ms a megabyte; an ndarray or a list handed to a message costs 50 ms, because
    every element is checked.

    """
    data = array('B')
    data.frombytes(np.ascontiguousarray(values).reshape(-1).data.cast('B'))
    return data


def image(stamp: int, frame_id: str, values: NDArray[Any], encoding: str) -> Image:
    """Return that of *values*, (H, W) or (H, W, 3) of the encoding's type."""
    code, channels = PIXELS[encoding]
    height, width = values.shape[:2]
    step = width * channels * np.dtype(code).itemsize
    return Image(header=header(stamp, frame_id), height=height, width=width, encoding=encoding,
                 is_bigendian=0, step=step, data=data_of(values.astype(code, copy=False)))


def label_info(legend: Legend) -> LabelInfo:
    """
    Return a legend as vision_msgs/LabelInfo, which has no colours.

    Its stamp is 0: the ids of a map only become more, so that it holds for every image.

    """
    return LabelInfo(class_map=[VisionClass(class_id=item.id, class_name=item.name)
                                for item in legend.classes])


def cloud(stamp: int, frame_id: str, points: NDArray[np.void]) -> PointCloud2:
    """
    Return that of a little-endian structured array (n,) or (h, w).

    An organised cloud (h, w) may hold points that are none: it is not called dense.

    """
    step = points.dtype.itemsize
    known = points.dtype.fields
    assert known is not None, 'points are a structured array'
    fields = [PointField(name=name, offset=offset, datatype=DATATYPES[kind.base.str[1:]],
                         count=int(np.prod(kind.shape)))
              for name, (kind, offset, *_) in known.items()]
    height, width = points.shape if points.ndim == 2 else (1, len(points))
    return PointCloud2(header=header(stamp, frame_id), height=height, width=width, fields=fields,
                       is_bigendian=False, point_step=step, row_step=step * width,
                       data=data_of(points.view(np.uint8)), is_dense=points.ndim == 1)
