"""The numba machinery but prefetch.py: one decorator, one way to use cores, one warm-up."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import ctypes
import functools
import hashlib
import logging
import os
from pathlib import Path
import re
import tempfile
import threading
from typing import Any

import numba
import numpy as np

log = logging.getLogger(__name__)
PACKAGE = Path(__file__).resolve().parents[1]
WARM_UP = str(PACKAGE / 'core' / 'warmup.py')       # imports every kernel
IMPORT = re.compile(r'^ *from (persem_ros[\w.]*) import (\([^)]*\)|.*)', re.MULTILINE)
COMPLETE = 'complete'   # a file beside the compiled kernels, once all of them are there
KERNELS: list[Any] = []  # every compiled function, for warm-up and for the test that counts them
_pool: ThreadPoolExecutor | None = None
_threads = 0
_own = threading.local()
_left: list[BaseException] = []     # what interrupted compiling, see Compiling


def kernel(function: Callable[..., Any]) -> Any:
    """
    Compile *function* once for the types it is first called with; it releases the GIL.

    No fastmath: spec section 2 fixes the order of every sum.

    """
    KERNELS.append(cached(function))
    return KERNELS[-1]


def cached(function: Callable[..., Any]) -> Any:
    """Compile a function of any part of the package; the result goes to the kernels' folder."""
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = cache_folder(function.__code__.co_filename)
    try:
        return numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    finally:
        settings.CACHE_DIR = before


@functools.cache
def cache_folder(source: str) -> str:
    """
    Return the folder of the kernels in the file *source*: in the user's cache, else a temporary.

    Not beside the source: an installed package may be read-only, and pip leaves behind what it
    did not install, a folder 'persem_ros' that would hide a later installation. The folder is
    named after the content of the file and of all that it imports of the package: numba looks at
    the date of a kernel's own file only, and would go on using what it had inlined from another.

    """
    digest = hashlib.sha256(f'{numba.__version__} {np.__version__}'.encode())
    for path in sorted(imported(Path(source))):
        digest.update(path.read_bytes())
    name = f'kernels-{digest.hexdigest()[:16]}'
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    for root in (os.environ.get('NUMBA_CACHE_DIR'), Path(home) / 'persem_ros',
                 Path(tempfile.gettempdir()) / f'persem-{os.getuid()}'):
        folder = Path(root or os.devnull) / name
        try:
            folder.mkdir(0o700, parents=True, exist_ok=True)
            own = folder.stat().st_uid == os.getuid()   # numba unpickles what it finds there
        except OSError:
            continue
        if own and os.access(folder, os.W_OK):
            return str(folder)
    return str(folder)      # numba says what is wrong with it


def imported(source: Path) -> set[Path]:
    """Return the file *source*, those of the package that it imports, and what these import."""
    found: set[Path] = set()
    ahead = [source.resolve()]
    while ahead:
        path = ahead.pop()
        if path not in found:
            found.add(path)
            ahead += imports(path)
    return found


@functools.cache
def imports(source: Path) -> list[Path]:
    """Return the files of the package that the file *source* imports itself."""
    found = []
    for module, names in IMPORT.findall(source.read_text(encoding='utf-8')):
        path = PACKAGE.parent.joinpath(*module.split('.'))
        found += [path / f'{name}.py' for name in re.findall(r'\w+', names)]
        found.append(path.with_suffix('.py'))
    return [path for path in found if path.is_file()]


def mark_complete(what: str = COMPLETE) -> None:
    """Note that these kernels have been compiled, so that nobody is told of it again."""
    try:
        Path(cache_folder(WARM_UP), what).touch()
    except OSError:
        pass


def is_complete(what: str = COMPLETE) -> bool:
    """Return whether that was noted."""
    return Path(cache_folder(WARM_UP), what).exists()


def inlined(function: Callable[..., Any]) -> Any:
    """
    Compile *function* into the kernels that call it.

    On hot paths hand it records (voxels[v]) and their arrays, not whole arrays: numba counts two
    references for each array argument of each call, 35 ns for the three that pushing an
    observation would need, against 3 ns for the work itself.

    """
    return numba.njit(nogil=True, error_model='numpy', forceinline=True)(function)


