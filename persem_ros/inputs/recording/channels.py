"""The noun channel: messages of one topic and type in one file."""

from typing import NamedTuple


class Channel(NamedTuple):
    """
    A topic as one file has it; a file may have several of one topic.

    Attributes
    ----------
    number : int
        The file's own.
    topic, msgtype : str
        '/depth/image', 'sensor_msgs/msg/Image'.
    count : int
        Its messages.
    encoding : str
        Of the messages: 'cdr' in ROS 2; 'ros1', 'protobuf', 'json' … elsewhere.
    schema : str
        Form of the type's definition: 'ros2msg', 'ros1msg', 'protobuf' …; '' where unknown.

    """

    number: int
    topic: str
    msgtype: str
    count: int      # type: ignore[assignment]  # hides tuple.count, which nobody asks for
    encoding: str
    schema: str = ''
