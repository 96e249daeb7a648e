"""Subscriptions: they only queue. Transports and pose types are taken from the graph."""

from functools import partial
import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import messages
from persem_ros.inputs.intake import INFO, ORDER, POSE, TF
from persem_ros.inputs.sync.pairing import COLOR, DEPTH, LABELS
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.ros.inbox import Item
from persem_ros.settings.config import topics_of
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy)
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage

TF_STATIC = 'tf_static'
POSES = {cls.__name__: cls for cls in (PoseStamped, PoseWithCovarianceStamped, Odometry,
                                       TransformStamped)}
SMALL_FACTOR = 10       # poses and camera infos kept per image


class Input:
    """
    One topic that is listened to.

    Parameters
    ----------
    role : str
        'labels', 'depth', 'color', 'camera_info', 'pose', 'tf' or 'tf_static'.
    name : str
        The topic as the settings name it, relative.
    takers : list
        Stations or pose buffers that its messages are for.
    choices : list of (str, message class)
        What may be there: (topic, type), the preferred one first.
    profiles : list of QoSProfile
        One subscription each.

    Attributes
    ----------
    count : int
        Messages that came.

    """

    def __init__(self, role, name, takers, choices, profiles):
        """Keep what belongs together; nothing is subscribed yet."""
        self.role, self.name, self.takers = role, name, takers
        self.choices, self.profiles = choices, profiles
        self.is_image = role in ORDER
        self.chosen = None
        self.subscriptions = []
        self.count = 0
        self._last = b''

    @property
    def stamp(self):
        """Stamp of the last message in ns, None where there is none."""
        return self.stamp_of(self._last)

    def stamp_of(self, data):
        """Return the stamp of one of its messages in ns, None where it cannot be read."""
        if self.role in (TF, TF_STATIC):        # a sequence, whose first item has the header
            data = data[:4] + data[8:]
        try:
            return messages.header(data)[0]
        except messages.BadMessage:
            return None

    def note(self, data):
        """Count a message."""
        self.count += 1
        self._last = data[:512]     # an image is not kept alive for its stamp


