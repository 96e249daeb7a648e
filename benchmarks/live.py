"""
The node under load, through real DDS: the table of docs/node.md (`make bench-live`).

Three processes: the node as `ros2 run` starts it, this one, which plays a simulated flight over
waves, and a listener that takes the refined images and the map. All clocks are CLOCK_MONOTONIC.

"""

import argparse
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

from live_flight import Flight, RELIABLE
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, PointCloud2

SMALL, LARGE = (640, 480), (1280, 720)      # pixels
VOXEL = 0.25            # m
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def listen(path):
    """Take refined images and map until interrupted; write when each stamp came as JSON."""
    rclpy.init()
    node = rclpy.create_node('bench_listener')
    came, maps = {}, []

    def labels(data):
        came[int.from_bytes(data[4:8], 'little') * 10**9
             + int.from_bytes(data[8:12], 'little')] = time.monotonic_ns()
        if len(came) == 1:
            Path(f'{path}.first').write_text(str(time.monotonic_ns()))
    node.create_subscription(Image, '/mapper/labels', labels, RELIABLE, raw=True)
    node.create_subscription(PointCloud2, '/mapper/map', lambda data: maps.append(len(data)),
                             LATCHED, raw=True)
    node.create_subscription(PointCloud2, '/mapper/map_changes',
                             lambda data: maps.append(len(data)), RELIABLE, raw=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    Path(path).write_text(json.dumps({'came': came, 'maps': maps}))


class Run:
    """One start of the node with a listener beside it."""

    def __init__(self, node, flight, settings=()):
        """Start both."""
        from diagnostic_msgs.msg import DiagnosticArray
        self.flight, self._values = flight, {}
        self._folder = Path(tempfile.mkdtemp())
        self._subscription = node.create_subscription(DiagnosticArray, '/diagnostics',
                                                      self._take, 10)
        self._node = node
        self._out = self._folder / 'listened'
        quiet = {'stdout': subprocess.DEVNULL, 'preexec_fn': _interruptible}
        self._listener = subprocess.Popen([sys.executable, __file__, '--listen', str(self._out)],
                                          start_new_session=True, **quiet)
        options = [word for item in (
            f'memory.voxel_size:={VOXEL}', 'qos.labels:=reliable', 'qos.depth:=reliable',
            'qos.camera_info:=reliable', 'qos.pose:=reliable', *settings) for word in ('-p', item)]
        self.started = time.monotonic_ns()
        self._mapper = subprocess.Popen(['ros2', 'run', 'persem_ros', 'mapper', '--ros-args',
                                         *options], start_new_session=True, **quiet)

    def value(self, key):
        """Return a number of the newest diagnostics."""
        return float(self._values.get(key, 0))

    def wait(self):
        """Wait until the node maps."""
        while self._values.get('message') in (None, 'compiling the kernels'):
            time.sleep(0.05)
        self.flight.wait()

    def first_image(self):
        """Return the seconds from the start to the first refined image, None before it came."""
        path = Path(f'{self._out}.first')
        text = path.read_text() if path.exists() else ''    # it is being written, perhaps
        return (int(text) - self.started) / 1e9 if text else None

    def rss(self):
        """Return the node's resident memory in MB."""
        pids = subprocess.run(['pgrep', '-g', str(self._mapper.pid)], capture_output=True,
                              text=True).stdout.split()
        states = [Path(f'/proc/{pid}/status').read_text() for pid in pids]
        sizes = [int(kb) for text in states for kb in re.findall(r'VmRSS:\s+(\d+)', text)]
        if self._mapper.poll() is not None or not sizes:
            raise RuntimeError('the node has ended')
        return max(sizes) / 1024

    def __enter__(self):
        """Begin a block at whose end nothing is left running."""
        return self

    def __exit__(self, *_):
        """Kill what stop() has not ended."""
        for process in (self._mapper, self._listener):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)

    def stop(self):
        """End both; return what the listener has noted."""
        os.killpg(self._mapper.pid, signal.SIGINT)
        self._listener.send_signal(signal.SIGINT)
        self._mapper.wait(30)
        self._listener.wait(30)
        self._node.destroy_subscription(self._subscription)
        found = json.loads(self._out.read_text())
        return {int(stamp): at for stamp, at in found['came'].items()}, found['maps']

    def _take(self, array):
        for status in array.status:
            if status.name.endswith('mapping'):
                self._values = {'message': status.message,
                                **{v.key: v.value for v in status.values}}


