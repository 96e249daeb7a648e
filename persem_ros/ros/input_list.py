"""What the settings have a node listen to: which topics, and as which types each may come."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import px4
from persem_ros.inputs.intake import (
    INFO, LABELS_INFO, LEGEND, ORDER, POSE, TF, TRAJECTORY)
from persem_ros.inputs.recording.kinds import roles_of
from persem_ros.inputs.sync.match import COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.ros.messages import DisparityImage, INSTALL, LabelInfo, VehicleOdometry
from persem_ros.ros.topic import Input, MessageClass, TF_STATIC
from persem_ros.settings.config import Labels, NO_TABLE, Topics, topics_of
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

if TYPE_CHECKING:
    from persem_ros.inputs.intake import Station, Taker
    from persem_ros.inputs.live import LiveIntake
    from persem_ros.settings.config import Config
    from rclpy.node import Node

QOS_OF = {CONFIDENCE: LABELS, DEPTH_CONFIDENCE: DEPTH}
POSES = {cls.__name__: cls for cls in (PoseStamped, PoseWithCovarianceStamped, Odometry,
                                       TransformStamped, VehicleOdometry) if cls}
SMALL_FACTOR = 50       # poses and camera infos kept per image: they outlast a busy second or ten


class InputList:
    """
    The inputs of a node, before any of them is subscribed to.

    Parameters
    ----------
    node : rclpy.node.Node
        Resolves names.
    config : Config
    intake : LiveIntake
        Gets its cameras and their pose buffers here.

    Attributes
    ----------
    all : list of Input
    stations : dict of str to Station
        By camera.
    buffers : dict of str to PoseBuffer
        By the topic of the poses.

    """

    def __init__(self, node: Node, config: Config, intake: LiveIntake) -> None:
        """List them all."""
        self._node, self._config = node, config
        self.buffers: dict[str, PoseBuffer] = {}
        self._infos: dict[tuple[str, str], Input] = {}
        self.stations: dict[str, Station] = {}
        self.all: list[Input] = []
        self._tf = config.topics.tf or '/tf'
        for camera in [name for name in config.cameras if name] or ['']:
            self._add_camera(topics_of(config, camera), camera, intake)
        # Poses may be in another frame than the map; /tf says where that is.
        for role, topic in ((TF, self._tf), (TF_STATIC, f'{self._tf}_static')):
            if not any(one.role == role for one in self.all):
                self._add(role, topic, list(self.buffers.values()), [TFMessage],
                          config.qos.pose if role == TF else 'auto', 1000)
        self._add_legend(config)
        if config.topics.trajectory:
            self._add(TRAJECTORY, config.topics.trajectory, [None], [Path], 'auto', 1)

    def _add_camera(self, topics: Topics, camera: str, intake: LiveIntake) -> None:
        """Add a camera's images, their camera infos, and poses that no other camera shares."""
        qos, roles = self._config.qos, roles_of(self._config, topics)
        poses = self._poses(topics)
        needed = [role for role in (DEPTH, CONFIDENCE, DEPTH_CONFIDENCE)
                  if role in roles and getattr(topics, roles[role])]
        colors = [COLOR] if COLOR in roles else []
        station = self.stations[camera] = intake.add_camera(camera, poses, colors, needed)
        for role in (LABELS, *needed, *colors):
            kinds = [PointCloud2] if roles[role] == 'points' else [Image, CompressedImage]
            if role == DEPTH and kinds[0] is Image and DisparityImage:
                kinds.append(DisparityImage)
            self._add(role, getattr(topics, roles[role]), [station], kinds,
                      getattr(qos, QOS_OF.get(role, role)), qos.queue)
        for role in [role for role in (INFO, LABELS_INFO) if role in roles]:
            key = role, getattr(topics, roles[role])
            if key in self._infos:
                self._infos[key].takers.append(station)
            else:
                self._infos[key] = self._add(role, key[1], [station], [CameraInfo],
                                             qos.camera_info, SMALL_FACTOR * qos.queue)
                self._infos[key].choices += self._infos_of(role, topics)

    def _poses(self, topics: Topics) -> PoseBuffer:
        """Return the buffer of a camera's poses; list what they come from where it is new."""
        qos, pose = self._config.qos, self._config.pose
        small = SMALL_FACTOR * qos.queue
        name = topics.pose if pose.source == 'topic' else self._tf
        if name in self.buffers:
            return self.buffers[name]
        buffer = self.buffers[name] = PoseBuffer(self._config, strict=True)
        if pose.source == 'tf':
            self._add(TF, name, [buffer], [TFMessage], qos.pose, small)
            return buffer
        if pose.type != 'auto' and pose.type not in POSES:
            raise PersemError(f'pose.type: px4_msgs is not installed, which {pose.type} '
                              f'is of; {INSTALL[px4.TYPE]}')
        kinds = [POSES[pose.type]] if pose.type in POSES else list(POSES.values())
        self._add(POSE, name, [buffer], kinds, qos.pose, small)
        return buffer

    def _add_legend(self, config: Config) -> None:
        """Listen to tables of class names where labels.topic says, or beside the labels."""
        if config.labels.topic == NO_TABLE:
            return
        kinds = [String, LabelInfo] if LabelInfo else [String]
        one = self._add(LEGEND, config.labels.topic, [None], kinds, 'auto', 10)
        if LabelInfo and config.labels.topic == Labels().topic:
            one.choices += [(topic, LabelInfo) for labels in self.all if labels.role == LABELS
                            for topic in beside(labels.topic, 'label_info')]

    def _infos_of(self, role: str, topics: Topics) -> list[tuple[str, MessageClass]]:
        """Return where else the camera info of a camera's labels may be: beside them."""
        if roles_of(self._config, topics)[role] != LABELS_INFO or \
                not topics.labels_info.endswith(Topics().labels_info):
            return []       # that of the depth, or a name that was typed
        labels, depth = (self._node.resolve_topic_name(name)
                         for name in (topics.labels, topics.camera_info))
        return [(topic, CameraInfo) for topic in beside(labels, 'camera_info') if topic != depth]

    def _add(self, role: str, name: str, takers: Sequence[Taker], kinds: list[MessageClass],
             setting: str, depth: int) -> Input:
        """Add an input whose topic has one of *kinds*; images may come by a transport."""
        topic = self._node.resolve_topic_name(name)
        choices = [(topic, kind) for kind in kinds]
        if role in ORDER:
            transports = ('compressedDepth', 'compressed') if role == DEPTH else ('compressed',)
            choices += [(self._transport(name, topic, transport), CompressedImage)
                        for transport in transports]
        self.all.append(Input(role, name, topic, list(takers), choices, setting, depth))
        return self.all[-1]

    def _transport(self, name: str, topic: str, transport: str) -> str:
        """Return a transport's topic: below the remapped topic, unless it is remapped itself."""
        own = f'{name}/{transport}'
        resolved = self._node.resolve_topic_name(own)
        remapped = resolved != self._node.resolve_topic_name(own, only_expand=True)
        return resolved if remapped else f'{topic}/{transport}'


def beside(topic: str, name: str) -> Iterator[str]:
    """Yield where what belongs to a topic may be: below it, beside it, above it."""
    while topic:
        yield f'{topic}/{name}'
        topic = topic.rpartition('/')[0]


def check_topics(config: Config) -> None:
    """Refuse settings that would give two kinds of messages one topic."""
    for camera in [name for name in config.cameras if name] or ['']:
        topics = topics_of(config, camera)
        if topics.labels == topics.depth:
            raise PersemError(f'topics.labels and topics.depth are both {topics.depth!r}; '
                              'expected two topics')
