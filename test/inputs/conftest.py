"""What tests of inputs share: messages in the forms of rosbags and of rclpy."""

import bags
from message_forms import STORE
import pytest


@pytest.fixture(params=['rosbags', 'rclpy'])
def form(request):
    """Return what turns a message into one of rosbags (read-only) or of rclpy (array.array)."""
    def through_cdr(msg):
        kind = msg.__msgtype__
        return STORE.deserialize_cdr(bytes(STORE.serialize_cdr(msg, kind)), kind)
    return through_cdr if request.param == 'rosbags' else bags.live
