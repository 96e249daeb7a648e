"""The map file: exact, deterministic, whole or not at all, refused when it is not what it says."""

from contextlib import closing
import dataclasses
from pathlib import Path
import random
import resource
import sqlite3
import subprocess
import sys

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.capture import dump, Parts
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.rows import to_rows
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend
import pytest

ROOT = Path(__file__).parents[2]


def frames(n, seed=0):
    """Return n random frames of up to 60 voxels on both sides of zero."""
    rng = np.random.default_rng(seed)
    return [(10 ** 18 + 10 ** 8 * t,
             {tuple(int(i) for i in voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.EXACT)))
              for voxel in rng.integers(-9, 9, (60, 3))},
             [1, 2], f'camera {t % 2}') for t in range(n)]


def plain(memory):
    """Return all that a memory or a dump knows as comparable values."""
    saved = memory if dataclasses.is_dataclass(memory) else dump(memory)
    values = {field.name: getattr(saved, field.name) for field in dataclasses.fields(saved)}
    values['habits'] = {name: a.tolist() for name, a in saved.habits.items()}
    values['frames'] = [(f.t, f.session, f.sensor, f.stamp, f.T_map_sensor.tolist(),
                         f.T_map_best.tolist()) for f in saved.frames]
    values['sessions'] = {number: (session.uuid, {name: T.tolist() for name, T in
                                                  session.mounts.items()})
                          for number, session in saved.frames.sessions.items()}
    return {name: (str(value.dtype), value.shape, value.tobytes())
            if isinstance(value, np.ndarray) else value
            for name, value in values.items()}


@pytest.fixture
def memory():
    """Return a small refined map."""
    memory = cw.core_of([])
    for frame in frames(12):
        memory.add(cw.observations(*frame))
    refine(memory, Config().refine)
    return memory


@pytest.fixture
def path(tmp_path, memory):
    """Return the path of its map file."""
    path = tmp_path / 'map.persem'
    store.save(path, memory, Config(), load_legend('town'))
    return path


def refusal(path):
    """Return the sentence with which a file is refused."""
    with pytest.raises(PersemError) as caught:
        store.load(path)
    sentence = str(caught.value)
    assert '\n' not in sentence and sentence.startswith(str(path))
    return sentence


def test_all_comes_back(path, memory):
    stored = store.load(path)
    assert plain(stored.saved) == plain(memory)
    assert plain(stored.memory()) == plain(memory)
    assert stored.legend == load_legend('town')
    assert stored.config() == Config()
    assert stored.map_frame == 'map'


@cw.examples(max_examples=40)
@given(cw.worlds(), st.integers(0, 14), st.sampled_from([0, 3]), st.booleans())
def test_saved_loaded_and_continued_is_never_stopped(tmp_path_factory, world, stop, kept, refined):
    path = tmp_path_factory.mktemp('map') / 'map.persem'
    config = updated(Config(), {'memory.max_history': kept, 'refine.min_observations': 1})
    straight, stopped = cw.core_of([], kept), cw.core_of([], kept)
    for k, frame in enumerate(world):
        if k == stop:
            store.save(path, stopped, config)
            stopped = store.load(path).memory(config)
        for memory in (straight, stopped):
            memory.add(cw.observations(*frame))
            if refined:
                refine(memory, config.refine, full=k % 3 == 0)
    assert plain(straight) == plain(stopped)
    store.save(path, straight, config)
    other = path.with_name('other.persem')
    store.save(other, stopped, config)
    assert path.read_bytes() == other.read_bytes()


