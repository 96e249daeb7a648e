"""A build on a dask cluster of two processes on loopback, one of which is killed."""

import threading
import time

from persem_ros import cli, cluster
from persem_ros.mosaic import folder, run
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated
import pytest
import worlds

CONFIG = updated(Config(), {'memory.voxel_size': 0.05})


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    base = tmp_path_factory.mktemp('recordings')
    return [str(worlds.write(base / f'r{k}', 40, k)) for k in range(4)]


def test_a_worker_that_is_killed_costs_its_task(scheduler, workers, recordings, tmp_path):
    replay(recordings, tmp_path / 'replay', CONFIG, report=False)
    out = tmp_path / 'build'

    def kill_one():
        while not list(out.glob(f'{folder.WORK}/recordings/*.json')):
            time.sleep(0.01)
        workers[0].kill()       # in the midst of its second recording

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    run.build(recordings, out, CONFIG, 1.2, scheduler=scheduler[0])
    killer.join(10)
    assert workers[0].wait(10) != 0
    assert (out / 'map.persem').read_bytes() == \
        (tmp_path / 'replay' / 'map.persem').read_bytes()


def test_a_cluster_without_workers(scheduler, recordings, tmp_path, capsys):
    words = ['build', recordings[0], '--out', str(tmp_path / 'out'), '--scheduler', scheduler[0]]
    assert cli.main(words) == 1
    assert 'it has no workers; start some with: dask worker' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_no_scheduler_there(recordings, tmp_path, capsys, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr(cluster, 'PATIENCE', 1)
    assert cli.main(['build', recordings[0], '--out', str(tmp_path / 'out'), '--scheduler',
                     'tcp://127.0.0.1:9']) == 1
    assert 'no scheduler answers there' in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / 'out').exists()
