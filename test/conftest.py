"""What all tests share: hypothesis profiles, no ROS by accident, Ctrl-C as at a terminal."""

import importlib.util
import os
from pathlib import Path
import signal

from clusters import scheduler, workers      # noqa: F401
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]
HAVE_ROS = importlib.util.find_spec('rclpy') is not None

# What a shell starts in the background ignores Ctrl-C and hands that on to its children, of which
# our tests ask how they end.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Node tests need rclpy; without it they are not even imported, and the last line says so.
collect_ignore = [] if HAVE_ROS else ['ros']

# One run is like the next, whatever the machine's speed; HYPOTHESIS_PROFILE=thorough looks for
# new counterexamples.
settings.register_profile('persem', deadline=None, derandomize=True, print_blob=True,
                          suppress_health_check=[HealthCheck.too_slow])
settings.register_profile('thorough', deadline=None, max_examples=2000,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'persem'))


def pytest_terminal_summary(terminalreporter):
    """Say what was left out for want of ROS."""
    if not HAVE_ROS and (ROOT / 'test' / 'ros').is_dir():
        terminalreporter.write_line(
            'test/ros skipped: no rclpy here; "make ros-test" runs it where ROS 2 is installed')
