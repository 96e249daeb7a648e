"""Pose messages and transforms to 4x4 matrices, of ROS and of PX4."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import transform
from persem_ros.inputs.decode import px4
from persem_ros.inputs.decode.messages import BadMessage, frame_id, stamp_ns

NORM_TOLERANCE = 1e-2       # a quaternion farther from length 1 is no rotation


def pose(msg: Any) -> tuple[int, NDArray[np.float64], str, str]:
    """
    Read a pose.

    Parameters
    ----------
    msg : PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped or VehicleOdometry
        All of them say where a child frame is in a parent frame.

    Returns
    -------
    stamp : int
        Nanoseconds.
    T : ndarray, shape (4, 4), float64
        Maps points of the child frame to the parent frame.
    parent, child : str
        Frames; the child is '' where the message has none.

    Raises
    ------
    BadMessage
        A position that is not finite, a quaternion whose norm is not within 1e-2 of 1.

    """
    if hasattr(msg, 'timestamp_sample'):
        try:
            return px4.pose(msg)
        except ValueError as error:
            raise BadMessage(*error.args) from None
    if hasattr(msg, 'transform'):
        position, rotation = msg.transform.translation, msg.transform.rotation
    else:
        inner = msg.pose.pose if hasattr(msg.pose, 'pose') else msg.pose
        position, rotation = inner.position, inner.orientation
    q = unit_quaternion((rotation.x, rotation.y, rotation.z, rotation.w))
    xyz = (position.x, position.y, position.z)
    if not all(map(math.isfinite, xyz)):
        raise BadMessage('position not finite', f'a pose has the position {xyz}')
    child = getattr(msg, 'child_frame_id', '').lstrip('/')
    return stamp_ns(msg), transform(xyz, q), frame_id(msg), child


def transforms(
        msg: Any) -> tuple[list[tuple[int, NDArray[np.float64], str, str]], list[BadMessage]]:
    """
    Read a tf2_msgs/TFMessage.

    Returns
    -------
    list
        What `pose` gives for each transform that can be used.
    list
        What was wrong with the others.

    """
    good, faults = [], []
    for item in msg.transforms:
        try:
            good.append(pose(item))
        except BadMessage as fault:
            faults.append(fault)
    return good, faults


def unit_quaternion(q: Sequence[float]) -> tuple[float, float, float, float]:
    """Return *q* (x, y, z, w) with norm 1; refuse one that is farther than 1e-2 from it."""
    norm = math.sqrt(sum(x * x for x in q))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:      # also NaN
        raise BadMessage('quaternion not of length 1',
                         f'a pose has the quaternion {tuple(q)} of length {norm:.4g}, expected 1')
    x, y, z, w = q
    return x / norm, y / norm, z / norm, w / norm
