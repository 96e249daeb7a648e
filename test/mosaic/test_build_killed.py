"""A build of which the process that hands out the work is killed (SIGKILL), workers at work."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from persem_ros.mosaic import folder, run
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated
import pytest
import worlds

VALUES = {'memory.voxel_size': 0.05}
TILE = 1.2
pytestmark = pytest.mark.skipif(not Path('/proc/self/task').exists(), reason='/proc')


def children(pid):
    """Return the processes that a process has started and that run."""
    found = Path(f'/proc/{pid}/task/{pid}/children').read_text().split()
    return [int(child) for child in found if alive(int(child))]


def alive(pid):
    """Return whether a process runs; one that ended and that nobody has asked about does not."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


def test_workers_end_with_it_and_the_next_build_goes_on(tmp_path):
    recordings = [str(worlds.write(tmp_path / f'r{k}', n, k)) for k, n in enumerate((6, 30))]
    out, config = tmp_path / 'out', updated(Config(), VALUES)
    builder = subprocess.Popen(
        [sys.executable, '-m', 'persem_ros', 'build', *recordings, '--out', str(out), '--tile',
         str(TILE), '--workers', '2', '--set', 'memory.voxel_size=0.05'],
        stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while not list(out.glob(f'{folder.WORK}/recordings/*.json')):
        assert builder.poll() is None
        time.sleep(0.001)
    workers = children(builder.pid)
    assert len(workers) > 2             # and the one that looks after what they share
    os.kill(builder.pid, signal.SIGKILL)
    assert builder.wait() == -signal.SIGKILL and not (out / 'map.persem').exists()
    end = time.monotonic() + 20.0
    while any(map(alive, workers)):
        assert time.monotonic() < end, 'workers stayed'
        time.sleep(0.01)
    run.build(recordings, out, config, TILE, workers=1)
    assert sorted(path.name for path in out.iterdir()) == [
        'build.json', 'config.yaml', 'map.persem']
    replay(recordings, tmp_path / 'replay', config, report=False)
    assert (out / 'map.persem').read_bytes() == \
        (tmp_path / 'replay' / 'map.persem').read_bytes()
