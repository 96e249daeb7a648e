"""A map in a database: what left memory comes back, whole after whatever end."""

from contextlib import closing
import ctypes
from dataclasses import replace
import os
import resource
import signal
import sqlite3
import sys
import warnings

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.frame.clear import clear
from persem_ros.core.geometry.method import relabel
from persem_ros.core.memory.paging import Pager
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.explain import explain
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.snapshot import take
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine, refine_all
from persem_ros.errors import PersemError
from persem_ros.frames import Frame, pinhole
from persem_ros.outputs.map import store
from persem_ros.outputs.map.living import LivingMap
from persem_ros.settings.config import Config, Memory, Refine, updated
from persem_ros.settings.legend import Legend
import pytest
from test_store import plain

PTRACE = ctypes.CDLL(None, use_errno=True).ptrace
PTRACE.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
KILLS = int(os.environ.get('PERSEM_KILLS', '12'))
SETTINGS = replace(Refine(), min_observations=1)


def opened(path):
    """Return a LivingMap and its Pager."""
    living = LivingMap(path, Config(), Legend)
    return living, Pager(living.memory(), living)


def flight(seed, n=20):
    """Return the Observations of a flight back and forth along x, 6 x 6 columns wide."""
    rng, found = np.random.default_rng(seed), []
    for t in range(n):
        x = int(30 * abs(((t / 9) + 1) % 2 - 1)) - 8
        voxels = rng.integers((x, -3, 0), (x + 12, 9, 3), (40, 3))
        found.append(cw.observations(10 ** 18 + t * 10 ** 8, {
            tuple(v): (int(rng.choice(cw.IDS[:4])), float(rng.choice(cw.EXACT)))
            for v in voxels.tolist()}))
    return found


def step(memory, settings):
    """Run the refinement that is next in turn."""
    job = begin_next(memory, settings)
    finish(job, *job.compute())


