"""How an input is subscribed to: as reliably as its publishers offer, and what they latched."""

from __future__ import annotations

from functools import partial
import time
from typing import Any, TYPE_CHECKING

from persem_ros.ros.inbox import Item
from persem_ros.ros.topic import Input, MessageClass, TF_STATIC, type_name
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy)

if TYPE_CHECKING:
    from persem_ros.ros.inbox import Inbox
    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rclpy.topic_endpoint_info import TopicEndpointInfo


class Subscriber:
    """
    Subscribes a node to inputs; messages only queue.

    Parameters
    ----------
    node : rclpy.node.Node
    inbox : Inbox
        Where messages go.

    """

    def __init__(self, node: Node, inbox: Inbox) -> None:
        """Subscribe to nothing yet."""
        self._node, self._inbox = node, inbox

    def published(self, topic: str, cls: MessageClass) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic with the type of *cls*."""
        return [end for end in self._node.get_publishers_info_by_topic(topic)
                if end.topic_type == type_name(cls)]

    def publishers(self, one: Input) -> list[TopicEndpointInfo]:
        """Return the endpoints that publish what an input listens to."""
        return [] if one.chosen is None else self.published(*one.choices[one.chosen])

    def subscribe(self, one: Input, number: int) -> None:
        """
        Listen to an input's choice *number*, in the way that fits its publishers.

        /tf_static is published latched by those who know it and volatile by a player of a
        recording without QoS, once for all: both are listened to from the start.

        """
        reliability = self._reliability(one, number)
        if one.subscriptions and (number, reliability) == (one.chosen, one.reliability):
            return
        self.unsubscribe(one)
        one.chosen, one.reliability = number, reliability
        one.subscriptions = [self._subscription(one, reliability)]
        if one.role == TF_STATIC:
            one.subscriptions.append(self._subscription(one, 'latched'))

    def _reliability(self, one: Input, number: int) -> str:
        """Return how to subscribe to an input's choice *number*, as rosbag2 decides."""
        if one.setting != 'auto':
            return one.setting
        ends = self.published(*one.choices[number])
        if not ends:        # they went away; the next may be like them
            return one.reliability or ('reliable' if one.role == TF_STATIC else 'best_effort')
        reliable = all(end.qos_profile.reliability == ReliabilityPolicy.RELIABLE for end in ends)
        return 'reliable' if reliable else 'best_effort'

    def _subscription(self, one: Input, reliability: str) -> Subscription:
        """
        Return a subscription that hands out serialized messages.

        They are decoded once, by the worker, with the replay's own code, and damaged ones do not
        reach the middleware's.

        """
        assert one.chosen is not None       # subscribe() sets it before
        topic, cls = one.choices[one.chosen]
        latched = reliability == 'latched'
        received = partial(self._received, one, type_name(cls), latched)
        profile = _profile(reliability, one.depth)
        create = partial(self._node.create_subscription, cls, topic, received, profile, raw=True)
        if one.is_image:
            try:
                return create(event_callbacks=SubscriptionEventCallbacks(
                    message_lost=partial(_lost, one)))
            except UnsupportedEventTypeError:
                pass
        if one.role == TF_STATIC or latched and one.setting != 'latched':
            # Whom it does not match the subscription beside it hears: rclpy need not warn.
            return create(event_callbacks=SubscriptionEventCallbacks(incompatible_qos=_heard))
        return create()

    def listen_to_the_past(self, one: Input) -> None:
        """
        Subscribe once more to an input that somebody publishes latched.

        A volatile subscription misses what was latched before it, a latched one does not match
        a volatile publisher: only both hear everybody.

        """
        if len(one.subscriptions) == 1 and one.reliability != 'latched' and any(
                end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for end in self.publishers(one)):
            one.subscriptions.append(self._subscription(one, 'latched'))

    def unsubscribe(self, one: Input) -> None:
        """Listen to an input no longer."""
        for subscription in one.subscriptions:
            self._node.destroy_subscription(subscription)
        one.subscriptions, one.chosen, one.reliability = [], None, ''

    def _received(self, one: Input, kind: str, latched: bool, data: bytes) -> None:
        one.note(data, latched)
        self._inbox.put(Item(time.monotonic_ns(), one, kind, data))


def misfit(one: Input, publishers: list[TopicEndpointInfo]) -> str:
    """Return why an input's subscription hears none of its publishers, '' where it hears one."""
    profile = _profile(one.reliability, one.depth)
    reasons = [qos_check_compatible(end.qos_profile, profile) for end in publishers]
    if all(verdict == QoSCompatibility.ERROR for verdict, _ in reasons):
        return f'QoS does not fit ({reasons[0][1].strip("; ")}); see qos.{one.role}'
    return ''


def volatile(ends: list[TopicEndpointInfo]) -> list[str]:
    """Return the nodes of those publishers that keep nothing for who listens later."""
    return sorted({end.node_name for end in ends
                   if end.qos_profile.durability == DurabilityPolicy.VOLATILE})


def _heard(event: Any) -> None:
    """Do nothing about publishers that a subscription does not match but another does."""


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
