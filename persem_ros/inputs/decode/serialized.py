"""Serialized messages to objects, without ROS."""

from __future__ import annotations

import functools
from typing import Any

from persem_ros.inputs.decode import px4
from persem_ros.inputs.decode.messages import BadMessage
from rosbags.serde import SerdeError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

# Of vision_msgs, which not every installation of ROS has.
VISION = {
    'vision_msgs/msg/VisionClass': 'uint16 class_id\nstring class_name\n',
    'vision_msgs/msg/LabelInfo':
        'std_msgs/Header header\nvision_msgs/VisionClass[] class_map\nfloat32 threshold\n'}


class Decoder:
    """Deserializes messages of ROS 2 Jazzy's own types."""

    def __init__(self) -> None:
        """Load the types, the first time."""
        self._store = _types()

    def __call__(self, data: bytes | memoryview, typename: str) -> Any:
        """Return the message; BadMessage where its bytes are damaged."""
        try:
            if typename == px4.TYPE:
                return px4.decoded(data)
            return self._store.deserialize_cdr(data, typename)
        # Damaged bytes: lengths that lead out of them, text that is none.
        except (SerdeError, LookupError, OverflowError, AssertionError, ValueError) as error:
            raise BadMessage('damaged message', f'a {typename} cannot be deserialized: '
                             f'{" ".join(str(error).split()) or type(error).__name__}') from None


@functools.cache
def _types() -> Any:
    """Return the types, once a process: it compiles what it meets, some 50 ms in all."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register({name: types for kind, text in VISION.items()
                    for name, types in get_types_from_msg(text, kind).items()})
    return store
