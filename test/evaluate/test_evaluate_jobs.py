"""Work side by side: the same results in one process, in several, and on a cluster."""

import multiprocessing
import sys
import threading
import time

import numpy as np
from persem_ros import cli, cluster
from persem_ros.errors import PersemError
from persem_ros.evaluate.work import jobs
from persem_ros.evaluate.work.task import Task
from persem_ros.settings.config import Config
import pytest
import worlds


@pytest.fixture(scope='module')
def tasks(tmp_path_factory):
    base = tmp_path_factory.mktemp('recordings')
    return [Task(str(worlds.write(base / f'r{seed}', seed=seed, frames=8)), Config(),
                 pictures=seed == 0) for seed in range(4)]


@pytest.fixture(scope='module')
def expected(tasks):
    return by_place(jobs.results(tasks, 1))


def by_place(results):
    return {place: (summary, arrays) for place, summary, arrays in results}


def same(a, b):
    """Whether two results are equal, times and memory aside."""
    assert set(a) == set(b)
    for place in a:
        one, two = ({k: v for k, v in r[place][0].items() if k != 'runtime'} for r in (a, b))
        assert one == two
        assert set(a[place][1]) == set(b[place][1])
        for key, array in a[place][1].items():
            np.testing.assert_array_equal(array, b[place][1][key], key)


@pytest.mark.parametrize('workers', [1, 2])
def test_processes_give_the_same_and_a_failure_does_not_stop_the_others(
        tasks, expected, tmp_path, workers):
    broken = Task(str(worlds.write(tmp_path / 'empty', frames=0)), Config())
    found = {}
    with pytest.raises(PersemError, match=r'empty.*1 of 5 failed'):
        for place, *result in jobs.results([*tasks[:1], broken, *tasks[1:]], workers):
            found[place - (place > 1)] = tuple(result)
    same(found, expected)


def test_a_worker_that_dies_is_said(tasks):
    def kill_one():
        while not multiprocessing.active_children():
            time.sleep(0.02)
        multiprocessing.active_children()[0].kill()

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    with pytest.raises(PersemError, match='a worker died'):
        by_place(jobs.results(tasks * 3, 2))
    killer.join()


def test_no_scheduler_there(tasks, capsys, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr(cluster, 'PATIENCE', 1)
    words = ['evaluate', tasks[0].recording, '--scheduler', 'tcp://127.0.0.1:9']
    assert cli.main(words) == 1
    error = capsys.readouterr().err.splitlines()
    assert 'no scheduler answers there' in error[-1]


def test_cluster_is_an_extra(tasks, monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(PersemError, match=r"pip install '\.\[cluster\]'"):
        by_place(jobs.results(tasks, scheduler='tcp://127.0.0.1:9'))


def test_cluster_gives_the_same_though_a_worker_dies(scheduler, workers, tasks, expected):
    found = {}
    for place, summary, arrays in jobs.results(tasks, scheduler=scheduler[0]):
        if not found:
            workers[0].kill()       # in the midst of its next task
        found[place] = summary, arrays
    assert workers[0].wait(10) != 0
    same(found, expected)


def test_a_cluster_without_workers(scheduler, tasks):
    with pytest.raises(PersemError, match='has no workers'):
        by_place(jobs.results(tasks, scheduler=scheduler[0]))
