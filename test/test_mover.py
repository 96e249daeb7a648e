"""A map that moves beside the mapping of a node, without ROS: nothing is lost on the way."""

from dataclasses import fields, is_dataclass, replace
import logging
import time

import core_worlds as cw
import numpy as np
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.move import corrected, correction_of, moved
from persem_ros.core.refine.whole import refine
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.sync.jump import jumped
from persem_ros.inputs.sync.poses import PoseBuffer
from persem_ros.inputs.trajectory import from_path, PATH
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.ros.jumps import Jumps
from persem_ros.ros.mover import check_moves, Mover
from persem_ros.settings.config import Config, updated
import pytest
from rosbags.typesys import get_typestore, Stores

CONFIG = updated(Config(), {'topics.trajectory': 'slam/path', 'trajectory.period': 0.1})
STORE = get_typestore(Stores.ROS2_JAZZY)
SECOND = 10 ** 9


def plain(memory):
    """Return what a memory or a dump knows as comparable values."""
    saved = memory if is_dataclass(memory) else dump(memory)
    values = {f.name: getattr(saved, f.name) for f in fields(saved) if f.name != 'frames'}
    values['frames'] = [(f.t, f.session, f.sensor, f.stamp, f.T_map_sensor.tolist(),
                         f.T_map_best.tolist()) for f in saved.frames]
    values['sessions'] = {n: one.uuid for n, one in saved.frames.sessions.items()}
    return {name: value.tobytes() if isinstance(value, np.ndarray) else value
            for name, value in values.items()}


