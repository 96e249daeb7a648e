"""A replay with memory for a part of an attached map: what it leaves is that of one with all."""

from collections import Counter
from contextlib import closing
import sqlite3

import numpy as np
from persem_ros import replay as replay_module
from persem_ros.errors import PersemError
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.results import paged
from persem_ros.outputs.results.paged import Paged, Sight
from persem_ros.outputs.results.rundir import FILES
from persem_ros.replay import compile_kernels, replay
import pytest
from replays import config_of, refined_images, store
import worlds

BOUND = 250
METHODS = ('raw2d', 'majority', 'context', 'recency')
SAME = ('map.persem', 'metrics.json', 'config.yaml')


@pytest.fixture(scope='module', autouse=True)
def compiled():
    """Compile all kernels, lest a line say so when the first replay does."""
    compile_kernels(('geometry',))


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp('recordings')
    return [worlds.write(folder / f'r{k}', 10, k) for k in range(2)]


@pytest.fixture
def path(recordings, tmp_path):
    """Return a map of one session."""
    path = tmp_path / 'map.persem'
    replay(recordings[0], tmp_path / 'first', settings(path, 0), report=False)
    return path


def settings(path, bound, values=()):
    return config_of({'map.path': str(path), 'map.attached': True, 'memory.max_voxels': bound,
                      'memory.clear_after': 3, 'memory.voxel_size': 0.03,
                      **dict(values)})


@pytest.fixture
def held(monkeypatch):
    """Return how many voxels were in memory after each frame."""
    counts = []
    original = Paged.make_room

    def make_room(self, position):
        original(self, position)
        counts.append(self.memory.n_voxels)
    monkeypatch.setattr(Paged, 'make_room', make_room)
    return counts


def points(folder):
    """Return the header of map.ply and its points, sorted."""
    header, body = (folder / 'map.ply').read_bytes().split(b'end_header\n')
    return header, sorted(body[k:k + 32] for k in range(0, len(body), 32))


@pytest.mark.parametrize('causal, method', [(False, 'persem'), (True, 'persem'),
                                            (False, 'geometry')])
def test_a_replay_that_paged_equals_one_that_never_did(recordings, path, tmp_path, monkeypatch,
                                                       held, causal, method):
    before, config = path.read_bytes(), settings(path, BOUND, {'refine.period': 0.3,
                                                               'refine.method': method})
    methods = METHODS[:2] if causal else METHODS
    replay(recordings[1], tmp_path / 'paged', config, methods, causal)
    assert len(held) == (10 if causal else 20) and max(held) <= 2 * BOUND
    after = path.read_bytes()
    assert after == (tmp_path / 'paged' / 'map.persem').read_bytes()
    path.write_bytes(before)
    monkeypatch.setattr(replay_module, 'pages', lambda *_: False)
    replay(recordings[1], tmp_path / 'whole', config, methods, causal)
    assert after == path.read_bytes() and len(store.load(path).saved.cell) > 4 * BOUND
    assert points(tmp_path / 'paged') == points(tmp_path / 'whole')
    if not causal:
        for name in SAME:
            assert (tmp_path / 'paged' / name).read_bytes() == \
                (tmp_path / 'whole' / name).read_bytes(), name
        found, expected = (refined_images(tmp_path / name) for name in ('paged', 'whole'))
        assert [(*a[:3], a[3].tolist()) for a in found] == \
            [(*a[:3], a[3].tolist()) for a in expected]
    assert sorted(p.name for p in (tmp_path / 'paged').iterdir()) == sorted(FILES)


def test_a_block_that_is_damaged_is_refused_by_name(recordings, path, tmp_path):
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("UPDATE blocks SET label = x'00' WHERE rowid = 3")
    before = path.read_bytes()
    with pytest.raises(PersemError, match=r'map.persem: damaged \(block \(.*restore it'):
        replay(recordings[1], tmp_path / 'out', settings(path, BOUND), report=False)
    assert path.read_bytes() == before and not (tmp_path / 'out').exists()


def test_what_needs_the_whole_map_says_so(recordings, path, tmp_path, caplog, held):
    replay(recordings[1], tmp_path / 'out', settings(path, BOUND), ('context',), causal=True,
           report=False)
    assert held == [] and 'map.persem is held in memory as a whole: --causal measures context' \
        in caplog.text


@pytest.mark.parametrize('level', [0, 2])
def test_pages_show_a_large_map_coarser(path, monkeypatch, level):
    source = MapSource(path)
    monkeypatch.setattr(paged, 'SHOWN', source.n_voxels >> 2 * level)
    sight = Sight(source.n_voxels)
    whole = {name: np.concatenate(parts) for name, *parts in zip(
        ('voxel', 'label'), *[(c['voxel'], c['label']) for c in map(sight.seen, source.chunks(
            blocks=5))])}
    found, width = sight.overview(0.03), 2 ** level
    at = [tuple(v) for v in (whole['voxel'] >> level).tolist()]
    assert found.voxel_size == 0.03 * width and found.labels == Counter(whole['label'].tolist())
    assert [tuple(v) for v in found.columns['voxel'].tolist()] == sorted(set(at))
    highest = {}
    for key, (x, y, z), label in zip(at, whole['voxel'].tolist(), whole['label'].tolist()):
        highest.setdefault(key, {}).setdefault(z, set()).add(label)
    for key, label in zip(map(tuple, found.columns['voxel'].tolist()),
                          found.columns['label'].tolist()):
        assert label in highest[key][max(highest[key])]
