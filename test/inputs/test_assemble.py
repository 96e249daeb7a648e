"""Frames from the messages of one instant: the same live and from a recording."""

import bags
import numpy as np
from persem_ros.inputs.assemble import Assembler, resampled
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.sync.match import COLOR, DEPTH, LABELS, Match, TRUTH
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, updated
import pytest
from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageFactory(STORE.types)
AT = bags.stamp(3)


def parts():
    """Return the messages of one instant by kind, and the camera info."""
    color = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
    return {LABELS: MAKE.image(AT, 'camera', bags.labels(3), 'mono16'),
            DEPTH: MAKE.image(AT, 'depth_camera', bags.depth(3), '32FC1'),
            TRUTH: MAKE.image(AT, 'camera', bags.labels(4), '16UC1'),
            COLOR: MAKE.image(AT, 'camera', color, 'bgr8')}, \
        MAKE.camera_info(AT, 'camera', 16, 12, bags.K, (0.1, -0.05, 0.0, 0.0, 0.0))


def recorded(msg):
    """Return a message as it comes out of a recording."""
    return STORE.deserialize_cdr(bytes(STORE.serialize_cdr(msg, msg.__msgtype__)),
                                 msg.__msgtype__)


def frame(form):
    messages, info = parts()
    assembler = Assembler(sensor='front')
    assembler.add_info(form(info))
    match = Match(AT, {}, bags.pose(3))
    return assembler.frame(match, {kind: form(msg) for kind, msg in messages.items()})


def test_live_messages_and_recorded_ones_give_the_same_frame():
    (live, faults), (replayed, other) = frame(bags.live), frame(recorded)
    assert faults == other == []
    for name in ('labels', 'depth', 'truth', 'color', 'T_map_camera'):
        a, b = getattr(live, name), getattr(replayed, name)
        assert a.dtype == b.dtype and a.tobytes() == b.tobytes(), name
    assert live.camera.rays.tobytes() == replayed.camera.rays.tobytes()
    assert (live.stamp, live.sensor, live.frame_id, live.encoding) == \
        (replayed.stamp, replayed.sensor, replayed.frame_id, replayed.encoding) == \
        (AT, 'front', 'camera', 'mono16')
    assert live.camera.frame_id == 'depth_camera'


def test_without_a_camera_info_there_is_no_frame():
    messages, _ = parts()
    with pytest.raises(BadMessage) as caught:
        Assembler().frame(Match(AT, {}), messages)
    assert caught.value.reason == 'no camera info'


def test_the_info_in_force_at_the_stamp_is_used():
    messages, _ = parts()
    assembler = Assembler()
    for i, factor in ((0, 1.0), (2, 2.0), (5, 3.0)):
        assembler.add_info(MAKE.camera_info(bags.stamp(i), 'camera', 16, 12,
                                            bags.K * [[factor], [factor], [1]]))
    found, _ = assembler.frame(Match(AT, {}, bags.pose(3)), messages)
    assert found.camera.K[0, 0] == 40.0


def test_depth_along_the_ray_becomes_z_and_other_units_metres():
    messages, info = parts()
    settings = {'depth.kind': 'ray', 'depth.scale': 0.5}
    assembler = Assembler(updated(Config(), settings))
    assembler.add_info(info)
    found, _ = assembler.frame(Match(AT, {}, bags.pose(3)), messages)
    points = np.dstack([found.camera.rays, np.ones((12, 16))]) * found.depth[..., None]
    np.testing.assert_allclose(np.linalg.norm(points, axis=2),
                               bags.depth(3).astype(float) / 2, rtol=1e-12)


def test_resampling_takes_the_pixel_below_the_centre():
    grid = np.arange(6).reshape(2, 3)
    assert resampled(grid, (2, 3)) is grid
    np.testing.assert_array_equal(resampled(grid, (4, 6)), grid.repeat(2, 0).repeat(2, 1))
    np.testing.assert_array_equal(resampled(np.arange(36).reshape(6, 6), (2, 2)),
                                  [[7, 10], [25, 28]])
