"""Map files of schema 1: they open, go on, and stay beside what replaces them."""

from contextlib import closing
import dataclasses
import sqlite3

import core_worlds as cw
import numpy as np
import old_maps
from persem_ros.core.memory.capture import dump
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config
import pytest
from test_store import frames, plain

NEW = ('history_frame', 'history_offset', 'sessions', 'frames')     # not all of it was kept


@pytest.fixture
def memory():
    """Return a small map: two cameras at one stamp, two sessions, an unfinished refinement."""
    memory = cw.core_of([])
    for k, frame in enumerate(frames(12)):
        memory.add(cw.observations(*frame))
        if k == 5:
            memory.new_session()
        if k == 7:
            memory.add(cw.observations(*frame[:3], 'camera 2'))
            refine(memory, Config().refine)
    return memory


@pytest.fixture
def path(tmp_path, memory):
    """Return the path of its file of schema 1."""
    path = tmp_path / 'map.persem'
    old_maps.save(path, dump(memory), Config())
    return path


def test_a_file_of_schema_1_opens_with_all_that_it_held(path, memory):
    opened, expected = plain(store.load(path).saved), plain(memory)
    for name in NEW:
        opened.pop(name), expected.pop(name)
    assert opened == expected
    again = store.load(path).memory()
    for voxel in memory.voxels()['voxel']:
        for one, two in zip(again.history(voxel), memory.history(voxel)):
            assert one.tolist() == two.tolist()


def test_an_observation_is_of_the_first_frame_with_its_t(path, memory):
    saved = store.load(path).saved
    t = saved.frames.t
    assert len(t) == len(memory.frames) == 13 and t[7] == t[8]
    assert (saved.history_frame != 8).all() and (dump(memory).history_frame == 8).any()
    assert (saved.history_offset == 128).all()


def test_a_session_has_the_same_uuid_each_time_that_the_file_is_opened(path):
    one, two = (store.load(path).saved.frames.sessions for _ in range(2))
    assert [s.uuid for s in one.values()] == [s.uuid for s in two.values()]
    assert len({s.uuid for s in one.values()}) == len(one) == 2
    assert one[1].mounts['camera 2'].tolist() == np.eye(4).tolist()


def test_the_first_write_brings_it_up_and_leaves_the_old_one_beside(path, caplog):
    old = path.read_bytes()
    goes_on = store.load(path).memory(Config())
    assert [p.name for p in path.parent.iterdir()] == ['map.persem']
    for again in range(2):
        goes_on.new_session()
        goes_on.add(cw.observations(*frames(1, seed=again + 1)[0]))
        store.save(path, goes_on, Config())
        assert path.with_name('map.persem.v1').read_bytes() == old
        assert plain(store.load(path).saved) == plain(goes_on)
    assert caplog.text.count('was a map file of schema 1') == 1


def test_a_damaged_file_of_schema_1_is_refused(path, memory):
    saved = dump(memory)
    table = saved.frames.copy()
    table._t = table._t + 5
    path.unlink()
    old_maps.save(path, dataclasses.replace(saved, frames=table), Config())
    with closing(sqlite3.connect(path)) as db:
        db.execute('UPDATE frames SET t = t + 1')
        db.commit()
    with pytest.raises(PersemError, match='damaged'):
        store.load(path)