class Inputs:
    """
    All subscriptions of a node.

    Parameters
    ----------
    node : rclpy.node.Node
    config : persem_ros.settings.config.Config
    intake : persem_ros.inputs.live.LiveIntake
        Gets its cameras and their pose buffers here.
    inbox : persem_ros.ros.inbox.Inbox
        Where messages go.

    """

    def __init__(self, node, config, intake, inbox):
        """Subscribe to whatever needs no look at the graph."""
        self._node, self._config, self._inbox = node, config, inbox
        self._buffers = {}
        self._infos = {}
        self.all = []
        for camera in [name for name in config.cameras if name] or ['']:
            self._add_camera(topics_of(config, camera), camera, intake)
        statics = self._add(TF_STATIC, '/tf_static', list(self._buffers.values()),
                            [('/tf_static', TFMessage)], [_profile('latched', 1000)])
        self._subscribe(statics, 0)
        for one in self.all:
            if len(one.choices) == 1 or one.role in (LABELS, DEPTH):
                self._subscribe(one, 0)
        self.resolve()

    @property
    def settled(self):
        """Whether every topic has a publisher of a type that was subscribed to."""
        return all(one.chosen is not None and self.publishers(one) for one in self.all
                   if one.role not in (COLOR, TF_STATIC))

    def resolve(self):
        """Follow the graph: take the first of an input's choices that somebody publishes."""
        for one in self.all:
            if one.role == COLOR and not one.subscriptions:
                continue
            if one.role == INFO:
                self._listen_to_the_past(one)
            if len(one.choices) == 1 or one.chosen is not None and self.publishers(one):
                continue
            for number in range(len(one.choices)):
                if number != one.chosen and self._published(*one.choices[number]):
                    self._subscribe(one, number)
                    break

    def want_color(self, wanted):
        """Subscribe to colour images, or no longer: only the overlay needs them."""
        for one in self.all:
            if one.role == COLOR and wanted and not one.subscriptions:
                self._subscribe(one, 0)
            elif one.role == COLOR and not wanted:
                self._unsubscribe(one)

    def publishers(self, one):
        """Return the endpoints that publish what an input listens to."""
        return [] if one.chosen is None else self._published(*one.choices[one.chosen])

    def verdict(self, one):
        """Return what stands between an input and its publishers, '' for nothing."""
        topic, cls = one.choices[one.chosen or 0]
        everybody = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        if not everybody:
            return 'no publisher'
        fitting = self.publishers(one)
        if not fitting:
            return f'published as {everybody[0].topic_type}'
        reasons = [qos_check_compatible(end.qos_profile, one.profiles[0]) for end in fitting]
        if all(verdict == QoSCompatibility.ERROR for verdict, _ in reasons):
            return f'QoS does not fit ({reasons[0][1].strip("; ")}); see qos.{one.role}'
        return ''

    def _add_camera(self, topics, camera, intake):
        qos, pose = self._config.qos, self._config.pose
        name = topics.pose if pose.source == 'topic' else '/tf'
        if name not in self._buffers:
            buffer = self._buffers[name] = PoseBuffer(self._config)
            if pose.source == 'tf':
                self._add(TF, name, [buffer], [(name, TFMessage)], [self._small(qos.pose)])
            else:
                kinds = [POSES[pose.type]] if pose.type in POSES else list(POSES.values())
                self._add(POSE, name, [buffer], [(name, kind) for kind in kinds],
                          [self._small(qos.pose)])
        station = intake.add_camera(camera, self._buffers[name], (COLOR,))
        for role in (LABELS, DEPTH, COLOR):
            name = getattr(topics, role)
            self._add(role, name, [station], _images(role, name),
                      [_profile(getattr(qos, role), qos.queue)])
        profiles = [self._small(qos.camera_info)]
        if topics.camera_info in self._infos:
            self._infos[topics.camera_info].takers.append(station)
        else:
            self._infos[topics.camera_info] = self._add(
                INFO, topics.camera_info, [station], [(topics.camera_info, CameraInfo)], profiles)

    def _small(self, setting):
        return _profile(setting, SMALL_FACTOR * self._config.qos.queue)

    def _add(self, *arguments):
        self.all.append(Input(*arguments))
        return self.all[-1]

    def _published(self, topic, cls):
        """Return the publishers of a topic with the type of *cls*."""
        return [end for end in self._node.get_publishers_info_by_topic(
            self._node.resolve_topic_name(topic)) if end.topic_type == type_name(cls)]

    def _subscribe(self, one, number):
        """Listen to an input's choice *number* instead of what it listened to before."""
        if one.chosen == number and one.subscriptions:
            return
        self._unsubscribe(one)
        topic, cls = one.choices[number]
        received = partial(self._received, one, type_name(cls))
        # Serialized messages: they are decoded once, by the worker, with the replay's own code,
        # and damaged ones do not reach the middleware's.
        one.subscriptions = [self._node.create_subscription(cls, topic, received, profile,
                                                            raw=True)
                             for profile in one.profiles]
        one.chosen = number

    def _listen_to_the_past(self, one):
        """
        Subscribe once more to an input that somebody publishes latched.

        A volatile subscription misses what was latched before it, a latched one does not match
        a volatile publisher: only both hear everybody.

        """
        if len(one.subscriptions) == 1 and self._config.qos.camera_info != 'latched' and any(
                end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for end in self.publishers(one)):
            topic, cls = one.choices[one.chosen]
            received = partial(self._received, one, type_name(cls))
            one.subscriptions.append(self._node.create_subscription(
                cls, topic, received, self._small('latched'), raw=True))

    def _unsubscribe(self, one):
        for subscription in one.subscriptions:
            self._node.destroy_subscription(subscription)
        one.subscriptions = []

    def _received(self, one, kind, data):
        one.note(data)
        self._inbox.put(Item(time.monotonic_ns(), one, kind, data))


def type_name(cls):
    """Return the name of a message class: 'sensor_msgs/msg/Image'."""
    return f'{cls.__module__.partition(".")[0]}/msg/{cls.__name__}'


def check_topics(config):
    """Refuse settings that would give two kinds of messages one topic."""
    for camera in [name for name in config.cameras if name] or ['']:
        topics = topics_of(config, camera)
        if topics.labels == topics.depth:
            raise PersemError(f'topics.labels and topics.depth are both {topics.depth!r}; '
                              'expected two topics')


def _images(role, name):
    """Return the choices of an image topic; the transports are those of image_transport."""
    choices = [(name, Image), (name, CompressedImage), (f'{name}/compressed', CompressedImage)]
    if role == DEPTH:
        choices.insert(2, (f'{name}/compressedDepth', CompressedImage))
    return choices


def _profile(setting, depth):
    """Return the QoSProfile of a qos.* setting."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if setting in ('auto', 'best_effort')
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if setting == 'latched'
        else DurabilityPolicy.VOLATILE)
