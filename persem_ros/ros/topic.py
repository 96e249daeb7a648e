"""One topic that the node listens to: where it is, how it was subscribed, what came of it."""

from __future__ import annotations

import time
from typing import Any, TYPE_CHECKING

from persem_ros.inputs.decode import px4
from persem_ros.inputs.decode.messages import BadMessage, header
from persem_ros.inputs.intake import LEGEND, ORDER, TF

if TYPE_CHECKING:
    from persem_ros.inputs.intake import Taker
    from rclpy.subscription import Subscription

MessageClass = Any      # one that rosidl has generated: these share no base
TF_STATIC = 'tf_static'


class Input:
    """
    One topic that is listened to.

    Parameters
    ----------
    role : str
        A kind of images (inputs.intake.ORDER), 'camera_info', 'labels_info', 'legend', 'pose',
        'tf', 'tf_static' or 'trajectory'.
    name : str
        The topic as the settings name it, relative.
    topic : str
        The same after namespace and remapping.
    takers : list
        Stations or pose buffers that its messages are for.
    choices : list of (str, message class)
        What may be there: (topic, type), the preferred one first.
    setting : str
        Its qos.* setting: 'auto', 'best_effort', 'reliable' or 'latched'.
    depth : int
        Messages that the middleware keeps.

    Attributes
    ----------
    chosen : int or None
        Which of the choices it listens to.
    reliability : str
        'best_effort', 'reliable' or 'latched': what was subscribed with, '' for nothing.
    count : int
        Messages that came.
    fresh : int
        Those among them that came by a subscription that hears nothing of the past.
    came : float or None
        When the last one came, time.monotonic().
    lost : int
        Messages that the middleware says it has lost.

    """

    def __init__(self, role: str, name: str, topic: str, takers: list[Taker],
                 choices: list[tuple[str, MessageClass]], setting: str, depth: int) -> None:
        """Keep what belongs together; nothing is subscribed yet."""
        self.role, self.name, self.topic, self.takers = role, name, topic, takers
        self.choices, self.setting, self.depth = choices, setting, depth
        self.is_image = role in ORDER
        self.chosen: int | None = None
        self.reliability = ''
        self.subscriptions: list[Subscription] = []
        self.count = self.fresh = self.lost = 0
        self.came: float | None = None
        self._last = b''

    @property
    def stamp(self) -> int | None:
        """Stamp of the last message in ns, None where there is none."""
        return self.stamp_of(self._last)

    @property
    def listened(self) -> str:
        """Return the topic that it listens to, after remapping."""
        return self.choices[self.chosen][0] if self.chosen else self.topic

    def stamp_of(self, data: bytes) -> int | None:
        """Return the stamp of one of its messages in ns, None where it cannot be read."""
        if self.role == LEGEND:
            return None
        if self.chosen is not None and type_name(self.choices[self.chosen][1]) == px4.TYPE:
            return px4.stamp_of(data)
        if self.role in (TF, TF_STATIC):        # a sequence, whose first item has the header
            data = data[:4] + data[8:]
        try:
            return header(data)[0]
        except BadMessage:
            return None

    def note(self, data: bytes, latched: bool = False) -> None:
        """Count a message; *latched*: it came by a subscription that hears the past, too."""
        self.count += 1
        self.fresh += not latched
        self.came = time.monotonic()
        self._last = data[:512]     # an image is not kept alive for its stamp


def type_name(cls: MessageClass) -> str:
    """Return the name of a message class: 'sensor_msgs/msg/Image'."""
    return f'{cls.__module__.partition(".")[0]}/msg/{cls.__name__}'