def looked(memory, one):
    """Have a memory look through the left half of what it sees, from 20 m above."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = one.voxels[0] * 0.5 + (0.0, 0.0, 20.0)
    depth = np.full((24, 32), 90.0)
    depth[:, 16:] = np.nan
    camera = pinhole(32, 24, 48.0, 48.0, 15.5, 11.5)
    frame = Frame(10 * one.stamp, np.zeros((24, 32), np.int32), depth, camera, T)
    clear(memory, frame, Memory(clear_after=2))


def mapped(pager, seen, settings, rng, bound):
    """Map some Observations with a bound on memory; return the largest number of voxels."""
    memory, most = pager.memory, 0
    for one in seen:
        pager.need_voxels(one.voxels)
        memory.add(one)
        looked(memory, one)
        most = max(most, memory.n_voxels)
        if rng.random() < 0.4:
            step(memory, settings)
        if rng.random() < 0.3 or pager.dirty_voxels > bound:
            pager.save()
        pager.let_go(one.voxels.mean(axis=0) * 0.5, bound)
    return most


@cw.examples(max_examples=8)
@given(cw.seeds, st.sampled_from([60, 150, 10 ** 6]), st.sampled_from([6, 26]),
       st.sampled_from(['persem', 'recency', 'history', 'geometry', 'geometry']))
def test_a_run_that_paged_equals_one_that_never_did(tmp_path_factory, seed, bound, neighbours,
                                                    method):
    with pytest.MonkeyPatch.context() as patch:
        cw.tiny_pages(patch, 2)
        path = tmp_path_factory.mktemp('map') / 'map.persem'
        compared(path, seed, bound, replace(SETTINGS, neighbours=neighbours, method=method))


def compared(path, seed, bound, settings):
    """Map a flight into a file, and beside it into memory."""
    rng, method = np.random.default_rng(seed), settings.method
    living, pager = opened(path)
    straight, seen = VoxelMemory(0.5), flight(seed)
    straight.new_session()
    for one in seen:
        straight.add(one)
        looked(straight, one)
    most = mapped(pager, seen[:12], settings, rng, bound)
    pager.save()
    living.close()                      # and another day, in the same session
    living, pager = opened(path)
    pager.memory.session -= 1
    pager.memory.resume(pager.memory.frames, pager.memory.session)
    most = max(most, mapped(pager, seen[12:], settings, rng, bound))
    refine(straight, settings)
    visited = sum(refine_all(pager.memory, settings, bound, int(rng.choice([3, 64, 1000]))))
    pager.save()
    living.close()
    gone = np.count_nonzero(straight.m.voxels['gone'][:straight.n_numbers])
    assert 0 < gone < straight.n_voxels and visited == straight.n_voxels - gone
    assert bound == 10 ** 6 or most < straight.n_voxels
    assert sorted(p.name for p in path.parent.iterdir()) == ['map.persem']
    saved = store.load(path).saved
    assert plain(saved) == plain(straight) and bool(saved.habits) == (method == 'geometry')


def test_the_file_is_not_asked_twice_for_what_it_does_not_have(tmp_path, monkeypatch):
    living, pager = opened(tmp_path / 'map.persem')
    asked, read = [], living.read
    monkeypatch.setattr(living, 'read', lambda index: (asked.append(len(index)), read(index))[1])
    one = flight(2, 1)[0]
    for _ in range(2):
        pager.need_voxels(one.voxels)
    assert len(asked) == 1
    pager.memory.add(one)
    pager.save()
    pager.let_go((1e6, 0.0, 0.0), 0, 1.0)       # what was not there then is now
    assert pager.memory.n_voxels == 0
    pager.need_voxels(one.voxels)
    assert len(asked) == 2 and pager.memory.n_voxels == len(one.voxels)
    living.close()


def test_a_refinement_begins_without_a_look_at_the_file_but_for_the_newest_frame(
        tmp_path, monkeypatch):
    living, pager = opened(tmp_path / 'map.persem')
    seen, asked, read = flight(3, 12), [], living.read
    monkeypatch.setattr(living, 'read', lambda index: (asked.append(len(index)), read(index))[1])
    ahead = []
    for k, one in enumerate(seen):
        pager.need_voxels(one.voxels)
        pager.memory.add(one)
        if k in (0, 6):
            pager.need_voxels(one.voxels)       # as for the image that is sent
            asked.clear()
            step(pager.memory, SETTINGS)
            ahead.append(sum(asked))
    assert ahead[0] > 0 == ahead[1]
    living.close()


def test_a_full_refinement_reads_each_block_once_where_rows_fit(tmp_path, monkeypatch):
    rng, path = np.random.default_rng(5), tmp_path / 'map.persem'
    living, pager = opened(path)
    rows = np.stack(np.meshgrid(np.arange(0, 96, 4), np.arange(0, 96, 4), [0], indexing='ij'), -1)
    one = cw.observations(10 ** 18, {tuple(v): (int(rng.choice(cw.IDS[:4])), 1.0)
                                     for v in rows.reshape(-1, 3).tolist()})
    pager.memory.add(one)
    pager.save()
    pager.let_go((0.0, 0.0, 0.0), 1)
    assert pager.memory.n_voxels < 10
    found, read = [], living.read

    def noted(index):
        blocks = read(index)
        found.extend(map(tuple, blocks.block_index.tolist()))
        return blocks
    monkeypatch.setattr(living, 'read', noted)
    visited = sum(refine_all(pager.memory, SETTINGS, 250, 7))      # 48 voxels a row of blocks
    assert visited == 24 ** 2 and len(found) <= 144 == len(set(found))
    living.close()


def test_a_refinement_that_somebody_else_saves_lets_go_of_what_he_has(tmp_path, monkeypatch):
    living, pager = opened(tmp_path / 'map.persem')
    seen, sizes = flight(6, 12), []
    for one in seen:
        pager.need_voxels(one.voxels)
        pager.memory.add(one)
    pager.save()
    saves, steps = [], refine_all(pager.memory, SETTINGS, 60, 2, saves=False)
    monkeypatch.setattr(pager, 'save', lambda: saves.append(1))
    whole, visited = pager.memory.n_voxels, next(steps)
    for n in steps:
        visited += n
        sizes.append(pager.memory.n_voxels)
        checkpoint = pager.checkpoint()     # what a node does when memory is crowded
        checkpoint.capture.step(np.inf)
        checkpoint.write()
        checkpoint.end()
    assert visited == whole and min(sizes) < whole and not saves
    living.close()


def at(frames):
    """Return what a map holds after some frames, without refinement."""
    memory = VoxelMemory(0.5)
    memory.new_session()
    for one in frames:
        memory.add(one)
    return plain(memory)


def kill_after(calls, child):
    """Run child() in a process that is killed after some system calls; False: it had ended."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')         # of threads that the child does not use
        pid = os.fork()
    if pid == 0:
        try:
            PTRACE(0, 0, None, None)            # PTRACE_TRACEME
            os.kill(os.getpid(), signal.SIGSTOP)
            jit.work_alone()
            child()
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
    for _ in range(calls):
        PTRACE(24, pid, None, None)             # PTRACE_SYSCALL: on to the next stop
        if os.WIFEXITED(os.waitpid(pid, 0)[1]):
            return False
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return True


