"""
What all messages share: stamps, frames, faults; of rclpy and of rosbags alike.

rclpy hands out array.array, rosbags read-only ndarrays: image_messages, pose_messages and the
others in this room go by attributes and np.frombuffer, which takes both.

"""

from __future__ import annotations

from typing import Any, Literal

from persem_ros.errors import PersemError


class BadMessage(PersemError):
    """
    A message that cannot be used, while others of its topic may.

    Attributes
    ----------
    reason : str
        A few words, the same for every message with this fault: the key of a drop count.

    """

    def __init__(self, reason: str, sentence: str) -> None:
        """Keep the short *reason* beside the whole *sentence*."""
        super().__init__(sentence)
        self.reason = reason


def stamp_ns(msg: Any) -> int:
    """Return the header stamp in integer nanoseconds."""
    return msg.header.stamp.sec * 1_000_000_000 + msg.header.stamp.nanosec


def frame_id(msg: Any) -> str:
    """Return the header's frame without the leading slash that ROS 1 wrote."""
    return msg.header.frame_id.lstrip('/')


def header(data: bytes) -> tuple[int, str]:
    """
    Return (stamp in ns, frame_id) of a serialized message that begins with a std_msgs/Header.

    Reading the header alone costs microseconds, where decoding a whole image costs a copy.

    """
    order: Literal['little', 'big'] = 'little' if data[1:2] == b'\x01' else 'big'
    seconds = int.from_bytes(data[4:8], order, signed=True)
    nanoseconds = int.from_bytes(data[8:12], order)
    length = int.from_bytes(data[12:16], order)
    text = bytes(data[16:16 + length])
    if len(data) < 16 or len(text) < length:
        raise BadMessage('damaged message', 'a message ends inside of its header')
    name = text.rstrip(b'\0').decode(errors='replace').lstrip('/')
    return seconds * 1_000_000_000 + nanoseconds, name
