"""Histories that move with corrected poses, held against plain Python (spec section 10)."""

from dataclasses import fields, replace

import core_worlds as cw
from hypothesis import given, strategies as st
import move_reference as ref
import numpy as np
from persem_ros.core.frame.moved import moved as moved_frame
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.move import corrected, correction_of, moved
from persem_ros.core.memory.session import Session
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.memory.voxel_order import ordered
from persem_ros.core.trajectory import between, Trajectory
from persem_ros.core.transforms import inverse, matrix_to_quaternion, slerp, transform
from persem_ros.errors import PersemError
import pytest

SIZE = 0.5
SECOND = 10 ** 9


def shift(*xyz):
    """Return the transform that shifts by some metres."""
    return transform(np.array(xyz, float), (0.0, 0.0, 0.0, 1.0))


def corrections(rng, n):
    """Return K of n frames: none, whole voxels, a quarter turn, or anything small."""
    quarter = np.eye(4)
    quarter[:2, :2] = [[0, -1], [1, 0]]
    for _ in range(n):
        kind = rng.integers(5)
        if kind < 3:
            yield (np.eye(4), shift(*rng.integers(-2, 3, 3) * 0.25), quarter)[kind]
        else:
            T = cw.pose(rng, 0.4)
            q = slerp([0, 0, 0, 1.0], matrix_to_quaternion(T[:3, :3]), 0.05 * (kind - 3))
            yield transform(T[:3, 3], q)


@st.composite
def flights(draw):
    """Draw a memory of two sessions with offsets and poses, and the frames' corrected poses."""
    rng, world = np.random.default_rng(draw(cw.seeds)), draw(cw.worlds(most_frames=10))
    memory, frames = VoxelMemory(SIZE), []
    for k, (stamp, seen, ids) in enumerate(world):
        if k == 5:
            memory.new_session()
        # Turned, what is 10 ** 8 voxels away would be spread over the Earth.
        near = {tuple((x + 1000) % 2000 - 1000 for x in v): o for v, o in seen.items()}
        one = cw.observations(stamp, near, ids)
        placed = cw.pose(rng) if rng.random() < 0.5 else np.eye(4)
        offsets = rng.choice([0, 128, 255, *range(256)], (len(seen), 3)).astype(np.uint8)
        memory.add(replace(one, offsets=offsets, T_map_sensor=placed))
    for row, K in zip(memory.frames, corrections(rng, len(memory.frames))):
        frames.append((row.T_map_sensor, K @ row.T_map_sensor))
    gone = rng.random(memory.n_voxels) < 0.5
    memory.m.voxels['gone'][:memory.n_voxels] = gone
    return memory, frames


def seen_in(memory):
    """Return {voxel: [(f, c, s, offset), ...]} of a memory."""
    return {tuple(v): [(f, c, s, tuple(o)) for c, s, f, o in zip(*(
        column.tolist() for column in memory.sightings(v)))]
        for v in dump(memory).voxels().tolist()}


def added(seen, frames, table):
    """Return the memory that sees frame after frame what is in seen."""
    memory = VoxelMemory(SIZE)
    for f, placed in enumerate(frames):
        while memory.session < table.session[f]:
            memory.new_session()
        own = {v: o for v, history in seen.items() for o in history if o[0] == f}
        one = cw.observations(int(table.stamp[f]), {v: (o[1], o[2]) for v, o in own.items()})
        memory.add(replace(one, T_map_sensor=placed, offsets=np.array(
            [o[3] for o in own.values()], np.uint8).reshape(-1, 3)))
    return memory


@given(flights(), st.sampled_from([0, 1]))
@cw.examples(max_examples=150)
def test_moved_histories_are_the_references(flight, session):
    memory, frames = flight
    rows = memory.frames.session == session
    saved = dump(memory)
    new = moved(saved, np.stack([best for _, best in frames]), rows)
    wanted, placed = ref.moved(seen_in(memory), frames, np.flatnonzero(rows), SIZE)
    loaded = load(new)
    assert seen_in(loaded) == wanted
    assert new.frames.placed.tolist() == [T.tolist() for T in placed]
    best = [frames[f][1] if rows[f] else frames[f][0] for f in range(len(frames))]
    assert new.frames.best.tolist() == [T.tolist() for T in best]
    # Evidence, switches and counters are those of a memory that sees it frame after frame.
    again = dump(added(wanted, placed, memory.frames))
    for field in fields(again):
        if field.name not in ('frames', 'habits', 'label', 'source', 'dirty', 'gone', 'posterior',
                              'session', 'seen_ids', 'origin'):
            assert np.array_equal(getattr(new, field.name), getattr(again, field.name)), field.name


