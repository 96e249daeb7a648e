"""What the tests of the node share: the node in a process of its own, and a client beside it."""

from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import threading
import time

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from std_srvs.srv import Trigger

ROOT = Path(__file__).resolve().parents[2]
LONG = 120.0        # s: a bound for what never comes, not how long anything takes
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
# What the small recordings of test/bags.py need: voxels of the size of their stripes, nothing
# lost on the way, patience with a busy machine.
SETTINGS = {'memory.voxel_size': 0.1, 'qos.labels': 'reliable', 'qos.depth': 'reliable',
            'qos.camera_info': 'reliable', 'qos.pose': 'reliable', 'qos.queue': 200,
            'sync.max_wait': 20.0, 'sync.queue': 60.0}


def until(condition, what, timeout=LONG, step=0.02):
    """Return the first true value of condition(); fail with *what* after *timeout* seconds."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(step)
    raise AssertionError(f'not within {timeout:.0f} s: {what() if callable(what) else what}')


def _interruptible():
    """Let SIGINT reach a child also where a shell has started us in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Process:
    """
    A command in a process group of its own, with its output in a file.

    Parameters
    ----------
    command : list of str
    env : dict
    log : Path

    """

    def __init__(self, command, env, log):
        """Start it."""
        self.log = log
        with open(log, 'wb') as out:
            self._process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT,
                                             stdin=subprocess.DEVNULL, env=env,
                                             start_new_session=True, preexec_fn=_interruptible)

    @property
    def output(self):
        """Return all that it has printed."""
        return self.log.read_text(errors='replace')

    @property
    def running(self):
        """Return whether it is still there."""
        return self._process.poll() is None

    def wait(self, timeout=LONG):
        """Return its exit status."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(f'still running:\n{self.output}') from None

    def signal(self, number):
        """Send a signal to it and its children."""
        try:
            os.killpg(self._process.pid, number)
        except ProcessLookupError:
            pass

    def stop(self):
        """Interrupt it as Ctrl-C would; return its exit status."""
        if self.running:
            self.signal(signal.SIGINT)
        try:
            return self._process.wait(60)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self._process.wait(10)
            raise AssertionError(f'did not end:\n{self.output}') from None

    def kill(self):
        """End it without a chance to save anything."""
        self.signal(signal.SIGKILL)
        self._process.wait(10)


class Client:
    """
    A node of the test beside the one under test, spinning on a thread.

    Parameters
    ----------
    domain : int
        ROS_DOMAIN_ID.

    """

    def __init__(self, domain):
        """Join the domain."""
        self._context = Context()
        self._context.init(domain_id=domain)
        self.node = Node('client', context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self):
        """Leave the domain."""
        self._executor.shutdown()
        self._thread.join(10)
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self, cls, topic, qos=RELIABLE):
        """Return a list that fills with the messages of a topic."""
        found = []
        self.node.create_subscription(cls, topic, found.append, qos)
        return found

    def publisher(self, cls, topic, qos=RELIABLE, readers=1):
        """Return a publisher that *readers* subscriptions have found."""
        out = self.node.create_publisher(cls, topic, qos)
        until(lambda: out.get_subscription_count() >= readers, f'nobody listens to {topic}')
        return out

    def call(self, service, cls=Trigger, request=None):
        """Call a service and return its response."""
        client = self.node.create_client(cls, service)
        assert client.wait_for_service(LONG), f'{service} is not there'
        future = client.call_async(request or cls.Request())
        until(future.done, f'{service} does not answer')
        self.node.destroy_client(client)
        return future.result()

    def _spin(self):
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass


class Mapper(Process):
    """
    The node, started as a launch file does: `ros2 run` would not pass SIGTERM on.

    Parameters
    ----------
    ros : test.ros.conftest.Ros
    settings : dict
        Parameters besides SETTINGS.
    arguments : sequence of str
        Further ROS arguments.
    start : sequence of str, optional
        Another command that starts it.

    """

    def __init__(self, ros, settings=(), arguments=(), start=()):
        """Start it; it is not ready yet."""
        options = [word for name, value in {**SETTINGS, **dict(settings)}.items()
                   for word in ('-p', f'{name}:={text(value)}')]
        super().__init__([*(start or [executable(ros.env)]), '--ros-args', *options,
                          *arguments], ros.env, ros.log('mapper'))
        self._client = ros.client
        self._seen = ros.diagnostics

    def ready(self):
        """Wait until it maps; return itself."""
        self._seen.clear()
        # Its own word, too: diagnostics may be those of another node in this domain.
        until(lambda: self.values().get('message', 'compiling the kernels')
              != 'compiling the kernels' and ': ready' in self.output or not self.running,
              lambda: f'the node is not ready:\n{self.output}')
        assert self.running, self.output
        return self

    def values(self):
        """Return the newest diagnostics as {key: value}, with 'message'; {} before the first."""
        for array in reversed(self._seen):
            for status in array.status:
                if status.name.endswith('mapper: mapping'):
                    return {'message': status.message, **{v.key: v.value for v in status.values}}
        return {}

    def frames(self, count):
        """Wait until the node has integrated *count* frames."""
        until(lambda: int(self.values().get('frames', 0)) >= count,
              lambda: f'{count} frames: {self.values()}\n{self.output}')

    def says(self, words):
        """Wait until the node has logged *words*."""
        until(lambda: words in self.output, lambda: f'{words!r} in:\n{self.output}')

    def call(self, service):
        """Call one of its services; return (success, message)."""
        response = self._client.call(f'/mapper/{service}')
        return response.success, response.message


def executable(env):
    """Return the path of the node's executable in the workspace of *env*."""
    prefix = env['AMENT_PREFIX_PATH'].split(os.pathsep)[0]
    return os.path.join(prefix, 'lib', 'persem_ros', 'mapper')


def text(value):
    """Return a parameter's value as the command line wants it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(text(item) for item in value) + ']'
    return f"'{value}'" if isinstance(value, str) else str(value)


class Player:
    """
    Publishes a recording from within the test, serialized as it is, without a clock.

    Parameters
    ----------
    client : Client
    path : Path
        The recording.
    qos : QoSProfile
    prefix : str
        Goes before the names of the topics.
    left_out : collection of str
        Topics that are not published.

    """

    def __init__(self, client, path, qos=RELIABLE, prefix='', left_out=()):
        """Advertise the topics and wait until the node listens to each."""
        from rosidl_runtime_py.utilities import get_message
        self.messages = []
        with Reader(path) as reader:
            for connection, at, data in reader.messages():
                if connection.topic not in left_out:
                    self.messages.append((connection.topic, connection.msgtype, at, bytes(data)))
        kinds = {topic: kind for topic, kind, _, _ in self.messages}
        self._out = {topic: client.publisher(get_message(kind), f'{prefix}{topic}', qos)
                     for topic, kind in kinds.items()}
        time.sleep(0.3)     # that a writer knows its reader does not mean that this knows it

    def play(self, messages=None):
        """Publish everything, or some messages, as fast as a reliable connection takes it."""
        for topic, _, _, data in self.messages if messages is None else messages:
            self._out[topic].publish(data)


@contextmanager
def ended(process):
    """Stop a process at the end of a block."""
    try:
        yield process
    finally:
        if process.running:
            process.stop()
