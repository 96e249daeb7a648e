"""A dask cluster on loopback, for tests that hand it work."""

import json
import os
from pathlib import Path
import subprocess
import sys
import time

import pytest

DASK = ('from distributed.cli import dask_scheduler, dask_worker; import sys; '
        'getattr(sys.modules[f"distributed.cli.dask_{sys.argv[1]}"], "main")(sys.argv[2:])')


def dask(folder, *words):
    """Start a scheduler or a worker; return its process."""
    return subprocess.Popen(
        [sys.executable, '-c', DASK, *words, '--no-dashboard'], stderr=subprocess.DEVNULL,
        cwd=folder, env={**os.environ, 'PYTHONPATH': str(Path(__file__).resolve().parents[1])})


@pytest.fixture(scope='module')
def scheduler(tmp_path_factory):
    """Yield (address, file) of a scheduler on loopback, without workers."""
    pytest.importorskip('distributed')
    folder = tmp_path_factory.mktemp('scheduler')
    where = folder / 'scheduler.json'
    process = dask(folder, 'scheduler', '--host', '127.0.0.1', '--port', '0', '--scheduler-file',
                   str(where), '--idle-timeout', '300 s')       # should nobody live to kill it
    try:
        for _ in range(600):
            if where.exists() and where.stat().st_size:
                break
            time.sleep(0.1)
        yield json.loads(where.read_text())['address'], where
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def workers(scheduler, tmp_path):
    """Yield the processes of two workers of the scheduler; afterwards it has none."""
    from distributed import Client
    address, where = scheduler
    processes = [dask(tmp_path, 'worker', '--scheduler-file', str(where), '--nthreads', '1',
                      '--no-nanny', '--death-timeout', '60',
                      '--local-directory', str(tmp_path)) for _ in range(2)]
    try:
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
        with Client(address, set_as_default=False) as client:
            while client.scheduler_info()['workers']:
                time.sleep(0.1)
