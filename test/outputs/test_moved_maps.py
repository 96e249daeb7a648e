"""persem map move and merge --transform: what moves, what stays, what is refused."""

import re

import core_worlds as cw
import numpy as np
from persem_ros.cli import main
from persem_ros.core.frame.sessions import fingerprint
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.refine.whole import refine
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.trajectory import from_path, from_tum
from persem_ros.outputs.map import store
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, updated
import pytest
from rosbags.typesys import get_typestore, Stores
from test_store import plain

CONFIG = updated(Config(), {'refine.min_observations': 1})
SECOND = 10 ** 9


def frames(first, count=5, at=0):
    """Return a frame a second, each of ten voxels and one of its own."""
    return [(SECOND * (first + k), {**{(at + x, 0, 0): (x % 3, 0.75) for x in range(10)},
                                    (at, 5, k): (1, 1.0)}, ()) for k in range(count)]


def saved(path, *sessions, max_history=0):
    """Save a map of some sessions, refined."""
    memory = cw.core_of([], max_history)
    for k, session in enumerate(sessions):
        if k:
            memory.new_session()
        for frame in session:
            memory.add(cw.observations(*frame))
    refine(memory, CONFIG.refine)
    store.save(path, memory, CONFIG)
    return store.load(path)


def tum(path, *rows):
    """Write a trajectory of rows (stamp, x)."""
    path.write_text('# timestamp tx ty tz qx qy qz qw\n' + ''.join(
        f'{t} {x} 0 0 0 0 0 1\n' for t, x in rows))
    return str(path)


def histories(memory):
    """Return all that a memory knows but poses, and names of sessions that come of them."""
    return {name: value for name, value in plain(memory).items()
            if name not in ('frames', 'sessions')}


def run(capsys, *words):
    """Return (status, standard output, standard error) of a command."""
    status = main([str(word) for word in words])
    return (status, *capsys.readouterr())


def test_one_session_moves_and_the_others_stay(tmp_path, capsys):
    path = tmp_path / 'map.persem'
    before = saved(path, frames(0), frames(100)).saved
    slam = tum(tmp_path / 'slam.tum', *((t, 0.5) for t in range(100, 105)))
    status, out, _ = run(capsys, 'map', 'move', path, '--trajectory', slam)
    assert (status, out) == (0, f'{path}: 5 of 5 frames of session 1 moved, by up to 0.5 m; 15 '
                                'voxels became 21, 110 observations 110\n')
    after = store.load(path)
    assert fingerprint(after.saved, 0) == fingerprint(before, 0)
    memory = after.memory()
    assert memory.history((0, 0, 0))[2].tolist() == [0, 1, 2, 3, 4]
    assert memory.history((1, 0, 0))[0].tolist() == [1] * 5 + [0] * 5
    assert memory.rho is not None and not memory.m.blocks['changed'][:memory.n_blocks].any()
    # What is moved is as if it had been mapped there.
    straight = saved(tmp_path / 'other', frames(0), frames(100, at=1)).memory()
    assert histories(memory) == histories(straight)


def test_back_again_is_the_map_of_before(tmp_path, capsys):
    path = tmp_path / 'map.persem'
    saved(path, frames(0))
    before = path.read_bytes()
    for x in (1.0, 0.0):
        slam = tum(tmp_path / 'slam.tum', *((t, x) for t in range(5)))
        assert run(capsys, 'map', 'move', path, '--trajectory', slam)[0] == 0
    assert path.read_bytes() == before


LINES = {
    'elsewhere': (['20 1 0 0 0 0 0 1'], 'no session of .* was flown .0: 0.000 to 4.000 s, 1:'),
    'hardly there': (['3 0 0 0 0 0 0 1', '50 0 0 0 0 0 0 1', '60 0 0 0 0 0 0 1'],
                     '1 of 3 poses lie within session 0, 0.000 s to 4.000 s'),
    'descending': (['2 0 0 0 0 0 0 1', '1 0 0 0 0 0 0 1'],
                   'line 2: the stamp 1.0+ s is not later than the one before'),
    'twice': (['2 0 0 0 0 0 0 1', '2 0 0 0 0 0 0 1'], 'expected stamps that ascend'),
    'NaN': (['2 nan 0 0 0 0 0 1'], r'line 1: a pose that is not finite \(nan 0'),
    'far': (['2 0 -1e300 0 0 0 0 1'], 'line 1: a position 1e[+]300 m away'),
    'quaternion': (['2 0 0 0 0 0 0 2'], 'line 1: a pose has the quaternion .* of length 2'),
    'KITTI': (['1 0 0 0 0 1 0 0 0 0 1 0'], "expected 'stamp x y z qx qy qz qw', got 12 words"),
    'text': (['stamp x y z qx qy qz qw'], "expected a stamp in seconds, got 'stamp'"),
    'number': (['1 x y z qx qy qz qw'], "expected a number, got 'x'"),
    'stamp': (['1e40 0 0 0 0 0 0 1'], 'expected a stamp in seconds'),
    'nothing': (['# nothing'], 'holds no poses'),
    'both': (['1 0 0 0 0 0 0 1', '101 0 0 0 0 0 0 1'], 'of the sessions 0, 1 .* with --session')}


