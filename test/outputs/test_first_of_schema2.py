"""Map files of schema 2 from before voxels were looked through: all that may be done to a map."""

from contextlib import closing
import sqlite3

import core_worlds as cw
import numpy as np
import old_maps
from persem_ros.cli import main
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.paging import Pager
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store, tables
from persem_ros.outputs.map.living import LivingMap
from persem_ros.outputs.map.merge import merge
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend
import pytest
from test_store import frames, plain

CONFIG = Config()


def columns(path):
    """Return the names of the columns of a file's table blocks."""
    with closing(sqlite3.connect(path)) as db:
        return [row[1] for row in db.execute('PRAGMA table_info(blocks)')]


def whole(path):
    """Return whether SQLite finds a file sound and holds nothing of what it was."""
    with closing(sqlite3.connect(path)) as db:
        return list(db.execute('PRAGMA integrity_check')) == [('ok',)] and \
            {name for name, in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")} \
            == set(tables.NAMES)


@pytest.fixture
def memory():
    """Return a refined map."""
    memory = cw.core_of(frames(6))
    refine(memory, CONFIG.refine)
    return memory


@pytest.fixture
def path(tmp_path, memory):
    """Return the path of its file in the form of then."""
    path = tmp_path / 'map.persem'
    store.save(path, memory, CONFIG)
    old_maps.make_first_of_2(path)
    assert columns(path)[5:] == list(old_maps.FIRST_OF_2)
    return path


def test_it_opens_and_is_mapped_on(path, memory):
    stored = store.load(path)
    assert plain(stored.saved) == plain(memory) and not stored.saved.passed.any()
    went_on = stored.memory()
    for one in (went_on, memory):
        one.add(cw.observations(*frames(7)[-1]))
    assert plain(went_on) == plain(memory)
    store.save(path, went_on, CONFIG)
    assert columns(path) == list(tables.NAMES['blocks'])
    assert plain(store.load(path).saved) == plain(memory)


def test_a_part_of_it_and_what_is_handed_on(path, memory):
    index = dump(memory).block_index
    part = store.load_part(path, index[0], index[0]).saved
    assert len(part.block_index) == 1 and not part.passed.any()
    source = MapSource(path)
    assert sum(len(c['voxel']) for c in source.chunks()) == memory.n_voxels
    assert len(source.blocks(index[:3])['voxel']) == dump(memory).block_start[3]


def test_it_is_attached_and_checkpointed(path, memory):
    living = LivingMap(path, CONFIG, Legend)
    assert columns(path) == list(tables.NAMES['blocks'])
    assert not path.with_name('map.persem.v1').exists()
    pager = Pager(living.memory(), living)
    one = cw.observations(*frames(7)[-1])
    pager.need_voxels(one.voxels)
    pager.memory.add(one)
    pager.save()
    living.close()
    memory.new_session()
    memory.add(one)
    assert whole(path) and plain(store.load(path).saved)['history_label'] == \
        plain(memory)['history_label']
    assert sorted(p.name for p in path.parent.iterdir()) == ['map.persem']


def test_a_killed_upgrade_leaves_the_old_file(path, memory, monkeypatch):
    monkeypatch.setattr(tables, '_blocks', lambda columns, real=tables._blocks: real(
        columns).replace('PRIMARY KEY', 'NONSENSE') if columns is tables.COLUMNS else
        real(columns))
    with pytest.raises(PersemError, match='room for it twice'):
        LivingMap(path, CONFIG, Legend)
    monkeypatch.undo()
    assert plain(store.load(path).saved) == plain(memory)
    assert columns(path)[5:] == list(old_maps.FIRST_OF_2)
    LivingMap(path, CONFIG, Legend).close()
    assert whole(path) and plain(store.load(path).saved) == plain(memory)


def test_it_is_restored_merged_and_moved(path, memory, tmp_path, capsys):
    assert main(['map', 'restore', str(path)]) == 0
    assert 'the file stays as it is' in capsys.readouterr().out
    assert plain(merge([store.load(path)]).memory)['history_label'] == \
        plain(memory)['history_label']
    stamps = memory.frames.stamp / 1e9
    slam = tmp_path / 'slam.tum'
    slam.write_text(''.join(f'{t:.9f} 0.5 0 0 0 0 0 1\n' for t in stamps))
    assert main(['map', 'move', str(path), '--trajectory', str(slam)]) == 0
    assert columns(path) == list(tables.NAMES['blocks']) and whole(path)


def test_columns_that_are_neither_are_refused(path):
    with closing(sqlite3.connect(path)) as db:
        db.execute('ALTER TABLE blocks ADD COLUMN passed BLOB')
    with pytest.raises(PersemError, match='other columns'):
        store.load(path)


def test_looks_take_no_room_where_there_are_none(tmp_path, memory):
    memory.store.passed[3], memory.some_passed = (7, memory.m.voxels['n'][3], 2), True
    store.save(tmp_path / 'a', memory, CONFIG)
    with closing(sqlite3.connect(tmp_path / 'a')) as db:
        sizes = list(db.execute('SELECT voxels, length(passed), length(passed_at) FROM blocks'))
    assert np.count_nonzero([b for _, b, _ in sizes]) == 1
    assert all((b, c) in ((0, 0), (4 * a, 8 * a)) for a, b, c in sizes)
    assert plain(store.load(tmp_path / 'a').saved) == plain(memory)
