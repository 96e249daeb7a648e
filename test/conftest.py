"""What all tests share: hypothesis profiles, no ROS by accident, Ctrl-C as at a terminal."""

import importlib.util
import os
from pathlib import Path
import signal

from clusters import scheduler, workers      # noqa: F401
from hypothesis import HealthCheck, settings
import quick_yaml

ROOT = Path(__file__).resolve().parents[1]
HAVE_ROS = importlib.util.find_spec('rclpy') is not None

# What a shell starts in the background ignores Ctrl-C and hands that on to its children, of which
# our tests ask how they end.
signal.signal(signal.SIGINT, signal.default_int_handler)

# fsync is for power cuts, which no test can make; without it the suite does not wait for the disk.
os.fsync = lambda handle: None
# What stands back for the mapping would starve beside the tests of other processes.
os.setpriority = lambda *_: None
quick_yaml.use(quick_yaml.Yaml)

# Node tests need rclpy; without it they are not even imported, and the last line says so.
collect_ignore = [] if HAVE_ROS else ['ros']

# One run is like the next, whatever the machine's speed; HYPOTHESIS_PROFILE=thorough looks for
# new counterexamples.
settings.register_profile('persem', deadline=None, derandomize=True, print_blob=True,
                          suppress_health_check=[HealthCheck.too_slow])
settings.register_profile('thorough', deadline=None, max_examples=2000,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'persem'))


# Whole files go to one process each, the longest first, lest one be left for the end.
LONG = (
    'mosaic/test_build.py', 'core/test_refine.py', 'commands/test_streams.py',
    'simulate/test_simulate.py', 'evaluate/test_evaluate_figures.py',
    'replay/test_replay_bad_input.py', 'evaluate/test_evaluate_jobs.py',
    'mosaic/test_build_cluster.py', 'core/test_geometry.py', 'replay/test_replay.py',
    'outputs/test_store.py', 'convert/test_convert_frames.py', 'evaluate/test_evaluate.py',
    'outputs/test_living.py', 'core/test_jobs.py', 'evaluate/test_compare.py',
    'evaluate/test_sweep.py', 'core/test_dump.py', 'test_mover.py', 'test_night.py',
    'replay/test_paged_replay.py')


def pytest_collection_modifyitems(config, items):
    """Put the longest files first where several processes share them."""
    if hasattr(config, 'workerinput'):
        place = {ROOT / 'test' / name: number for number, name in enumerate(LONG)}
        items.sort(key=lambda item: place.get(item.path, len(LONG)))


def pytest_terminal_summary(terminalreporter):
    """Say what was left out for want of ROS."""
    if not HAVE_ROS and (ROOT / 'test' / 'ros').is_dir():
        terminalreporter.write_line(
            'test/ros skipped: no rclpy here; "make ros-test" runs it where ROS 2 is installed')