def shift(x):
    """Return the transform that shifts by x metres."""
    return transform((x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def frame(k):
    """Return the observations of a frame a second, ten voxels on."""
    rng = np.random.default_rng(k)
    seen = {(10 * k + x, y, 0): (int(rng.integers(3)), 0.75) for x in range(20) for y in range(5)}
    return replace(cw.observations(k * SECOND, seen), offsets=rng.integers(
        0, 256, (len(seen), 3)).astype(np.uint8))


def path(poses, frame_id='map'):
    """Return a serialized nav_msgs/Path of {second: x}."""
    make = MessageFactory(STORE.types)
    msg = make.path(0, frame_id, [(round(t * SECOND), shift(x)) for t, x in poses.items()])
    return bytes(STORE.serialize_cdr(msg, PATH))


def mapped(count):
    """Return a memory of some frames."""
    memory = cw.core_of([])
    for k in range(count):
        memory.add(frame(k))
    return memory


def until_moved(mover, memory, frames=(), config=CONFIG):
    """Step until the map has moved or nothing is under way; frames come in between."""
    frames, end = list(frames), time.monotonic() + 60
    begun = False
    while time.monotonic() < end:
        new = mover.step(memory, config)
        if new is not None:
            return new, frames
        if mover.busy and frames:
            memory.add(frames[0])
            mover.note(frames.pop(0))
        begun |= mover.busy
        if begun and not mover.busy:
            return None, frames
        time.sleep(0.01)
    raise AssertionError('the map did not move')


@pytest.fixture
def mover(monkeypatch):
    """Give a Mover, which lets go of a map at once."""
    monkeypatch.setattr('persem_ros.ros.mover.KEPT', 0.0)
    one = Mover(Decoder(), lambda: None)
    yield one
    one.close()


def test_frames_that_come_meanwhile_move_with_the_rest(mover):
    memory, slam = mapped(6), path({0: 0.0, 3: 0.7, 5: 1.1})
    mover.take(slam)
    new, left = until_moved(mover, memory, map(frame, range(6, 12)))
    count = 12 - len(left)
    assert count > 6 and len(new.frames) == len(memory.frames) == count
    # The map that all these frames give, moved at once.
    saved = dump(mapped(count))
    K = correction_of(dump(mapped(6)).frames, 0, from_path(Decoder()(slam, PATH), 'map', ''))
    rows = saved.frames.session == 0
    wanted = moved(saved, corrected(saved.frames, 0, K), rows)
    kept = [name for name in plain(wanted) if name.startswith(('history', 'evidence', 'block'))]
    for name in (*kept, 'cell', 'starts', 'changes', 'seen_ids', 'frames', 'sessions'):
        assert plain(new)[name] == plain(wanted)[name], name
    assert mover.moves == 1 and new.rho is None and new.clock > 0
    refine(new, CONFIG.refine)
    new.add(frame(20))          # and it goes on, in the same session
    assert new.frames.session.tolist() == [0] * (count + 1)


def test_a_path_that_says_nothing_new_moves_nothing(mover):
    memory = mapped(4)
    mover.take(path({0: 0.5, 3: 0.5}))
    memory, _ = until_moved(mover, memory)
    time.sleep(0.11)
    mover.take(path({0: 0.5, 2: 0.5, 3: 0.5}))
    assert until_moved(mover, memory) == (None, [])
    assert mover.moves == 1


@pytest.mark.parametrize('poses, frame_id, said', [
    ({0: 1.0, 3: 1.0}, 'odom', "the path is in the frame 'odom'"),
    ({3: 1.0, 1: 1.0}, 'map', 'is not later than the one before'),
    ({1: 1.0, 2: np.nan}, 'map', 'a pose that is not finite'),
    ({100: 1.0, 101: 1.0}, 'map', '0 of 2 poses lie within session 0'), ({}, 'map', 'no poses')])
def test_paths_that_are_refused_are_said_once(mover, caplog, poses, frame_id, said):
    memory = mapped(4)
    before = plain(memory)
    for _ in range(2):
        mover.take(path(poses, frame_id))
        assert until_moved(mover, memory) == (None, [])
        time.sleep(0.11)
    assert plain(memory) == before
    assert [said in r.message for r in caplog.records] == [True]
    assert caplog.records[0].message.endswith('the map stays as it is')


def test_a_map_that_has_let_go_of_observations(mover, caplog):
    memory = cw.core_of([], max_history=6)
    for k in range(20):
        memory.add(replace(frame(0), stamp=k * SECOND))
    mover.take(path({0: 1.0, 19: 1.0}))
    assert until_moved(mover, memory) == (None, [])
    assert 'has let go of observations' in caplog.text and not memory.read_beside
    check_moves(updated(CONFIG, {'memory.keep_radius': 50.0}), memory)
    assert 'cannot be moved' in caplog.text and 'any more' in caplog.text
    with pytest.raises(PersemError, match='needs the whole map in memory'):
        check_moves(updated(CONFIG, {'map.attached': True}), None)


def test_damaged_bytes_and_another_session(mover, caplog):
    memory = mapped(4)
    mover.take(path({0: 1.0, 3: 1.0})[:40])
    assert until_moved(mover, memory) == (None, [])
    assert 'slam/path: a nav_msgs/msg/Path cannot be deserialized' in caplog.text
    time.sleep(0.11)
    mover.take(path({0: 1.0, 3: 1.0}))
    mover.step(memory, CONFIG)
    memory.new_session()
    assert mover.step(memory, CONFIG) is None and not mover.busy
    assert 'the session it is of has ended' in caplog.text


def test_a_localisation_that_corrects_itself(caplog):
    buffer, jumps = PoseBuffer(Config()), Jumps(Config())
    for k, (y, x) in enumerate(((0.0, 0.0), (0.01, 5.0), (0.02, 10.0))):
        buffer.add_tf(k * SECOND, transform((0, y, 0), (0, 0, 0, 1.0)), 'map', 'odom')
        buffer.add_tf(k * SECOND, transform((x, 0, 0), (0, 0, 0, 1.0)), 'odom', 'base_link')
        assert jumped(buffer, 0.5) == ''     # odometry moves, and is no correction
    buffer.add_tf(3 * SECOND, transform((0, 1.5, 0), (0, 0, 0, 1.0)), 'map', 'odom')
    assert jumped(buffer, 0.5).startswith('map -> odom on /tf jumped by 1.48 m')
    for _ in range(2):
        jumps.look([buffer], Config())
    assert caplog.text.count('topics.trajectory takes the corrected path') == 1
    caplog.clear()
    Jumps(CONFIG).look([buffer], CONFIG)    # the map moves with it
    assert not caplog.text
    one = PoseBuffer(Config())              # a localisation that places the body itself
    for k in range(2):
        one.add_tf(k * SECOND, transform((9.0 * k, 0, 0), (0, 0, 0, 1.0)), 'map', 'base_link')
    assert jumped(one, 0.5) == ''


def test_the_log_says_how_far(mover, caplog):
    caplog.set_level(logging.INFO)
    mover.take(path({0: 0.5, 3: 1.0}))
    until_moved(mover, mapped(4))
    assert 'the map moved with slam/path: 4 frames, by up to 1 m, in ' in caplog.text
