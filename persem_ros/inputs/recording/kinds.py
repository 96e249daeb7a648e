"""Kinds of topics: what each is called in the settings, of which message types it may be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from persem_ros.inputs.decode import clouds, px4

if TYPE_CHECKING:
    from persem_ros.settings.config import Config, Topics

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
DISPARITY = 'stereo_msgs/msg/DisparityImage'
INFO = 'sensor_msgs/msg/CameraInfo'
TF = 'tf2_msgs/msg/TFMessage'
POSES = {'PoseStamped': 'geometry_msgs/msg/PoseStamped',
         'PoseWithCovarianceStamped': 'geometry_msgs/msg/PoseWithCovarianceStamped',
         'Odometry': 'nav_msgs/msg/Odometry',
         'TransformStamped': 'geometry_msgs/msg/TransformStamped',
         'VehicleOdometry': px4.TYPE}
NEEDED = {'labels': 'label images', 'depth': 'depth images', 'camera_info': 'camera infos',
          'pose': 'poses'}
OPTIONAL = {'truth': 'true label images', 'color': 'colour images',
            'confidence': 'confidence images', 'depth_confidence': 'depth confidence images',
            'points': 'point clouds', 'labels_info': "camera infos of the labels' own camera"}
LABELS_INFO, POINTS = 'labels_info', clouds.TYPE


def roles_of(config: Config, topics: Topics) -> dict[str, str]:
    """
    Return what a camera needs or may have: {kind: the setting topics.* that says where}.

    A labelled cloud takes the place of the label images and needs no depth; with
    depth.source=cloud that of the depth images, seen by the camera of the labels.

    """
    if topics.points and config.depth.source == 'image':
        return {'labels': 'points', 'pose': 'pose'}
    roles = {kind: kind for kind in (*NEEDED, *OPTIONAL) if kind not in ('points', LABELS_INFO)}
    if config.depth.source == 'cloud':
        del roles['depth_confidence']
        return {**roles, 'depth': 'points', 'camera_info': LABELS_INFO}
    return {**roles, LABELS_INFO: LABELS_INFO}
