"""Fixtures: a colcon-built workspace, a domain for each test, a client, the node."""

import itertools
import os
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticArray
import pytest

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.path[:0] = [os.path.dirname(os.path.abspath(__file__)), os.path.join(ROOT, 'test'),
                os.path.join(ROOT, 'test', 'inputs'), os.path.join(ROOT, 'test', 'preflight')]

import harness                          # noqa: E402, I100, I201 - beside this file

# Nothing leaves this machine, and runs beside each other do not hear each other.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('CYCLONEDDS_URI', '<CycloneDDS><Domain><General><Interfaces>'
                      '<NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
                      '</Domain></CycloneDDS>')
# Twenty domains from ROS_DOMAIN_ID on, one after the other; without it, from somewhere on.
_first = int(os.environ.get('ROS_DOMAIN_ID') or 1 + 20 * (os.getpid() % 4))
_domains = itertools.cycle(range(_first, _first + 20))


class Ros:
    """
    One test's part of the world.

    Parameters
    ----------
    env : dict
        Environment of processes, with the workspace.
    folder : Path
        For logs.

    """

    def __init__(self, env, folder):
        """Take a domain and join it."""
        self.domain = next(_domains)
        self.folder = folder
        self.env = {**env, 'ROS_DOMAIN_ID': str(self.domain), 'ROS_LOG_DIR': str(folder / 'ros')}
        self.client = harness.Client(self.domain)
        self.diagnostics = self.client.listen(DiagnosticArray, '/diagnostics')
        self._started = []

    def log(self, name):
        """Return a file for a process's output."""
        return self.folder / f'{name}-{len(self._started)}.log'

    def run(self, *command):
        """Start a command; it is ended with the test."""
        self._started.append(harness.Process(list(command), self.env, self.log(command[-1].replace(
            os.sep, '_')[-40:])))
        return self._started[-1]

    def mapper(self, settings=(), arguments=(), start=()):
        """Start the node; it is ended with the test."""
        self._started.append(harness.Mapper(self, settings, arguments, start))
        return self._started[-1]

    def close(self):
        """End everything."""
        for process in self._started:
            if process.running:
                process.kill()
        self.client.close()


@pytest.fixture(scope='session')
def workspace():
    """Return the environment of a workspace that colcon has built, kernels compiled."""
    folder = os.path.join(ROOT, 'build', 'ros-test')
    os.makedirs(folder, exist_ok=True)
    open(os.path.join(ROOT, 'build', 'COLCON_IGNORE'), 'w').close()
    subprocess.run([sys.executable, '-m', 'colcon', 'build', '--symlink-install', '--base-paths',
                    ROOT, '--packages-select', 'persem_ros'], cwd=folder, check=True,
                   stdout=subprocess.DEVNULL)
    script = f'source {folder}/install/setup.bash && env -0'
    output = subprocess.run(['bash', '-c', script], check=True, capture_output=True).stdout
    env = dict(line.split('=', 1) for line in output.decode().split('\0') if '=' in line)
    # The same files, by the path that the tests know them by: kernels are kept by path.
    env['PYTHONPATH'] = f'{ROOT}{os.pathsep}{env["PYTHONPATH"]}'
    subprocess.run([sys.executable, '-c',
                    'from persem_ros.core.warmup import warm_up; warm_up()'],
                   env=env, check=True, timeout=600)
    return env


@pytest.fixture
def ros(workspace, tmp_path):
    """Give a test its Ros."""
    world = Ros(workspace, tmp_path)
    try:
        yield world
    finally:
        world.close()
