"""The frame table: arrays that grow, copies that do not, sessions that know themselves."""

from core_worlds import examples, observations, tiny_pages
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory import frame_table, session as sessions
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.session import Session, Stamps
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.outputs.map.explanation import history_table
import pytest


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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sessions, 'NEWEST', 8)
        table, expected = FrameTable(), {}
        table.sessions[0] = Session('')
        known = Stamps(table)
        for stamp in stamps:
            assert known.find(stamp) == expected.get(stamp)
            if stamp not in expected:
                expected[stamp] = len(expected)
                known.add(stamp, expected[stamp])
                table.append(expected[stamp], 0, '', stamp, np.eye(4))
            table.append(7, 1, '', stamp, np.eye(4))        # of another session
        again = Stamps(table)
        assert all(again.find(stamp) == t for stamp, t in expected.items())


class Shelf:
    """A store of frames, and what it was asked for."""

    def __init__(self, table):
        self.table, self.asked = table, []

    def fetch(self, first, end):
        """Return rows of the table."""
        self.asked.append(first)
        rows = [self.table[f] for f in range(first, end)]
        return ([r.t for r in rows], [r.session for r in rows], [r.sensor for r in rows],
                [r.stamp for r in rows], [r.T_map_sensor for r in rows],
                [r.T_map_best for r in rows])


@pytest.fixture(params=[False, True], ids=['placed', 'moved'])
def shelved(request, monkeypatch):
    """Return a table of 40 rows in pages of 8, its Shelf, and what let go leaves behind: -1."""
    tiny_pages(monkeypatch, 8)
    monkeypatch.setattr(frame_table, 'ROOM', 1)
    table, whole = FrameTable(), FrameTable()
    for one in (table, whole):
        for f in range(60):
            one.append(f // 2, f // 30, f'camera {f % 2}', 10 ** 18 + f, shifted(f),
                       shifted(f + 1) if request.param else None)
    shelf = Shelf(whole)
    table.attach(shelf.fetch)
    return table, shelf


def test_rows_that_left_come_back_where_they_are_needed(shelved):
    table, shelf = shelved
    size, copy = table.nbytes(), table.copy()
    table.release([0, 1, 3, 4])
    table.release([1])
    assert table.nbytes() == size * 28 // 60 and not shelf.asked
    assert table.here('t')[[9, 20, 59]].tolist() == [-1, 10, 29]
    table.bring(np.array([20, 9, 15], np.int32))
    assert shelf.asked == [8] and table.here('t')[9] == 4
    assert table[24].stamp == 10 ** 18 + 24 and shelf.asked == [8, 24]
    for f in range(60, 70):             # into longer columns; the copy keeps its own
        table.append(30, 2, 'camera 2', 10 ** 18 + f, shifted(f))
    assert shelf.asked == [8, 24]
    for one in (table, copy):
        assert one.placed[:60, 0, 3].tolist() == list(range(60))
        assert np.array_equal(one.best[:60], shelf.table.best)
        assert one.sensor[:60].tolist() == [0, 1] * 30
        assert one.stamp[-1] == 10 ** 18 + len(one) - 1
    assert shelf.asked == [8, 24, 0, 32, 0, 32] and len(table) == 70


def test_who_asks_why_a_voxel_has_its_label_brings_no_row_back(shelved):
    table, shelf = shelved
    table.release([0, 2, 3])
    step = {'label': 1, 'confidence': 1.0, 'gap': 0, 'surprise': 0, 'weight': 1.0, 'leader': 1}
    lines = history_table({'observations': 3, 'steps': [{**step, 't': t} for t in (4, 6, 18)]},
                          table, str)
    assert [line.split()[1] for line in lines[1:4]] == [
        f'1000000000.{2 * t:09}' for t in (4, 6, 18)] and not shelf.asked


def test_rows_that_come_back_as_others_are_refused(shelved):
    table, shelf = shelved
    table.release([1])
    shelf.table._stamp[9] += 1
    with pytest.raises(PersemError, match='other frames 8 to 15 .* restore it from a copy'):
        table.stamp
    shelf.table._stamp[9] -= 1
    assert table.stamp[9] == 10 ** 18 + 9


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
