"""The stamp in the first bytes of a serialized message: what sorts messages, unread."""

from __future__ import annotations

import functools
import struct
from typing import Any

from persem_ros.inputs.decode import px4
from rosbags.typesys import get_typestore, Stores

TF = 'tf2_msgs/msg/TFMessage'
HEADER = 'std_msgs/msg/Header'
HEAD = 64               # bytes of a message that are enough for its stamp
FIRST, IN_TF = 4, 8     # where a header begins: behind the encapsulation; behind a length, too


@functools.cache
def offset(msgtype: str) -> int | None:
    """Return where the header begins in messages of a type; None for types without one."""
    if msgtype == TF:
        return IN_TF
    _, fields = _types().get(msgtype, ([], []))
    return FIRST if fields and fields[0][1][1] == HEADER else None


def stamp_of(msgtype: str, head: bytes) -> int | None:
    """
    Return the header stamp of a message in nanoseconds.

    Parameters
    ----------
    msgtype : str
        'sensor_msgs/msg/Image'. Of a TFMessage the first transform's stamp counts.
    head : bytes
        The first bytes of the serialized message.

    Returns
    -------
    int or None
        None for a type without a header, an empty TFMessage and a message that ends before.

    """
    if msgtype == px4.TYPE:
        return px4.stamp_of(head)
    at = offset(msgtype)
    if at is None or len(head) < at + 8:
        return None
    order = '<' if head[1] & 1 else '>'
    if at == IN_TF and head[4:8] == bytes(4):
        return None
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', head, at)
    return seconds * 1_000_000_000 + nanoseconds


@functools.cache
def _types() -> Any:
    return get_typestore(Stores.ROS2_JAZZY).fielddefs