@pytest.mark.parametrize('voxels', [1, 100, 10 ** 6])
def test_in_parts_it_is_the_same(memory, voxels):
    keep_near(memory, (0.0, 0.0, 0.0), max_voxels=memory.n_voxels // 2)
    texts = {'settings': '', 'map_frame': 'map', 'legend': ''}
    whole, parts = (to_rows(saved, texts) for saved in (dump(memory), Parts(memory, voxels)))
    for name, table in whole.items():
        assert [[*map(told, row)] for row in parts[name]] == [[*map(told, row)] for row in table]


def told(value):
    """Return a value of a row, a view as its bytes."""
    return bytes(value) if isinstance(value, memoryview) else value


def test_empty_map(tmp_path):
    store.save(tmp_path / 'map.persem', cw.core_of([]), Config())
    stored = store.load(tmp_path / 'map.persem')
    assert plain(stored.memory()) == plain(cw.core_of([]))
    assert stored.legend == Legend()


def test_any_sqlite_program_reads_it(path, memory):
    voxel = dump(memory).block_index[0].tolist()
    with closing(sqlite3.connect(path)) as db:
        row = db.execute('SELECT voxels, observations FROM blocks WHERE x=? AND y=? AND z=?',
                         voxel).fetchone()
        frame = db.execute('SELECT t, stamp, sensor FROM frames ORDER BY row').fetchone()
    assert len(row[1]) == 4 * row[0]
    assert frame == (0, 10 ** 18, 'camera 0')


def test_refused_where_voxels_would_be_others(path):
    stored = store.load(path)
    for name, value in (('memory.voxel_size', 0.25), ('map.origin', [1.0, 0.0, 0.0]),
                        ('frames.map', 'odom')):
        with pytest.raises(PersemError, match=f'was made with {name} .* or another map.path'):
            stored.memory(updated(Config(), {name: value}))


def test_another_max_history(path, memory, caplog):
    config = updated(Config(), {'memory.max_history': 8})
    bounded = store.load(path).memory(config)
    assert bounded.max_history == 8
    assert not caplog.records
    store.save(path, bounded, config)
    assert store.load(path).memory(Config()).max_history == 0
    assert 'holds the newest 8 observations' in caplog.text


def test_what_is_no_map_file(tmp_path):
    assert 'No such file' in refusal(tmp_path / 'none')
    assert 'is a folder' in refusal(tmp_path)
    (tmp_path / 'empty').write_bytes(b'')
    assert 'not a map file' in refusal(tmp_path / 'empty')
    (tmp_path / 'text').write_text('map: no\n' * 1000)
    assert 'not a map file' in refusal(tmp_path / 'text')
    with closing(sqlite3.connect(tmp_path / 'foreign')) as db:
        db.executescript('CREATE TABLE messages (id); INSERT INTO messages VALUES (1)')
    assert 'a database, but not a map file' in refusal(tmp_path / 'foreign')


def test_another_schema(path):
    with closing(sqlite3.connect(path)) as db:
        db.execute(f'PRAGMA user_version = {store.SCHEMA + 1}')
    assert f'schema {store.SCHEMA + 1}, expected schema {store.SCHEMA}' in refusal(path)


@pytest.mark.parametrize('share', [0.05, 0.3, 0.6, 0.9, 0.999])
def test_truncated(path, share):
    data = path.read_bytes()
    path.write_bytes(data[:int(share * len(data))])
    assert 'damaged' in refusal(path)


def test_flipped_bytes_are_found_or_do_no_harm(path, memory):
    data, rng, found = path.read_bytes(), random.Random(4), 0
    expected = plain(memory)
    places = [*range(100), *rng.sample(range(100, len(data)), 200)]
    for place in places:
        damaged = bytearray(data)
        damaged[place] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        try:
            assert plain(store.load(path).saved) == expected, place
        except PersemError as error:
            assert '\n' not in str(error)
            found += 1
    assert found > 100      # the rest lies in unused parts of pages


@pytest.mark.parametrize(('column', 'place', 'value'), [
    ('cell', 0, 512), ('label', 1, 65535), ('history_frame', 0, -1),
    ('history_frame', 0, 12), ('source', 0, 5), ('gone', 0, 2), ('first_label', 0, 65535),
    ('observations', 0, 0), ('evidence_sum', 0, float('nan')), ('evidence_sum', 0, 0.0)])
def test_columns_that_contradict_each_other_are_refused(path, memory, column, place, value):
    # a file with right checksums must not make the kernels write beside the pools
    saved = dump(memory)
    changed = getattr(saved, column).copy()
    changed[place] = value
    store.save(path, dataclasses.replace(saved, **{column: changed}), Config())
    assert 'damaged' in refusal(path)


def test_disk_full_leaves_the_old_file(path, memory):
    old = path.read_bytes()
    for frame in frames(60, 1):
        memory.add(cw.observations(*frame))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(old) + 10000, limits[1]))
    try:
        with pytest.raises(PersemError, match='cannot write .*map.persem: ') as caught:
            store.save(path, memory, Config())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert '\n' not in str(caught.value)
    assert path.read_bytes() == old
    assert [p.name for p in path.parent.iterdir()] == ['map.persem']


KILLER = """
import os, random, signal, sys, time
sys.path[:0] = ['test', 'test/outputs']
import core_worlds as cw
from persem_ros.settings.config import Config
from persem_ros.core.memory.capture import dump
from persem_ros.outputs.map import store
from test_store import frames, plain
path, rng = sys.argv[1], random.Random(5)
memory, maps = cw.core_of([]), []
for frame in frames(40):
    memory.add(cw.observations(*frame))
    maps = [*maps[-1:], dump(memory)]
expected = [plain(saved) for saved in maps]
del memory          # its reserved address space is too large to be forked
begin = time.perf_counter()
store.save(path, maps[0], Config())
duration, torn = time.perf_counter() - begin, 0
for kill in range(50):
    writer = os.fork()
    if not writer:
        while True:
            store.save(path, maps[1], Config())
            store.save(path, maps[0], Config())
    time.sleep(rng.uniform(0, 4 * duration))
    os.kill(writer, signal.SIGKILL)
    os.waitpid(writer, 0)
    torn += any(name.endswith('.partial') for name in os.listdir(os.path.dirname(path)))
    assert plain(store.load(path).saved) in expected, kill
store.save(path, maps[0], Config())
print(torn, os.listdir(os.path.dirname(path)))
"""


def test_killed_writers_leave_the_old_or_the_new_map(tmp_path):
    result = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', KILLER, str(tmp_path / 'map.persem')], cwd=ROOT,
        capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    torn, left = result.stdout.strip().split(' ', 1)
    assert int(torn) > 10           # so many of the 50 were killed in the midst of writing
    assert left == "['map.persem']"     # what they left is gone after the next save