@given(flights())
@cw.examples(max_examples=30)
def test_frame_by_frame_is_the_whole(flight):
    memory, frames = flight
    saved = dump(memory)
    best = np.stack([best for _, best in frames])
    new = moved(saved, best, np.ones(len(frames), bool))
    again = VoxelMemory(SIZE)
    seen = seen_in(memory)
    for f, (placed, T) in enumerate(frames):
        while again.session < memory.frames.session[f]:
            again.new_session()
        own = {v: o for v, history in seen.items() for o in history if o[0] == f}
        one = replace(cw.observations(int(memory.frames.stamp[f]),
                                      {v: (o[1], o[2]) for v, o in own.items()},
                                      unknown=[(9, 9, 9)]), T_map_sensor=placed,
                      offsets=np.array([o[3] for o in own.values()] + [(0, 0, 0)], np.uint8))
        again.add(moved_frame(one, T, SIZE, (0.0, 0.0, 0.0)))
    assert seen_in(again) == seen_in(load(new))


def test_nothing_changes_where_nothing_moves():
    rng = np.random.default_rng(3)
    memory = cw.core_of([(k, {tuple(v): (1, 1.0) for v in rng.integers(-9, 9, (20, 3)).tolist()},
                          ()) for k in range(5)])
    saved = dump(memory)
    # A millimetre leaves every point in its voxel: the frames stay, and know better.
    best = shift(1e-3, 0, 0) @ saved.frames.placed
    new = moved(saved, best, np.ones(5, bool))
    for field in fields(new):
        if field.name not in ('frames', 'habits'):
            assert np.array_equal(getattr(new, field.name), getattr(saved, field.name)), field.name
    assert (new.frames.placed == saved.frames.placed).all() and (new.frames.best == best).all()
    # A correction that grows counts from where the observations lie.
    far = moved(new, shift(0.3, 0, 0) @ saved.frames.placed, np.ones(5, bool))
    assert (far.history_offset[:, 0] == int(128.5 + 0.3 / SIZE * 256 - 256)).all()


def test_long_histories_that_meet():
    """More observations of a voxel than there is room for at first, of several histories."""
    rng, memory = np.random.default_rng(5), VoxelMemory(SIZE)
    for k in range(200):
        seen = {(int(x), 0, 0): (int(rng.integers(3)), 1.0) for x in rng.permutation(5)[:3]}
        memory.add(replace(cw.observations(k, seen), offsets=rng.integers(
            0, 256, (3, 3)).astype(np.uint8), T_map_sensor=np.eye(4)))
    frames = [(row.T_map_sensor, shift(0.25 * rng.integers(2), 0, 0) @ row.T_map_sensor)
              for row in memory.frames]
    wanted, _ = ref.moved(seen_in(memory), frames, np.arange(200), SIZE)
    new = moved(dump(memory), np.stack([best for _, best in frames]), np.ones(200, bool))
    assert max(map(len, wanted.values())) > 64
    assert seen_in(load(new)) == wanted


@given(cw.seeds, st.integers(0, 2000), st.integers(1, 62), st.integers(0, 12),
       st.integers(1, 11))