def _interruptible():
    """Let SIGINT reach a child of a shell that started us in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def latencies(sent, came):
    """Return the sorted latencies in ms of the frames that came."""
    return sorted((came[s] - at) / 1e6 for s, at in sent.items() if s in came)


def percentile(values, share):
    """Return a percentile of sorted values."""
    return values[min(len(values) - 1, int(share * len(values)))] if values else float('nan')


def measure(node, flight, seconds, rate, settings=()):
    """Play at a rate; return (row of the table, True where nothing was lost)."""
    with Run(node, flight, settings) as run:
        run.wait()
        sent = flight.play(seconds, rate)
        inside = run.value('latency p95 (ms)')
        time.sleep(3)
        dropped, voxels, rss = run.value('dropped'), run.value('voxels'), run.rss()
        refinement = run.value('refinement (s)')
        came, maps = run.stop()
    found = latencies(sent, came)
    # The last frame of a flight may lack the pose after it.
    lost = len(sent) - len(found) > 1 or dropped > 0
    row = (f'| {rate:g} | {len(sent)} | {len(found)} | {int(dropped)} | '
           f'{percentile(found, 0.5):.1f} | {percentile(found, 0.95):.1f} | '
           f'{percentile(found, 1.0):.1f} | {inside:.1f} | {voxels / 1000:.0f} k | '
           f'{max(maps, default=0) / 1e6:.1f} | {refinement:.2f} | {rss:.0f} |')
    return row, not lost


def start(node, flight):
    """Return the seconds from the start of the node to the first refined image."""
    with Run(node, flight) as run:
        flight.play(120, 10, until=run.first_image)
        seconds = run.first_image()
        run.stop()
    return seconds


def soak(node, flight, seconds):
    """Loop a flight of 20 s and print a row of the table after each."""
    with Run(node, flight, ['memory.max_history:=128']) as run:
        run.wait()
        begin = time.monotonic()
        while time.monotonic() - begin < seconds:
            flight.play(20, 10)
            print(f'| {time.monotonic() - begin:.0f} | {run.value("frames"):.0f} | '
                  f'{run.value("observations") / 1e6:.2f} M | {run.value("voxels") / 1e3:.0f} k | '
                  f'{run.value("map bytes") / 1e6:.0f} | {run.rss():.0f} |', flush=True)
        run.stop()


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.strip().split('\n')[0])
    parser.add_argument('--seconds', type=float, default=60, help='length of the flight at 10 Hz')
    parser.add_argument('--rates', type=float, nargs='*', default=[20, 30, 40],
                        help='further rates, 20 s each')
    parser.add_argument('--geometry', action='store_true',
                        help='the row of the method geometry alone')
    parser.add_argument('--soak', type=float, default=0, metavar='SECONDS',
                        help='loop a flight for that long and print the memory instead')
    parser.add_argument('--listen', help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.listen:
        listen(args.listen)
        return
    rclpy.init()
    node = rclpy.create_node('bench')
    spinning = threading.Thread(target=spin, args=(node,))
    spinning.start()
    try:
        tables(node, args)
    finally:
        rclpy.try_shutdown()
        spinning.join()


def spin(node):
    """Take the node's diagnostics until the end."""
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass


def tables(node, args):
    """Print what the arguments ask for."""
    flight = Flight(node, SMALL)
    print(f'load before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n')
    if args.soak:
        print('| s | frames | observations | voxels | map MB | RSS MB |\n' + '|---' * 6 + '|')
        soak(node, flight, args.soak)
        return
    start(node, flight)     # once for the file cache
    print(f'start to the first refined image: {start(node, flight):.1f} s\n')
    print('| size | Hz | sent | refined | dropped | p50 ms | p95 ms | max ms | in the node ms | '
          'voxels | largest map MB | refinement s | RSS MB |\n'
          '|---|---|---|---|---|---|---|---|---|---|---|---|---|')
    row, _ = measure(node, flight, args.seconds, 10, ['refine.method:=geometry'])
    print(f'| 640 x 480 geometry {row}', flush=True)
    if args.geometry:
        return
    for rate, seconds in [(10, args.seconds), *((rate, 20) for rate in args.rates)]:
        row, clean = measure(node, flight, seconds, rate)
        print(f'| 640 x 480 {row}', flush=True)
        if not clean and rate > 10:
            break
    flight.close()
    flight = Flight(node, LARGE)
    for settings in ([], ['memory.stride:=2']):     # what a RealSense or a ZED sends
        row, _ = measure(node, flight, 20, 30, settings)
        print(f'| 1280 x 720{" stride 2" if settings else ""} {row}', flush=True)


if __name__ == '__main__':
    main()
