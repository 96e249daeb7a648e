"""Maps that mean harm: refused, or safe for all that may be done to a map."""

from contextlib import closing
import dataclasses
import sqlite3

import core_worlds as cw
import numpy as np
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.living import LivingMap
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.merge import merge, without
from persem_ros.settings.config import Config, Refine
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend
import pytest
from tampering import exercise, exercise_living, export, renew, tamper


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return the path of a small refined map of several blocks."""
    rng, memory = np.random.default_rng(1), cw.core_of([])
    for t in range(12):
        seen = {tuple(voxel): (int(rng.choice(cw.IDS)), float(rng.choice(cw.SHARES)))
                for voxel in rng.integers(-9, 9, (60, 3)).tolist()}
        memory.add(cw.observations(10 ** 18 + 10 ** 8 * t, seen, [1, 2], f'camera {t % 2}'))
    refine(memory, Refine())
    path = tmp_path_factory.mktemp('map') / 'whole.persem'
    store.save(path, memory, Config(), load_legend('town'))
    return path


def test_the_whole_map_stands_all_that_is_done_to_it(whole, tmp_path):
    exercise(whole, tmp_path / 'again.persem')


@pytest.mark.parametrize('seeds', [range(k, k + 20) for k in range(0, 80, 20)], ids=str)
def test_tampered_maps_are_refused_or_safe(whole, tmp_path, seeds):
    accepted = refused = 0
    for seed in seeds:
        path = tmp_path / 'tampered.persem'
        done = tamper(whole, path, seed)
        try:
            exercise(path, tmp_path / 'again.persem')
            accepted += 1
        except PersemError as error:
            assert len(str(error)) < 600 and str(error).isprintable(), (seed, done)
            refused += 1
        except BaseException as error:
            raise AssertionError(f'seed {seed}, {done}: {error!r}') from error
    assert refused > 5 and refused + accepted == len(seeds)


def test_tampered_maps_are_attached_and_exported_or_refused(whole, tmp_path):
    outcomes = []
    for seed in range(200, 240):
        folder = tmp_path / str(seed)       # a log lies beside the file
        folder.mkdir()
        done = tamper(whole, folder / 'tampered.persem', seed)
        for use in (export, exercise_living):
            try:
                use(folder / 'tampered.persem')
                outcomes.append(use)
            except PersemError as error:
                assert len(str(error)) < 600 and str(error).isprintable(), (seed, done)
                outcomes.append(None)
            except BaseException as error:
                raise AssertionError(f'seed {seed}, {done}: {error!r}') from error
    assert {export, exercise_living, None} == set(outcomes)


def changed(path, whole, **columns):
    """Write the whole map with other columns."""
    saved = store.load(whole).saved
    store.save(path, dataclasses.replace(saved, **columns), Config())
    return path


def refusal(path):
    with pytest.raises(PersemError) as caught:
        store.load(path)
    return str(caught.value)


def test_a_block_twice(whole, tmp_path):
    path = tmp_path / 'twice.persem'
    path.write_bytes(whole.read_bytes())
    with closing(sqlite3.connect(path)) as db:
        db.executescript('CREATE TABLE b AS SELECT * FROM blocks; DROP TABLE blocks; '
                         'ALTER TABLE b RENAME TO blocks; INSERT INTO blocks SELECT * FROM blocks')
        for name in ('blocks', 'voxels', 'observations'):
            db.execute('UPDATE about SET value = 2 * value WHERE name = ?', (name,))
        db.commit()
    renew(path)
    assert 'a block twice' in refusal(path)
    with pytest.raises(PersemError, match='a block twice'):
        export(path)


def test_frames_beyond_the_frame_table(whole, tmp_path):
    frames = store.load(whole).saved.history_frame
    path = changed(tmp_path / 'm.persem', whole, history_frame=np.full_like(frames, 12))
    assert '(frames of a history)' in refusal(path)


@pytest.mark.parametrize('value', [np.nan, np.inf, -1.0, 0.0, 1.5])
def test_confidences_outside_of_0_to_1(whole, tmp_path, value):
    confidences = store.load(whole).saved.history_confidence.copy()
    confidences[7] = value
    path = changed(tmp_path / 'm.persem', whole, history_confidence=confidences)
    assert '(confidences)' in refusal(path)


@pytest.mark.parametrize('value', [5e-324, 1e-60, 1e30, -1.0])
def test_evidence_that_no_history_gives(whole, tmp_path, value):
    sums = store.load(whole).saved.evidence_sum.copy()
    sums[3] = value
    path = changed(tmp_path / 'm.persem', whole, evidence_sum=sums)
    assert '(evidence' in refusal(path) or '(majority' in refusal(path)


@pytest.mark.parametrize('value', [0.0, -1.0, float('inf'), float('nan')])
def test_sizes_that_are_none(whole, tmp_path, value):
    path = changed(tmp_path / 'm.persem', whole, voxel_size=value)
    assert 'damaged' in refusal(path)


def test_more_observations_than_frames(whole, tmp_path):
    saved = store.load(whole).saved
    many = np.full_like(saved.observations, 2 ** 32 - 2)
    path = changed(tmp_path / 'm.persem', whole, observations=many)
    assert '(observations)' in refusal(path)


def test_counters_may_be_larger_than_what_is_stored_but_not_smaller(whole, tmp_path):
    saved = store.load(whole).saved
    more = saved.starts + 5 * (saved.starts > 0)
    larger = changed(tmp_path / 'larger.persem', whole, starts=more)
    assert (store.load(larger).saved.starts == more).all()
    smaller = changed(tmp_path / 'smaller.persem', whole, starts=np.zeros_like(saved.starts))
    assert '(class counters)' in refusal(smaller)


def test_t_does_not_wrap():
    memory = cw.core_of([(1, {(0, 0, 0): (1, 1.0)}, [])])
    memory._next_t = 2 ** 31 - 1
    memory.add(cw.observations(2, {(0, 0, 0): (1, 1.0)}))
    assert memory.history((0, 0, 0))[2].tolist() == [0, 2 ** 31 - 1]
    with pytest.raises(PersemError, match='as many frames as it can number'):
        memory.add(cw.observations(3, {(0, 0, 0): (1, 1.0)}))
    assert memory.history((0, 0, 0))[2].tolist() == [0, 2 ** 31 - 1]


def programs(path, whole):
    """Write the whole map with a trigger that fills the disk, as soon as somebody writes."""
    path.write_bytes(whole.read_bytes())
    with closing(sqlite3.connect(path)) as db:
        for table in ('about', 'frames', 'blocks'):
            for event in ('INSERT', 'UPDATE', 'DELETE'):
                db.execute(f'CREATE TRIGGER {table}_{event} AFTER {event} ON {table} BEGIN '
                           'INSERT INTO about SELECT hex(randomblob(9)), zeroblob(1000) FROM '
                           'about, about, about, about, about, about, about; END')
        db.commit()
    return path


def test_a_map_whose_tables_are_programs_is_written_anew_before_it_is_written_to(whole, tmp_path):
    path = programs(tmp_path / 'm.persem', whole)
    exercise_living(path)
    with closing(sqlite3.connect(path)) as db:
        assert list(db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")) == []
    assert store.load(path).saved.session == 1


def test_links_beside_a_map_are_not_followed(whole, tmp_path):
    path, mine = tmp_path / 'm.persem', tmp_path / 'mine'
    path.write_bytes(whole.read_bytes())
    for name in ('.m.persem.lock', 'm.persem-wal', 'm.persem-journal'):
        mine.write_text('mine')
        (tmp_path / name).symlink_to(mine)
        with pytest.raises(PersemError):
            LivingMap(path, Config(), Legend)
        assert mine.read_text() == 'mine'
        (tmp_path / name).unlink()
    WriterLock(path).close()


def test_a_journal_that_a_kill_left_is_played_back_before_a_map_goes_on(whole, tmp_path):
    path = tmp_path / 'm.persem'
    path.write_bytes(whole.read_bytes())
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.executescript('PRAGMA cache_spill = 1; PRAGMA cache_size = 2; BEGIN IMMEDIATE; '
                         'UPDATE blocks SET voxels = 7, crc = 0')
        killed = tmp_path / 'killed'
        killed.mkdir()
        for name in ('m.persem', 'm.persem-journal'):
            (killed / name).write_bytes((tmp_path / name).read_bytes())
        db.execute('ROLLBACK')
    exercise_living(killed / 'm.persem')
    assert store.load(killed / 'm.persem').saved.session == 1


def test_a_voxel_twice_in_one_frame_is_not_mapped_again(whole, tmp_path):
    saved = store.load(whole).saved
    start, frames = saved.history_start, saved.history_frame.copy()
    voxel = int(np.argmax(np.diff(start)))
    frames[start[voxel]:start[voxel + 1]] = frames[start[voxel + 1] - 1]
    path = changed(tmp_path / 'm.persem', whole, history_frame=frames)
    stored = store.load(path)
    other = changed(tmp_path / 'other.persem', whole)
    memory = store.load(other).memory()
    memory.frames.sessions[0] = dataclasses.replace(
        memory.frames.sessions[0], uuid='01234567-89ab-cdef-0123-456789abcdef')
    store.save(other, memory, Config())
    with pytest.raises(PersemError, match='a voxel twice in one frame'):
        merge([store.load(other), stored], by_id=True)
    with pytest.raises(PersemError, match='no other session'):
        without(stored, 0)


def test_origins_too_far_apart_for_one_map(whole, tmp_path):
    far = store.load(changed(tmp_path / 'm.persem', whole, origin=(1e14, 0.0, 0.0)))
    with pytest.raises(PersemError, match='cannot be one map'):
        merge([store.load(whole), far])