@pytest.mark.skipif(sys.platform != 'linux', reason='ptrace')
def test_killed_between_any_two_system_calls_it_holds_a_state_of_the_last_checkpoints(tmp_path):
    seen, rng = flight(3, 12), np.random.default_rng(int(os.environ.get('PERSEM_SEED', '1')))
    states = {n: at(seen[:n]) for n in range(0, 13, 2)}
    opened(tmp_path / 'fresh.persem')[0].close()
    fresh = (tmp_path / 'fresh.persem').read_bytes()
    calls, killed, reached = 2500, 0, set()
    while killed < KILLS:
        path = tmp_path / f'map{killed}.persem'
        path.write_bytes(fresh)
        told, tell = os.pipe()

        def child():
            living, pager = opened(path)
            living._writer.execute('PRAGMA wal_autocheckpoint = 8')     # the log's end, too
            for n in range(0, 12, 2):
                for one in seen[n:n + 2]:
                    pager.need_voxels(one.voxels)
                    pager.memory.add(one)
                pager.save()
                os.write(tell, bytes([n + 2]))
                pager.let_go((0.0, 0.0, 0.0), 50)
            living.close()
        killing = kill_after(int(rng.integers(1, calls)), child)
        os.close(tell)
        with open(told, 'rb') as file:
            promised = max(file.read(), default=0)
        if not killing:
            calls = max(100, int(calls * 0.9))
            continue
        killed += 1
        found = plain(store.load(path).saved)
        n = len(found['frames'])
        reached.add(n)
        assert n in (promised, promised + 2)
        assert {**found, 'session': 0} == {**states[n], 'session': 0}
        living, pager = opened(path)            # and mapping goes on
        pager.need_voxels(seen[-1].voxels)
        pager.memory.add(seen[-1])
        pager.save()
        living.close()
        assert len(store.load(path).saved.frames) == n + 1
    assert len(reached) > 2


def test_a_full_disk_loses_nothing_and_mapping_goes_on_when_there_is_room(tmp_path):
    path, seen = tmp_path / 'map.persem', flight(5, 12)
    living, pager = opened(path)
    memory = pager.memory
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    failed = 0
    for k, one in enumerate(seen):
        pager.need_voxels(one.voxels)
        memory.add(one)
        if 4 <= k < 9:
            room = sum(p.stat().st_size for p in tmp_path.iterdir() if 'wal' in p.name)
            resource.setrlimit(resource.RLIMIT_FSIZE, (room + 5000 * (k - 4), hard))
        try:
            pager.save()
        except PersemError as error:
            failed += 1
            assert f'{path} cannot be written (' in str(error)
            assert pager.dirty_voxels > 0
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert len(store.load(path).saved.frames) == (k + 1 if not pager.dirty_voxels else 4)
        pager.let_go(one.voxels.mean(axis=0) * 0.5, 60)
    assert failed >= 2 and pager.dirty_voxels == 0
    living.close()
    assert plain(store.load(path).saved) == at(seen)


def test_it_is_read_beside_the_writer_and_written_by_one(tmp_path):
    path, seen = tmp_path / 'map.persem', flight(7, 4)
    living, pager = opened(path)
    for k, one in enumerate(seen):
        pager.memory.add(one)
        pager.save()
        assert len(store.load(path).saved.frames) == k + 1
    with pytest.raises(PersemError, match=rf'is being written by .* \(process {os.getpid()}\); '
                                          'end that first, or give another map.path'):
        opened(path)
    living.close()
    opened(path)[0].close()


