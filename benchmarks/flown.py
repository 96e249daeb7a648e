"""A recording flown live: `ros2 bag play` sends it, the node maps it into an attached file."""

from contextlib import ExitStack
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import time

from persem_ros.errors import PersemError

TOPICS = ('/semantic/image', '/depth/image', '/depth/camera_info', '/pose', '/tf_static',
          '/semantic/legend')
RELIABLE = tuple(f'qos.{name}=reliable' for name in ('labels', 'depth', 'camera_info', 'pose'))
DELAY = 5.0         # s before the first message, for all to find each other
SILENCE = 3.0       # s without an image after which all have been answered
PATIENCE = 600.0    # s for what never comes
STAMP = re.compile(r'sec: (\d+)\nnanosec: (\d+)\n')


def check():
    """Refuse where there is no ROS, or not this package in it."""
    if shutil.which('ros2') is None:
        raise PersemError('--node needs ROS 2: make night-live ROS_SETUP=/opt/ros/jazzy/setup.bash'
                          ' builds this package in it; where there is no ROS, leave --node out')
    if subprocess.run(['ros2', 'pkg', 'prefix', 'persem_ros'], capture_output=True).returncode:
        raise PersemError('--node finds no persem_ros in ROS: make night-live builds it, or colcon'
                          ' build --packages-select persem_ros; then source install/setup.bash')


def until(condition, what):
    """Return the first true value of condition()."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.05)
    raise PersemError(f'{what}: not within {PATIENCE:.0f} s')


class Command:
    """
    A command in a process group of its own, which is gone when a block ends.

    Parameters
    ----------
    words : sequence
    log : Path
        Of what it prints.

    """

    def __init__(self, words, log):
        """Start it."""
        self.log = log
        with open(log, 'wb') as out:
            self.process = subprocess.Popen(
                list(map(str, words)), stdout=out, stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_interruptible,
                env={**os.environ, 'PYTHONUNBUFFERED': '1'})

    def __enter__(self):
        """Begin the block."""
        return self

    def __exit__(self, *_):
        """Kill what is left."""
        self.signal(signal.SIGKILL)

    @property
    def output(self):
        """Return what it has printed."""
        return self.log.read_text(errors='replace')

    def signal(self, number):
        """Send a signal to all of it; return how it ended where that ends it."""
        try:
            os.killpg(self.process.pid, number)
        except ProcessLookupError:
            pass
        return self.process.wait(PATIENCE)

    def says(self, words):
        """Wait until it has printed some words."""
        until(lambda: words in self.output or self.process.poll() is not None, words)
        if words not in self.output:
            raise PersemError(f'{self.log}: it ended before it said {words!r}')


def node(values, log):
    """Return the started node, which maps by now."""
    options = [word for value in (*values, *RELIABLE)
               for word in ('-p', value.replace('=', ':=', 1))]
    found = Command(['ros2', 'run', 'persem_ros', 'mapper', '--ros-args', *options], log)
    found.says(': ready')
    return found


def newest(heard):
    """Return the newest stamp of the images that came, ns; 0: none."""
    return max((int(s) * 10 ** 9 + int(ns) for s, ns in STAMP.findall(heard.output)), default=0)


def peak(command):
    """Return the largest memory that a process of a running command had, MB."""
    pids = subprocess.run(['pgrep', '-g', str(command.process.pid)], capture_output=True,
                          text=True).stdout.split()
    states = [Path(f'/proc/{pid}/status').read_text() for pid in pids]
    return max(int(kb) for text in states for kb in re.findall(r'VmHWM:\s+(\d+)', text)) / 1024


def called(service):
    """Return what a service of the node answers."""
    done = subprocess.run(['ros2', 'service', 'call', f'/mapper/{service}',
                           'std_srvs/srv/Trigger'], capture_output=True, text=True, check=True)
    found = re.search(r"success=(\w+), message='([^']*)'", done.stdout)
    if found is None or found[1] != 'True':
        raise PersemError(f'~/{service}: {done.stdout.strip()}')
    return found[2]


def flown(recording, values, folder, rate=1.0, after=0.0, killed=None):
    """
    Fly a recording into the map file of the node's settings; return its peak, MB.

    Parameters
    ----------
    recording : Path
        A rosbag2 folder.
    values : sequence of str
        NAME=VALUE, as of --set; with map.path and map.attached.
    folder : Path
        For what the processes print.
    rate : float
        Seconds of the flight a second.
    after : float
        Seconds from the first answer to the node's end by SIGKILL, and its next start, while the
        flight goes on; 0: none.
    killed : callable, optional
        killed(status, stamp) is called between the two, with the newest stamp that was answered.

    """
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as ends:
        mapper = ends.enter_context(node(values, folder / 'mapper.log'))
        heard = ends.enter_context(Command(
            ['ros2', 'topic', 'echo', '/mapper/labels', 'sensor_msgs/msg/Image', '--field',
             'header.stamp', '--qos-reliability', 'reliable'], folder / 'labels.log'))
        player = ends.enter_context(Command(
            ['ros2', 'bag', 'play', recording, '--delay', DELAY, '--rate', rate, '--topics',
             *TOPICS], folder / 'play.log'))
        until(lambda: newest(heard) or player.process.poll() is not None, 'the first image')
        if after:
            time.sleep(after)
            status = mapper.signal(signal.SIGKILL)
            killed(status, newest(heard))
            mapper = ends.enter_context(node(values, folder / 'mapper-again.log'))
        player.process.wait()
        before = 0
        while newest(heard) > before:
            before = newest(heard)
            time.sleep(SILENCE)
        print(f'~/refine: {called("refine")}\n~/save_map: {called("save_map")}')
        used = peak(mapper)
        mapper.signal(signal.SIGINT)
        mapper.says('saved ')
    return used


def _interruptible():
    """Let SIGINT reach a child of a shell that started us in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
