"""Subscriptions: they only queue. Transports and pose types are taken from the graph."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
import time
from typing import Any, TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import px4
from persem_ros.inputs.intake import (
    INFO, LABELS_INFO, LEGEND, ORDER, POSE, TF, TRAJECTORY)
from persem_ros.inputs.recording.topics import roles_of
from persem_ros.inputs.sync.pairing import (
    COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS)
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.ros.inbox import Item
from persem_ros.ros.messages import DisparityImage, INSTALL, LabelInfo, VehicleOdometry
from persem_ros.ros.topic import Input, MessageClass, TF_STATIC, type_name
from persem_ros.settings.config import Labels, Topics, topics_of
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy)
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

if TYPE_CHECKING:
    from persem_ros.inputs.intake import Station, Taker
    from persem_ros.inputs.live import LiveIntake
    from persem_ros.ros.inbox import Inbox
    from persem_ros.settings.config import Config
    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rclpy.topic_endpoint_info import TopicEndpointInfo

OPTIONAL = (COLOR, TF_STATIC, LABELS_INFO, LEGEND, TRAJECTORY)     # nobody need publish them
QOS_OF = {CONFIDENCE: LABELS, DEPTH_CONFIDENCE: DEPTH}
POSES = {cls.__name__: cls for cls in (PoseStamped, PoseWithCovarianceStamped, Odometry,
                                       TransformStamped, VehicleOdometry) if cls}
SHOWN = 4               # topics in a sentence
SMALL_FACTOR = 50       # poses and camera infos kept per image: they outlast a busy second or ten


class Inputs:
    """
    All subscriptions of a node.

    Parameters
    ----------
    node : rclpy.node.Node
    config : Config
    intake : LiveIntake
        Gets its cameras and their pose buffers here.
    inbox : Inbox
        Where messages go.

    """

    def __init__(self, node: Node, config: Config, intake: LiveIntake, inbox: Inbox) -> None:
        """Subscribe to whatever needs no look at the graph."""
        self._node, self._config, self._inbox = node, config, inbox
        self._buffers: dict[str, PoseBuffer] = {}
        self._infos: dict[tuple[str, str], Input] = {}
        self.stations: dict[str, Station] = {}      # by camera
        self._colored = False
        self.all: list[Input] = []
        self._tf = config.topics.tf or '/tf'
        for camera in [name for name in config.cameras if name] or ['']:
            self._add_camera(topics_of(config, camera), camera, intake)
        # Poses may be in another frame than the map; /tf says where that is.
        for role, topic in ((TF, self._tf), (TF_STATIC, f'{self._tf}_static')):
            if not any(one.role == role for one in self.all):
                self._add(role, topic, list(self._buffers.values()), [TFMessage],
                          config.qos.pose if role == TF else 'latched', 1000)
        self._add_legend(config)
        if config.topics.trajectory:
            self._add(TRAJECTORY, config.topics.trajectory, [None], [Path], 'auto', 1)
        self.resolve()

    @property
    def pose_buffers(self) -> list[PoseBuffer]:
        """Return the pose buffers of all cameras; only the worker may ask them."""
        return list(self._buffers.values())

    @property
    def settled(self) -> bool:
        """Whether every topic has a publisher of a type that was subscribed to."""
        return all(one.chosen is not None and self.publishers(one) for one in self.needed)

    @property
    def needed(self) -> list[Input]:
        """Return the inputs without which there is no frame."""
        tf = self._config.pose.source == 'tf'
        return [one for one in self.all
                if one.role not in OPTIONAL and (tf or one.role != TF)]

    def resolve(self) -> None:
        """Follow the graph: the first of an input's choices that is published, as it is."""
        for one in self.all:
            if one.role == COLOR and not self._colored:
                continue
            if one.role == TF and not any(
                    isinstance(taker, PoseBuffer) and taker.needs_tf for taker in one.takers):
                self._unsubscribe(one)      # hundreds of messages a second that nobody needs
                continue
            number = one.chosen
            if number is None or not self.publishers(one):
                number = next((n for n in range(len(one.choices))
                               if self._published(*one.choices[n])), one.chosen)
            if number is None and one.setting != 'auto' and (
                    len(one.choices) == 1 or one.role in (LABELS, DEPTH)):
                number = 0
            if number is not None:
                self._subscribe(one, number)
            if one.role in (INFO, LABELS_INFO, LEGEND, TRAJECTORY):
                self._listen_to_the_past(one)

    def want_color(self, wanted: bool) -> None:
        """Subscribe to colour images, or no longer: only the overlay needs them."""
        self._colored = wanted
        for one in self.all:
            if one.role == COLOR and not wanted:
                self._unsubscribe(one)

    def publishers(self, one: Input) -> list[TopicEndpointInfo]:
        """Return the endpoints that publish what an input listens to."""
        return [] if one.chosen is None else self._published(*one.choices[one.chosen])

    def verdict(self, one: Input) -> str:
        """Return what stands between an input and its publishers, '' for nothing."""
        everybody = self._node.get_publishers_info_by_topic(one.listened)
        if not everybody:
            return f'no publisher{self._elsewhere(one)}'
        fitting = self.publishers(one)
        if not fitting:
            kind = everybody[0].topic_type
            known = kind in INSTALL and kind not in map(type_name, [cls for _, cls in one.choices])
            return f'published as {kind}' + (
                f', whose package is not installed: {INSTALL[kind]}' if known else '')
        if not one.reliability:
            return 'not subscribed yet'
        profile = _profile(one.reliability, one.depth)
        reasons = [qos_check_compatible(end.qos_profile, profile) for end in fitting]
        if all(verdict == QoSCompatibility.ERROR for verdict, _ in reasons):
            return f'QoS does not fit ({reasons[0][1].strip("; ")}); see qos.{one.role}'
        return ''

    def _elsewhere(self, one: Input) -> str:
        """Return where a topic's type is published, and what to type; '' where nowhere."""
        own = f'{self._node.get_fully_qualified_name()}/'
        taken = {other.listened for other in self.all if other.count}
        kinds = {type_name(cls) for _, cls in one.choices}
        found = sorted(name for name, types in self._node.get_topic_names_and_types()
                       if kinds & set(types) and name not in taken and not name.startswith(own)
                       and self._node.count_publishers(name))
        if one.role == TF:
            found = [name for name in found if name.endswith('/tf')]
        if not found:
            return ''
        flag = f'-p topics.tf:={found[0]}' if one.role == TF else \
            f'-r {one.name}:={found[0]}'
        return f' ({", ".join(found[:SHOWN])} {"is" if len(found) == 1 else "are"} of its type: ' \
               f'{flag})'

    def describe(self) -> str:
        """Return what is listened to, under the names after remapping, in one line."""
        shown = [one for one in self.all if one.role not in OPTIONAL
                 and (one in self.needed or one.chosen is not None)]
        return ', '.join(f'{one.listened} ({one.role})' for one in shown)

    def _add_camera(self, topics: Topics, camera: str, intake: LiveIntake) -> None:
        qos, pose = self._config.qos, self._config.pose
        small = SMALL_FACTOR * qos.queue
        name = topics.pose if pose.source == 'topic' else self._tf
        if name not in self._buffers:
            buffer = self._buffers[name] = PoseBuffer(self._config, strict=True)
            if pose.source == 'tf':
                self._add(TF, name, [buffer], [TFMessage], qos.pose, small)
            else:
                if pose.type != 'auto' and pose.type not in POSES:
                    raise PersemError(f'pose.type: px4_msgs is not installed, which {pose.type} '
                                      f'is of; {INSTALL[px4.TYPE]}')
                kinds = [POSES[pose.type]] if pose.type in POSES else list(POSES.values())
                self._add(POSE, name, [buffer], kinds, qos.pose, small)
        roles = roles_of(self._config, topics)
        needed = [role for role in (DEPTH, CONFIDENCE, DEPTH_CONFIDENCE)
                  if role in roles and getattr(topics, roles[role])]
        colors = [COLOR] if COLOR in roles else []
        station = self.stations[camera] = intake.add_camera(
            camera, self._buffers[name], colors, needed)
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
                                             qos.camera_info, small)
                self._infos[key].choices += self._infos_of(role, topics)

    def _add_legend(self, config: Config) -> None:
        """Listen to tables of class names where labels.topic says, or beside the labels."""
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

    def _published(self, topic: str, cls: MessageClass) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic with the type of *cls*."""
        return [end for end in self._node.get_publishers_info_by_topic(topic)
                if end.topic_type == type_name(cls)]

    def _subscribe(self, one: Input, number: int) -> None:
        """Listen to an input's choice *number*, in the way that fits its publishers."""
        reliability = self._reliability(one, number)
        if one.subscriptions and (number, reliability) == (one.chosen, one.reliability):
            return
        self._unsubscribe(one)
        one.chosen, one.reliability = number, reliability
        one.subscriptions = [self._subscription(one, reliability)]

    def _reliability(self, one: Input, number: int) -> str:
        """Return how to subscribe to an input's choice *number*, as rosbag2 decides."""
        if one.setting != 'auto':
            return one.setting
        ends = self._published(*one.choices[number])
        if not ends:        # they went away; the next may be like them
            return one.reliability or 'best_effort'
        reliable = all(end.qos_profile.reliability == ReliabilityPolicy.RELIABLE for end in ends)
        return 'reliable' if reliable else 'best_effort'

    def _subscription(self, one: Input, reliability: str) -> Subscription:
        """
        Return a subscription that hands out serialized messages.

        They are decoded once, by the worker, with the replay's own code, and damaged ones do not
        reach the middleware's.

        """
        assert one.chosen is not None       # _subscribe() sets it before
        topic, cls = one.choices[one.chosen]
        received = partial(self._received, one, type_name(cls))
        profile = _profile(reliability, one.depth)
        create = partial(self._node.create_subscription, cls, topic, received, profile, raw=True)
        if one.is_image:
            try:
                return create(event_callbacks=SubscriptionEventCallbacks(
                    message_lost=partial(_lost, one)))
            except UnsupportedEventTypeError:
                pass
        return create()

    def _listen_to_the_past(self, one: Input) -> None:
        """
        Subscribe once more to an input that somebody publishes latched.

        A volatile subscription misses what was latched before it, a latched one does not match
        a volatile publisher: only both hear everybody.

        """
        if len(one.subscriptions) == 1 and one.reliability != 'latched' and any(
                end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for end in self.publishers(one)):
            one.subscriptions.append(self._subscription(one, 'latched'))

    def _unsubscribe(self, one: Input) -> None:
        for subscription in one.subscriptions:
            self._node.destroy_subscription(subscription)
        one.subscriptions, one.chosen, one.reliability = [], None, ''

    def _received(self, one: Input, kind: str, data: bytes) -> None:
        one.note(data)
        self._inbox.put(Item(time.monotonic_ns(), one, kind, data))


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


def _lost(one: Input, event: Any) -> None:
    """Count what the middleware has lost."""
    one.lost += event.total_count_change


def _profile(setting: str, depth: int) -> QoSProfile:
    """Return that of 'best_effort', 'reliable' or 'latched'."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if setting == 'best_effort'
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if setting == 'latched'
        else DurabilityPolicy.VOLATILE)
