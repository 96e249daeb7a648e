"""Where the time of a run went, and by what it was measured: timing.json."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import functools
from importlib import metadata
import os
from pathlib import Path
import platform
import subprocess
import time
from typing import Any, TypeVar

from persem_ros import __version__
from persem_ros.outputs.results.peak import PeakMemory

Item = TypeVar('Item')


class Stopwatch:
    """Seconds by stage, added up; stages may run on several threads, so they can overlap."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.calls: defaultdict[str, int] = defaultdict(int)
        self._start = time.perf_counter()

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the block as a part of *stage*."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - begin
            self.calls[stage] += 1

    def iterate(self, stage: str, items: Iterable[Item]) -> Iterator[Item]:
        """Yield *items*; the time to get each counts as *stage*."""
        left = iter(items)
        while True:
            with self(stage):
                try:
                    item = next(left)
                except StopIteration:
                    return
            yield item

    def total(self) -> float:
        """Return the seconds since this watch was made."""
        return time.perf_counter() - self._start


def content(watch: Stopwatch, frames: int, sizes: dict[str, int]) -> dict[str, Any]:
    """
    Return what timing.json holds.

    Parameters
    ----------
    watch : Stopwatch
        Where the time went.
    frames : int
        Frames integrated.
    sizes : dict
        {what: bytes} of the memory.

    """
    total = watch.total()
    peak = PeakMemory().bytes()
    return {'total_s': round(total, 3), 'frames': frames,
            'frames_per_s': round(frames / total, 2),
            'stages': {stage: {'s': round(seconds, 4), 'calls': watch.calls[stage]}
                       for stage, seconds in watch.seconds.items()},
            'memory': {'peak_rss_bytes': peak, 'map_bytes': sizes},
            'versions': versions(), 'hardware': hardware()}


def versions() -> dict[str, str | None]:
    """Return {package: version} of what computes the results, with our commit where known."""
    result: dict[str, str | None] = {'persem_ros': __version__, 'commit': commit(),
                                     'python': platform.python_version()}
    for name in ('numpy', 'numba', 'rosbags', 'opencv-python-headless'):
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = None
    return result


@functools.cache        # of what this process has loaded, whatever is edited meanwhile
def commit() -> str | None:
    """Return the source tree's git commit, '+' added where it was changed; None outside git."""
    root = Path(__file__).resolve().parents[3]
    if not (root / '.git').exists():
        return None
    try:
        head, status = (subprocess.run(['git', '-C', str(root), *words], capture_output=True,
                                       text=True, timeout=10, check=True).stdout.strip()
                        for words in (['rev-parse', '--short=12', 'HEAD'],
                                      ['status', '--porcelain', '--untracked-files=no']))
    except (OSError, subprocess.SubprocessError):
        return None
    return head + ('+' if status else '')


def hardware() -> dict[str, int | str]:
    """Return the processor's name and the number of cores that this process may use."""
    name = platform.machine()
    try:
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith('model name'):
                name = line.partition(':')[2].strip()
                break
    except OSError:
        pass
    return {'cpu': name, 'cores': len(os.sched_getaffinity(0))}