@cw.examples(max_examples=60)
def test_the_order_is_by_key_and_stable(seed, n, bits, bucket_bits, digit):
    rng, shift_by = np.random.default_rng(seed), max(0, bits - bucket_bits)
    keys = rng.integers(0, 1 << bits, max(1, n // 3))[rng.integers(0, max(1, n // 3), n)]
    room = np.empty(n, np.uint32), np.empty(n, np.uint32), np.empty(n, int), np.empty(n, int)
    found, rows = ordered(keys, 1 << bits - shift_by, shift_by, digit, *room)
    assert rows.tolist() == np.argsort(keys, kind='stable').tolist()
    assert (found == keys[rows]).all()


def test_what_was_seen_in_what_had_gone_stays_gone():
    memory = cw.core_of([(k, {(x, 0, 0): (1, 1.0) for x in (0, 5)}, ()) for k in range(3)])
    memory.m.voxels['gone'][memory.number((0, 0, 0))] = 1
    saved = dump(memory)
    new = moved(saved, shift(0.5, 0, 0) @ saved.frames.placed, np.ones(3, bool))
    assert (new.cell >> 6).tolist() == [1, 6] and new.gone.tolist() == [1, 0]


def test_poses_that_are_too_far_away():
    saved = dump(cw.core_of([(1, {(0, 0, 0): (1, 1.0)}, ()), (2, {(0, 0, 0): (1, 1.0)}, ())]))
    for far, said in ((1e9, 'too far away'), (1e8, 'too wide')):
        best = np.stack([shift(far, far, far), shift(-far, -far, -far)])
        with pytest.raises(PersemError, match=said):
            moved(saved, best, np.ones(2, bool))


# ---- corrections


def table(stamps, mount=None):
    """Return a frame table of a flight along x, 10 m/s, camera above the body."""
    frames = FrameTable()
    mount = np.eye(4) if mount is None else mount
    for k, t in enumerate(stamps):
        frames.append(k, 0, 'front', round(t * SECOND), shift(10 * t, 0, 0) @ mount)
    frames.sessions[0] = Session('', {'front': mount})
    return frames


def trajectory(stamps, *poses):
    """Return the Trajectory of some poses."""
    return Trajectory(np.array([round(t * SECOND) for t in stamps]), np.stack(poses), 'slam.tum')


def test_what_is_interpolated_is_the_correction():
    mount = transform((0.1, 0, -0.2), (0.5, -0.5, 0.5, 0.5))
    frames = table(np.arange(0, 11), mount)
    turned = transform((80.0, 3.0, 0), (0, 0, 1.0, 0))
    K = correction_of(frames, 0, trajectory((2, 4, 8), shift(20, 1, 0), shift(40, 2, 0), turned))
    best = corrected(frames, 0, K)
    body = best @ inverse(mount)
    # Between keyframes the flight goes on as it was flown; outside the nearest end's holds.
    for f, y in ((0, 1), (2, 1), (3, 1.5), (4, 2)):
        assert np.allclose(body[f], shift(10 * f, y, 0))
    assert np.allclose(body[8], turned) and np.allclose(body[10], turned @ shift(20, 0, 0))
    half = slerp([0, 0, 0, 1.0], [0, 0, 1.0, 0], 0.5)
    assert np.allclose(body[6, :3, :3], transform((0, 0, 0), half)[:3, :3])


def test_a_correction_far_from_the_origin_of_the_map():
    """A small turn interpolated about the origin of UTM would bend the flight by metres."""
    far = shift(5e5, 5e6, 0)
    stamps = np.arange(0, 5)
    placed = np.stack([far @ shift(10.0 * t, 0, 0) for t in stamps])
    tilt = transform((0, 0, 0), slerp([0, 0, 0, 1.0], [0, 0, 1.0, 0], 1e-3))
    frames = FrameTable()
    for k, T in enumerate(placed):
        frames.append(k, 0, '', k * SECOND, T)
    frames.sessions[0] = Session('', {'': np.eye(4)})
    path = trajectory((0, 4), placed[0], placed[4] @ tilt)
    best = corrected(frames, 0, correction_of(frames, 0, path, (5e5, 5e6, 0.0)))
    assert np.abs(best[2, :3, 3] - placed[2, :3, 3]).max() < 0.1


def test_stamps_between_frames():
    frames = table((0, 1, 1.4, 3))
    path = trajectory((0, 1.2, 2.2), *(shift(10 * t, 1 + t, 0) for t in (0, 1.2, 2.2)))
    K = correction_of(frames, 0, path)
    # At 2.2 s nothing near was flown: whoever turned there is not where a line would have him.
    assert K.stamps.tolist() == [0, 1.2 * SECOND]
    with pytest.raises(PersemError, match='or between two that are at most 0.5 s apart'):
        correction_of(frames, 0, trajectory((2.2,), shift(22, 0, 0)))


@pytest.mark.parametrize('stamps, said', [
    ((20, 21), r'slam.tum: 0 of 2 poses lie within session 0, 0.000 s to 10.000 s; it runs from '
               r'20.000 s to 21.000 s, expected 80% .* of another clock'),
    ((9, 10, 11, 12), '2 of 4 poses'), ((), 'it is empty')])
def test_trajectories_of_another_time(stamps, said):
    path = Trajectory(np.array([t * SECOND for t in stamps], np.int64),
                      np.zeros((len(stamps), 4, 4)), 'slam.tum')
    with pytest.raises(PersemError, match=said):
        correction_of(table(np.arange(0, 11)), 0, path)


@given(cw.seeds)
@cw.examples(max_examples=30)
def test_between_is_lerp_and_slerp(seed):
    rng = np.random.default_rng(seed)
    poses = np.stack([cw.pose(rng) for _ in range(4)])
    poses[3] = poses[2] @ transform((0, 0, 0), slerp([0, 0, 0, 1.0], [1.0, 0, 0, 0], 1e-6))
    stamps = np.array([0, 100, 200, 300])
    at = np.array([0, 1, 50, 100, 130, 200, 250, 300])
    for T, t in zip(between(stamps, poses, at), at):
        a, x = min(t // 100, 2), t / 100 - min(t // 100, 2)
        q = slerp(*(matrix_to_quaternion(poses[k][:3, :3]) for k in (a, a + 1)), x)
        wanted = transform(poses[a][:3, 3] + x * (poses[a + 1] - poses[a])[:3, 3], q)
        assert np.allclose(T, wanted, atol=1e-12)
