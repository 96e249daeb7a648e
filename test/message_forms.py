"""What tests of messages are made by."""

from persem_ros.outputs.recording.messages import MessageFactory
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageFactory(STORE.types)
STAMP = 1_700_000_000_123_456_789
