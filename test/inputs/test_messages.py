"""What all messages share: the header, read without the rest."""

from message_forms import MAKE, STAMP, STORE
import numpy as np
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.messages import BadMessage
import pytest


@pytest.mark.parametrize('at', [0, 999_999_999, STAMP, -5_000_000_001])
def test_the_header_is_read_without_the_rest(at):
    msg = MAKE.image(at, '/camera', np.zeros((2, 2), 'u1'), 'mono8')
    data = bytes(STORE.serialize_cdr(msg, 'sensor_msgs/msg/Image'))
    assert messages.header(data) == (at, 'camera')
    assert messages.stamp_ns(msg) == at
    big = bytes(STORE.serialize_cdr(msg, 'sensor_msgs/msg/Image', little_endian=False))
    assert messages.header(big) == (at, 'camera')
    for length in (0, 3, 10, 18):
        with pytest.raises(BadMessage):
            messages.header(data[:length])