@pytest.mark.parametrize('case', LINES)
def test_trajectories_that_are_refused_leave_the_map(tmp_path, capsys, case):
    path, slam = tmp_path / 'map.persem', tmp_path / 'slam.tum'
    saved(path, frames(0), frames(100))
    before = path.read_bytes()
    lines, said = LINES[case]
    slam.write_text('\n'.join(lines))
    status, _, err = run(capsys, 'map', 'move', path, '--trajectory', slam)
    assert status == 1 and path.read_bytes() == before
    assert re.search(said, err)


def test_maps_that_cannot_be_moved(tmp_path, capsys):
    path, slam = tmp_path / 'map.persem', tum(tmp_path / 'slam.tum', (0, 1.0), (9, 1.0))
    stored = saved(path, frames(0, 10), max_history=6)
    words = 'map', 'move', path, '--trajectory', slam
    assert 'has let go of observations' in run(capsys, *words)[2]
    memory = saved(path, frames(0, 10)).memory()
    assert keep_near(memory, (0, 0, 0), radius=3.0)
    store.save(path, memory, CONFIG)
    assert 'has let go of observations' in run(capsys, *words)[2]
    assert f'{path} has no session 3; it has 0' in run(capsys, *words, '--session', 3)[2]
    assert 'cannot be read (No such file' in run(capsys, *words[:-1], tmp_path / 'none')[2]
    store.save(path, load(stored.saved), CONFIG)
    lock = WriterLock(path)
    assert 'is being written by' in run(capsys, *words)[2]
    lock.close()


def test_stamps_keep_all_their_digits(tmp_path):
    (tmp_path / 'a').write_text('1700000000.123456789,0,0,0,0,0,0,1.000001  # a comment\n')
    found = from_tum(tmp_path / 'a')
    assert found.stamps.tolist() == [1_700_000_000_123_456_789]
    assert np.allclose(found.poses[0], np.eye(4))


def path_message(*stamps, frame='map', own=''):
    """Return a nav_msgs/Path, serialized and back."""
    store_ = get_typestore(Stores.ROS2_JAZZY)
    make = MessageFactory(store_.types)
    T = transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    msg = make.path(5, frame, [(stamp, T) for stamp in stamps], own)
    name = 'nav_msgs/msg/Path'
    return Decoder()(bytes(store_.serialize_cdr(msg, name)), name)


def test_paths(tmp_path):
    found = from_path(path_message(3, 7), 'map', '/path')
    assert found.stamps.tolist() == [3, 7] and found.poses[1, :3, 3].tolist() == [1, 2, 3]
    for msg, said in ((path_message(3, frame='odom'), "the path is in the frame 'odom', the map "
                                                      "in 'map'"),
                      (path_message(3, own='odom'), "in the frame 'odom'"),
                      (path_message(3, 3), 'pose 1: the stamp'), (path_message(), 'no poses')):
        with pytest.raises(PersemError, match=said):
            from_path(msg, 'map', '/path')


def test_a_map_is_moved_before_it_is_merged(tmp_path, capsys):
    one, two, out = (tmp_path / name for name in 'abc')
    saved(one, frames(0)), saved(two, frames(100, at=4))
    words = 'map', 'merge', one, two, '--out', out
    status, text, _ = run(capsys, *words, '--transform', -2, 0, 0, 0, 0, 0, 1)
    assert status == 0 and 'not what one run over all recordings gives' in text
    straight = saved(tmp_path / 'd', frames(0), frames(100)).memory()
    assert histories(store.load(out).memory()) == histories(straight)
    for more, said in ((['--transform', *'0000002'], 'a pose has the quaternion'),
                       ([one, '--transform', *'0000001'], 'second of two maps, got 3')):
        status, _, err = run(capsys, *words[:-2], *more, '--out', tmp_path / 'e')
        assert status == 1 and said in err