def test_a_damaged_block_is_named_and_the_rest_lives(tmp_path, caplog):
    path, seen = tmp_path / 'map.persem', flight(9, 6)
    living, pager = opened(path)
    for one in seen:
        pager.memory.add(one)
    pager.save()
    living.close()
    with closing(sqlite3.connect(path)) as db:
        x, y, z = db.execute('SELECT x, y, z FROM blocks').fetchone()
        db.execute('UPDATE blocks SET crc = crc + 1 WHERE x=? AND y=? AND z=?', (x, y, z))
        db.commit()
    living, pager = opened(path)
    pager.need(living.index())
    assert f'block ({x}, {y}, {z}) is damaged (checksum' in caplog.text
    assert len(living.index()) == pager.memory.n_blocks + 1
    assert sum(refine_all(pager.memory, SETTINGS)) == pager.memory.n_voxels
    for one in seen:            # its place is mapped anew: the file is whole again
        pager.need_voxels(one.voxels)
        pager.memory.add(one)
    pager.save()
    living.close()
    assert store.load(path).memory().n_voxels == pager.memory.n_voxels == living.voxels


def test_other_voxels_and_other_files_are_refused(tmp_path):
    path = tmp_path / 'map.persem'
    opened(path)[0].close()
    with pytest.raises(PersemError, match='was made with memory.voxel_size 0.5, now it is 0.2'):
        LivingMap(path, updated(Config(), {'memory.voxel_size': 0.2}), Legend)
    path.write_bytes(b'no map')
    for _ in range(2):          # and the lock is given back
        with pytest.raises(PersemError, match='not a map file'):
            opened(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['map.persem']


def test_a_map_without_a_frame_is_saved(tmp_path):
    living, pager = opened(tmp_path / 'map.persem')
    pager.save()
    living.close()
    saved = store.load(tmp_path / 'map.persem').saved
    assert not len(saved.frames) and not len(saved.cell)


@pytest.mark.parametrize('form', ['dense', 'sparse'])
def test_geometry_by_kept_parameters(tmp_path, monkeypatch, form):
    if form == 'sparse':
        for module in ('method', 'looks', 'totals'):
            monkeypatch.setattr(f'persem_ros.core.geometry.{module}.MOST_DENSE', 0)
        monkeypatch.setattr('persem_ros.core.refine.gathered.MOST_DENSE', 0)
        monkeypatch.setattr('persem_ros.core.refine.fitting.KEPT', 5000)
    settings, seen = replace(SETTINGS, method='geometry', sweep=60), flight(4, 20)
    path = tmp_path / 'map.persem'
    living, pager = opened(path)
    mapped(pager, seen[:12], settings, np.random.default_rng(1), 100)
    list(refine_all(pager.memory, settings, 100))
    fitted, straight = pager.memory.geometry.arrays(), VoxelMemory(0.5)
    for one in seen[:12]:
        straight.add(one)
        looked(straight, one)
    refine(straight, settings)
    assert {name: a.tolist() for name, a in fitted.items()} == {
        name: a.tolist() for name, a in straight.geometry.arrays().items()}
    pager.save()
    living.close()
    living, pager = opened(path)        # another day: they are in the file
    memory = pager.memory
    held = 0
    for k, one in enumerate(seen[12:]):
        pager.need_voxels(one.voxels)
        memory.add(one)
        job = begin_next(memory, settings)
        found, whole = job.compute(), take(memory)
        if k == 0:
            known = found.parameters.arrays()
            assert all((known[name] == fitted[name]).all() for name in ('pi', 'rho', 'fine'))
        rows = whole.row[job.snapshot.number[:job.snapshot.refined]] - 1
        assert len(rows) and rows.min() >= 0
        here = relabel(memory, replace(whole, relief=None), settings, found.parameters)
        if k > 4:           # all of it is in memory
            held += len(rows)
            assert (found.labels == here.labels[rows]).all()
            assert (found.posterior == here.posterior[rows]).all()
        finish(job, *found)
        explained = explain(memory, one.voxels[0], settings)
        assert explained['label'] == explained['stored_label']
        pager.save()
        pager.let_go((1e9, 0.0, 0.0), 90 if k < 4 else 0)
        if k == 4:
            pager.need(pager.index())
    assert held and memory.geometry.pi.tolist() != fitted['pi'].tolist()    # sweeps did that
    known = memory.geometry.arrays()['cells'].tolist()
    assert all(cell in known for cell in fitted['cells'].tolist())
    living.close()
