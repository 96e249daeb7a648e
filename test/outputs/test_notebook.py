"""persem_ros.open_map: what it gives is what the memory has."""

import core_worlds as cw
import numpy as np
import persem_ros
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

LEGEND = Legend.from_yaml('classes:\n- {id: 1, name: road}\n- {id: 2, name: tree}\n')


@pytest.fixture(scope='module')
def opened(tmp_path_factory):
    """Return (Map, VoxelMemory) of a wall that was seen three times."""
    config = updated(Config(), {'map.origin': [100.0, 0.0, 0.0]})
    memory = cw.core_of([])
    memory.origin = (100.0, 0.0, 0.0)
    for t in range(3):
        seen = {(i, j, 0): (1 + (i > 12), 0.5) for i in range(20) for j in range(-3, 9)}
        seen[4, 4, 0] = (1 + t % 2, 1.0)
        seen[3, 3, 9] = (7, 1.0)
        memory.add(cw.observations(10 ** 9 * t + 5, seen))
    refine(memory, config.refine)
    path = tmp_path_factory.mktemp('map') / 'm.persem'
    store.save(path, memory, config, LEGEND)
    return persem_ros.open_map(str(path)), memory


def test_columns_are_the_memory(opened):
    a_map, memory = opened
    found, wanted = a_map.columns(), memory.voxels()
    for name in ('voxel', 'label', 'majority', 'confidence', 'observations', 'switches', 'source'):
        assert np.array_equal(found[name], wanted[name]), name
    assert np.array_equal(found['xyz'], (wanted['voxel'] + 0.5) * 0.5 + memory.origin)
    assert len(a_map) == memory.n_voxels and str(memory.n_voxels) in repr(a_map)
    assert a_map.classes == {1: 'road', 2: 'tree'}
    assert a_map.counts() == {1: 156, 2: 84, 7: 1}
    assert a_map.frames['stamp'].tolist() == [5, 10 ** 9 + 5, 2 * 10 ** 9 + 5]
    assert a_map.frames['position'].shape == (3, 3)


@pytest.mark.parametrize(('choice', 'n'), [
    ({'classes': 'tree'}, 84), ({'classes': ['road', 7]}, 157), ({'classes': 2}, 84),
    ({'box': (100, 0, 0, 101, 1, 1)}, 4), ({'min_observations': 4}, 0)])
def test_choices(opened, choice, n):
    columns = opened[0].columns(**choice)
    ids, p = opened[0].probabilities(**choice)
    assert {len(column) for column in columns.values()} == {n} and p.shape == (n, len(ids))
    assert sum(len(part['label']) for part in opened[0].chunks(**choice)) == n
    assert p.sum(axis=1) == pytest.approx(np.ones(n))


def test_probabilities_and_histories_of_one_voxel(opened):
    a_map, memory = opened
    row = np.flatnonzero((a_map.columns()['voxel'] == (4, 4, 0)).all(axis=1))[0]
    ids, p = a_map.probabilities()
    assert ids == [1, 2, 7] and p[row] == pytest.approx([2 / 3, 1 / 3, 0])
    history = a_map.history(102.2, 2.1, 0.3)
    assert history['label'].tolist() == [1, 2, 1]
    assert history['stamp'].tolist() == [5, 10 ** 9 + 5, 2 * 10 ** 9 + 5]
    assert history['position'].tolist() == [[0, 0, 0]] * 3
    assert a_map.explain(102.2, 2.1, 0.3).startswith('voxel 4 4 0, centre 102.250 2.250 0.250')


def test_table(opened):
    pytest.importorskip('pandas', reason='needs pandas')
    table = opened[0].table(classes='tree')
    assert set(table['name']) == {'tree'} and len(table) == 84
    assert table['last_stamp'].iloc[0].isoformat() == '1970-01-01T00:00:02.000000005+00:00'
    assert set(table['source']) <= {'majority', 'history', 'trust', 'context', 'geometry'}


@pytest.mark.parametrize(('question', 'words'), [
    (lambda m: m.columns(classes='tee'), "no class 'tee', did you mean 'tree'"),
    (lambda m: m.columns(box=(1, 0, 0, 0, 1, 1)), 'expected x0 y0 z0 x1 y1 z1'),
    (lambda m: m.columns(box=(1, 2)), 'expected x0 y0 z0 x1 y1 z1'),
    (lambda m: m.columns(box='abc'), 'expected six numbers'),
    (lambda m: m.history(0, 0, 0), 'nothing was observed at 0 0 0 m'),
    (lambda m: m.explain(float('nan'), 0, 1e300), 'nothing was observed'),
    (lambda m: persem_ros.open_map('nowhere.persem'), 'nowhere.persem: cannot be read')])
def test_refusals(opened, question, words):
    with pytest.raises(PersemError, match=words):
        question(opened[0])


def test_a_missing_pandas_is_one_sentence(opened, monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'pandas', None)
    with pytest.raises(PersemError, match='pip install pandas, or use columns'):
        opened[0].table()


def test_a_list_of_classes_that_came_out_empty_chooses_nothing(opened):
    a_map = opened[0]
    assert len(a_map.columns(classes=[])['label']) == 0 < len(a_map.columns()['label'])
    both = a_map.columns(classes='tree, 1')['label']
    assert set(both) == set(a_map.columns(classes=['tree', 1])['label']) and len(set(both)) == 2
