"""The frame table: arrays that grow, copies that do not, sessions that know themselves."""

from core_worlds import examples, observations
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.frame_table import FrameTable, Stamps
from persem_ros.core.memory.voxel_memory import VoxelMemory


def shifted(x):
    """Return a pose x metres along the first axis."""
    T = np.eye(4)
    T[0, 3] = x
    return T


def test_a_row_is_what_was_entered_and_a_copy_stays_as_it_was():
    table = FrameTable()
    for f in range(200):
        assert table.append(f // 2, f // 100, f'camera {f % 2}', 10 ** 18 + f, shifted(f)) == f
        if f == 99:
            copy = table.copy()
    assert len(table) == 200 and len(copy) == 100
    row = table[-1]
    assert (row.t, row.session, row.sensor, row.stamp) == (99, 1, 'camera 1', 10 ** 18 + 199)
    assert row.T_map_sensor[0, 3] == row.T_map_best[0, 3] == 199
    copy.append(7, 7, 'other', 7, shifted(-1))
    assert table[100].T_map_sensor[0, 3] == 100 and copy[100].T_map_sensor[0, 3] == -1
    assert table.sensors == ['camera 0', 'camera 1'] and copy.sensors[2:] == ['other']
    assert table.nbytes() == 200 * (128 + 8 + 8 + 4 + 2)


def test_better_poses_leave_earlier_copies_alone():
    table = FrameTable()
    for f in range(3):
        table.append(f, 0, '', f, shifted(f))
    before = table.copy()
    table.replace_poses(table.placed, table.placed + shifted(5) - np.eye(4))
    table.append(3, 0, '', 3, shifted(3), shifted(4))
    table.append(4, 0, '', 4, shifted(4))
    assert table.best[:, 0, 3].tolist() == [5, 6, 7, 4, 4]
    assert table.placed[:, 0, 3].tolist() == [0, 1, 2, 3, 4]
    assert before.best[:, 0, 3].tolist() == [0, 1, 2] and not before.moved


@given(st.lists(st.integers(-5, 200), max_size=300))
@examples(max_examples=50)
def test_stamps_in_any_order_keep_the_t_that_they_came_with(stamps):
    known, expected = Stamps(), {}
    for stamp in stamps:
        assert known.find(stamp) == expected.get(stamp)
        if stamp not in expected:
            expected[stamp] = len(expected)
            known.add(stamp, expected[stamp])
    again = Stamps(np.array(list(expected), np.int64), np.array(list(expected.values())))
    assert all(again.find(stamp) == t for stamp, t in expected.items())


def test_a_session_has_a_uuid_of_its_own_and_the_same_in_every_map():
    maps = [VoxelMemory(0.5), VoxelMemory(0.5)]
    for memory in maps:
        for session in range(2):
            for stamp in range(2):
                memory.add(observations(stamp, {(0, 0, 0): (session, 1.0)}, sensor='front'))
            memory.new_session()
    uuids = [[s.uuid for s in memory.frames.sessions.values()] for memory in maps]
    assert uuids[0] == uuids[1] and len(set(uuids[0])) == 2
    assert list(maps[0].frames.sessions[0].mounts) == ['front']
