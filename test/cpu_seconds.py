"""
What tests cost, in seconds of processor: their fixtures' and their child processes' with them.

`PYTHONPATH=test python -m pytest -p cpu_seconds test/replay` prints the ten that cost most, and
the files. Unlike --durations it says the same on a machine that others use, too.

"""

from collections import Counter
import os

import pytest

SPENT = Counter()       # seconds by what pytest calls a test


def processor():
    """Return the seconds of processor of this process and of its children that have ended."""
    return sum(os.times()[:4])


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item):
    """Count fixtures with the first test that has them."""
    yield from counted(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item):
    """Count the test itself."""
    yield from counted(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_teardown(item):
    """Count the end of fixtures with the last test that had them."""
    yield from counted(item)


def counted(item):
    """Count what is spent between the two halves of a hook."""
    before = processor()
    yield
    SPENT[item.nodeid] += processor() - before


def pytest_terminal_summary(terminalreporter):
    """Print both tables."""
    files = Counter()
    for name, seconds in SPENT.items():
        files[name.partition('::')[0]] += seconds
    for what, most in (('tests', SPENT.most_common(10)), ('files', files.most_common(20))):
        terminalreporter.section(f'{what} by seconds of processor, {processor():.0f} in all')
        for name, seconds in most:
            terminalreporter.write_line(f'{seconds:7.1f} {name}')
