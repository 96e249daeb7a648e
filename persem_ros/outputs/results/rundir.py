"""A run is a folder: what lies in it, and that nothing half-written ever does."""

from collections import defaultdict
from contextlib import contextmanager, suppress
from importlib import metadata
import os
from pathlib import Path
import platform
import shutil
import subprocess
import time

from persem_ros import __version__
from persem_ros.errors import PersemError
from persem_ros.outputs.recording.target import check_target
from persem_ros.outputs.results.peak import PeakMemory

FILES = ('map.ply', 'map.persem', 'refined', 'metrics.json', 'config.yaml', 'timing.json',
         'report.html')


def prepare(path, force=False, keep=()):
    """
    Return the folder *path*, made and found writable; an earlier run in it is left to clear().

    Parameters
    ----------
    path : str or Path
        The folder of a run.
    force : bool
        Allow a folder that is not empty.
    keep : iterable of str or Path
        What the run itself reads, and must not replace; '' for nothing.

    Raises
    ------
    PersemError
        When it is not empty and *force* is not set, when it is a file or cannot be written, or
        when an input lies among the files that *force* would replace.

    """
    path = Path(path)
    for name in filter(None, map(str, keep)):
        if path.resolve() in Path(name).resolve().parents and _is_ours(_first(path, name)):
            raise PersemError(f'{name} lies in {path}, whose files this run would replace; give '
                              'another folder with --out')
    missing = [folder for folder in (path, *path.parents) if not os.path.lexists(folder)]
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()) and not force:
            raise PersemError(f'{path} is not empty; give another folder with --out, or --force '
                              'to replace the files of an earlier run')
        check_target(path / 'refined', force=True)      # a folder of somebody else's stays
        for left in [entry for entry in path.iterdir() if _is_left_behind(entry.name)]:
            _remove(left)
        probe = path / f'.{os.getpid()}.probe'
        probe.write_bytes(b'')
        probe.unlink()
    except FileExistsError:
        raise PersemError(f'{path} is a file; give the name of a folder with --out') from None
    except OSError as error:
        for folder in missing:      # those that were made before it went wrong, deepest first
            with suppress(OSError):
                folder.rmdir()
        raise PersemError(f'cannot write to {path}: {error.strerror}') from error
    return path


def clear(path):
    """Remove the files of an earlier run from the folder *path*, and nothing else."""
    try:
        for name in FILES:
            _remove(Path(path) / name)
    except OSError as error:
        raise PersemError(f'cannot replace {error.filename}: {error.strerror}') from error


def _first(folder, path):
    """Return the name in *folder* under which *path*, somewhere below it, lies."""
    return Path(path).resolve().relative_to(Path(folder).resolve()).parts[0]


def _is_ours(name):
    """Whether *name* is a file or folder that a run leaves."""
    return name in FILES


def _is_left_behind(name):
    """Whether *name* is what a run that was killed had not finished."""
    return any(name.startswith(f'.{ours}.') and '.partial' in name for ours in FILES)


def _remove(path):
    """Remove a file or folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


class Stopwatch:
    """Seconds by stage, added up; stages may run on several threads, so they can overlap."""

    def __init__(self):
        self.seconds = defaultdict(float)
        self.calls = defaultdict(int)
        self._start = time.perf_counter()

    @contextmanager
    def __call__(self, stage):
        """Time the block as a part of *stage*."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - begin
            self.calls[stage] += 1

    def iterate(self, stage, items):
        """Yield *items*; the time to get each counts as *stage*."""
        items = iter(items)
        while True:
            with self(stage):
                try:
                    item = next(items)
                except StopIteration:
                    return
            yield item

    def total(self):
        """Return the seconds since this watch was made."""
        return time.perf_counter() - self._start


def timing(watch, frames, sizes):
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


def versions():
    """Return {package: version} of what computes the results, with our commit where known."""
    result = {'persem_ros': __version__, 'commit': commit(), 'python': platform.python_version()}
    for name in ('numpy', 'numba', 'rosbags', 'opencv-python-headless'):
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = None
    return result


def commit():
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


def hardware():
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
