"""Refined labels out: the topics of one camera, or of one LiDAR with labelled clouds."""

import cv2
import numpy as np
from persem_ros.core.frame.images import on_labels
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.recording.refined import fitted
from persem_ros.ros.messages import cloud, image
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2

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
        legend() gives the persem_ros.settings.legend.Legend in force.
    clouds : bool
        Whether its input is labelled clouds.

    """

    def __init__(self, node, camera, legend, clouds=False):
        """Advertise the topics."""
        base = f'~/{camera}/' if camera else '~/'
        self._legend = legend
        kinds = {'points': PointCloud2} if clouds else dict.fromkeys(
            ('labels', 'labels_color', 'overlay', 'source'), Image)
        self._out = {name: node.create_publisher(kind, f'{base}{name}', QOS)
                     for name, kind in kinds.items()}

    def wanted(self):
        """Return the names of the topics that somebody listens to."""
        return {name for name, out in self._out.items() if out.get_subscription_count()}

    def publish(self, wanted, frame, labels, sources):
        """
        Publish what is wanted of a frame.

        Parameters
        ----------
        wanted : set of str
            Names of topics.
        frame : persem_ros.frames.Frame
            The input.
        labels : ndarray, shape (H, W), int32
            Refined labels.
        sources : callable
            sources() gives which step decided each pixel of the depth grid, uint8 (h, w).

        """
        if 'points' in wanted:      # the cloud as it came, with other labels
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

    def _send(self, name, frame, values, encoding):
        self._out[name].publish(image(frame.stamp, frame.frame_id, values, encoding))


def overlay(frame, colors):
    """Return colours, uint8 (H, W, 3), over the frame's colour image, else over its depth."""
    height, width = colors.shape[:2]
    if frame.color is not None:
        below = cv2.resize(frame.color, (width, height), interpolation=cv2.INTER_AREA)
    else:
        depth = on_labels(frame, frame.depth, 0)
        known = np.isfinite(depth) & (depth > 0)
        scale = 255.0 / max(float(np.percentile(depth[known], 95)), 1e-6) if known.any() else 0.0
        grey = np.where(known, 255.0 - np.minimum(np.where(known, depth, 0) * scale, 230.0), 0)
        below = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    return cv2.addWeighted(colors, 0.5, np.ascontiguousarray(below), 0.5, 0.0)