def signatures() -> Any:
    """Return {kernel name: number of compiled versions}; 1 each, or something is wrong."""
    return {f'{k.__module__}.{k.__name__}': len(k.signatures) for k in KERNELS}


def set_threads(number: int) -> None:
    """Use *number* threads for the kernels that can be split; 0: one per core, 8 at most."""
    global _threads, _pool
    _threads = int(number) or min(8, len(os.sched_getaffinity(0)))
    _pool = ThreadPoolExecutor(_threads, 'kernel') if _threads > 1 else None


def threads() -> int:
    """Return the number of threads in use."""
    if not _threads:
        set_threads(int(os.environ.get('PERSEM_THREADS', '0')))
    return _threads


def work_alone() -> None:
    """Let split() use the calling thread only, from now on: for work that is in no hurry."""
    _own.alone = True


def split(function: Any, n: int, *arguments: Any, grain: int = 4096) -> list[Any]:
    """
    Call function(start, stop, *arguments) over slices of range(n), one thread a slice.

    The slices write to separate elements, so the result is the same for any number of threads.
    Plain threads rather than numba's parallel loops: its portable threading layer aborts the
    process when two Python threads (mapping and refinement) enter it at once.

    """
    parts = 1 if getattr(_own, 'alone', False) else min(threads(), -(-n // grain))
    if parts <= 1 or _pool is None:
        return [function(0, n, *arguments)] if n else []
    edges = [n * i // parts for i in range(parts + 1)]
    jobs = [_pool.submit(function, a, b, *arguments) for a, b in zip(edges[1:-1], edges[2:])]
    first = function(edges[0], edges[1], *arguments)
    return [first] + [job.result() for job in jobs]


def keep_memory() -> None:
    """
    Have the C library keep freed memory for the next frame instead of giving it back.

    A frame takes and frees some 20 MB; faulting them in anew each time was a third of the time
    of integrating it (14.2 ms against 9.9 ms). One arena for all threads, which would each keep
    their own, and nothing that was freed before: the replay of benchmarks/run.py's big map held
    0.65 GB instead of 0.77. Without glibc nothing happens.

    """
    M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return
    give_back()
    mallopt(M_ARENA_MAX, 1)
    mallopt(M_MMAP_THRESHOLD, 1 << 25)      # glibc's largest
    mallopt(M_TRIM_THRESHOLD, 1 << 28)


def give_back() -> None:
    """
    Give back what keep_memory() has the C library keep, between two stages of a replay.

    It takes 2 to 12 ms. The replay of benchmarks/run.py's big map held 30 MB of images behind its
    first pass and 100 MB behind its second that were free, and the report came on top. Without
    glibc nothing happens.

    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)


class Compiling:
    """
    What compiling kernels wants around it.

    It is said, but only when it takes long enough to be noticed. Where it is interrupted, what it
    leaves is kept for good: another thread may be compiling, and LLVM's objects, freed beside it,
    ended a node that was stopped at its first start in 3 of 110 times by SIGSEGV or SIGABRT.

    """

    def __init__(self, *which: str) -> None:
        """Of the kernels that all need, and of *which* besides: ``geometry``."""
        self._which = (COMPLETE, *which)

    def __enter__(self) -> Compiling:
        """Start the clock, unless the kernels are in the cache and only have to be loaded."""
        self._timer = threading.Timer(1.5, log.warning, [
            'compiling the kernels, once (about a minute); later starts load them from a cache'])
        self._timer.daemon = True
        if not all(map(is_complete, self._which)):
            self._timer.start()
        return self

    def __exit__(self, kind: Any, error: BaseException | None, traceback: Any) -> None:
        """Stop the clock; keep what an interruption left."""
        self._timer.cancel()
        if error is not None:
            _left.append(error)     # its traceback holds all frames with what they were at
