"""The inputs of a node: subscribed as the graph has them, and what each of them lacks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from persem_ros.inputs.intake import INFO, LABELS_INFO, LEGEND, TF, TRAJECTORY
from persem_ros.inputs.sync.match import COLOR, DEPTH, LABELS
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.ros.input_list import InputList
from persem_ros.ros.messages import INSTALL
from persem_ros.ros.subscriber import misfit, Subscriber, volatile
from persem_ros.ros.topic import Input, TF_STATIC, type_name

if TYPE_CHECKING:
    from persem_ros.inputs.live import LiveIntake
    from persem_ros.ros.inbox import Inbox
    from persem_ros.settings.config import Config
    from rclpy.node import Node
    from rclpy.topic_endpoint_info import TopicEndpointInfo

OPTIONAL = (COLOR, TF_STATIC, LABELS_INFO, LEGEND, TRAJECTORY)     # nobody need publish them
SHOWN = 4               # topics in a sentence


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
        self._node, self._config = node, config
        self._colored = False
        self._subscriber = Subscriber(node, inbox)
        listed = InputList(node, config, intake)
        self.all, self.stations = listed.all, listed.stations       # stations: by camera
        self._buffers = listed.buffers
        self._unheard = '', 0       # see _look_for_unheard: nodes, messages when they were seen
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
                # Hundreds of messages a second that nobody needs.
                self._subscriber.unsubscribe(one)
                continue
            number = one.chosen
            if number is None or not self.publishers(one):
                number = next((n for n in range(len(one.choices))
                               if self._subscriber.published(*one.choices[n])), one.chosen)
            if number is None and (one.role == TF_STATIC or one.setting != 'auto' and (
                    len(one.choices) == 1 or one.role in (LABELS, DEPTH))):
                number = 0
            if number is not None:
                self._subscriber.subscribe(one, number)
            if one.role in (INFO, LABELS_INFO, LEGEND, TRAJECTORY):
                self._subscriber.listen_to_the_past(one)
            elif one.role == TF_STATIC:
                self._look_for_unheard(one)

    def want_color(self, wanted: bool) -> None:
        """Subscribe to colour images, or no longer: only the overlay needs them."""
        self._colored = wanted
        for one in self.all:
            if one.role == COLOR and not wanted:
                self._subscriber.unsubscribe(one)

    def _look_for_unheard(self, one: Input) -> None:
        """Tell pose buffers who publishes /tf_static once for all and was not heard."""
        silent = one.subscriptions and not one.fresh and volatile(self.publishers(one))
        if silent:
            self._unheard = ', '.join(silent), one.count
        elif one.fresh or one.count > self._unheard[1]:     # else they left without a word
            self._unheard = '', 0
        for taker in one.takers:
            if isinstance(taker, PoseBuffer):
                taker.unheard = self._unheard[0]

    def publishers(self, one: Input) -> list[TopicEndpointInfo]:
        """Return the endpoints that publish what an input listens to."""
        return self._subscriber.publishers(one)

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
        return misfit(one, fitting)

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
