"""Refined labels out: the topics of one camera, or of one LiDAR with labelled clouds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.images import on_labels
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.recording.refined import fitted
from persem_ros.ros.messages import cloud, image
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.settings.legend import Legend
    from rclpy.node import Node

NO_SOURCE = 255         # in ~/source: the map knows nothing there
QOS = QoSProfile(depth=5)       # reliable and volatile: what every subscriber can take


class ImageOutputs:
    """
    Publishers of labels, labels_color, overlay and source of one camera; of clouds: of points.

    Parameters
    ----------
    node : rclpy.node.Node
    camera : str
        Its name, '' where there is only one.
    legend : callable
        legend() gives the one in force.
    clouds : bool
        Whether its input is labelled clouds.

    """

    def __init__(self, node: Node, camera: str, legend: Callable[[], Legend],
                 clouds: bool = False) -> None:
        """Advertise the topics."""
        base = f'~/{camera}/' if camera else '~/'
        self._legend = legend
        kinds = {'points': PointCloud2} if clouds else dict.fromkeys(
            ('labels', 'labels_color', 'overlay', 'source'), Image)
        self._out = {name: node.create_publisher(kind, f'{base}{name}', QOS)
                     for name, kind in kinds.items()}

    def wanted(self) -> set[str]:
        """Return the names of the topics that somebody listens to."""
        return {name for name, out in self._out.items() if out.get_subscription_count()}

    def publish(self, wanted: set[str], frame: Frame, labels: NDArray[np.int32],
                sources: Callable[[], NDArray[np.uint8]]) -> None:
        """
        Publish what is wanted of a frame.

        Parameters
        ----------
        wanted : set
            Names of topics.
        frame : Frame
            The input.
        labels : ndarray, shape (H, W), int32
            Refined labels.
        sources : callable
            sources() gives which step decided each pixel of the depth grid, uint8 (h, w).

        """
        if 'points' in wanted:      # the cloud as it came, with other labels
            assert frame.cloud is not None      # ~/points is advertised for clouds only
            self._out['points'].publish(cloud(frame.stamp, frame.frame_id,
                                              frame.cloud.with_labels(labels)))
        if 'labels' in wanted:
            self._send('labels', frame, fitted(labels, frame.encoding), frame.encoding)
        if 'source' in wanted:
            self._send('source', frame, on_labels(frame, sources(), NO_SOURCE), 'mono8')
        if not wanted & {'labels_color', 'overlay'}:
            return
        colors = self._legend().colors(np.where(labels < 0, UNKNOWN, labels))
        if 'labels_color' in wanted:
            self._send('labels_color', frame, colors, 'rgb8')
        if 'overlay' in wanted:
            self._send('overlay', frame, overlay(frame, colors), 'rgb8')

    def _send(self, name: str, frame: Frame, values: NDArray[Any], encoding: str) -> None:
        self._out[name].publish(image(frame.stamp, frame.frame_id, values, encoding))


def overlay(frame: Frame, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours, uint8 (H, W, 3), over the frame's colour image, else over its depth."""
    height, width = colors.shape[:2]
    if frame.color is not None:
        below = np.asarray(
            cv2.resize(frame.color, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    else:
        depth = on_labels(frame, frame.depth, 0)
        known = np.isfinite(depth) & (depth > 0)
        scale = 255.0 / max(float(np.percentile(depth[known], 95)), 1e-6) if known.any() else 0.0
        grey = np.where(known, 255.0 - np.minimum(np.where(known, depth, 0) * scale, 230.0), 0)
        below = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    mixed = cv2.addWeighted(colors, 0.5, np.ascontiguousarray(below), 0.5, 0.0)
    return np.asarray(mixed, np.uint8)
