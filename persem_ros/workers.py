"""Tasks side by side: on this machine's cores, or on a cluster; results as they are ready."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
import multiprocessing
import os
from pathlib import Path
import signal
import sys
import threading
from typing import Any, Protocol

import cv2
from persem_ros.cluster import connected
from persem_ros.core import jit
from persem_ros.errors import PersemError
from tqdm import tqdm

WORKER_BYTES = 1.5e9        # free memory that a worker should find
MOST = 1 << 16              # processes, where their number is not bounded by that of the tasks
_done: Any = None           # units of work that all workers have done, in shared memory


class Task(Protocol):
    """What can be handed to another process."""

    @property
    def name(self) -> str:
        """Return what it works on, for refusals."""


Results = Generator[tuple[int, Any], None, None]
Work = Callable[[Any, Any], Any]        # of a task, and of what is called after each unit or None


class Crew:
    """
    Who does the work, for one kind of it after another: processes are started once.

    Parameters
    ----------
    workers : int
        Processes; 0: one per core, as many as the memory allows. One works in this process,
        with all threads; several have one thread each.
    scheduler : str
        Address of a dask scheduler; '': this machine.

    """

    def __init__(self, workers: int = 0, scheduler: str = '') -> None:
        self._workers, self._scheduler = workers, scheduler
        self._pool: ProcessPoolExecutor | None = None
        self._done: Any = None          # the counter of the processes

    def __enter__(self) -> Crew:
        """Return this."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes, whatever they do."""
        if self._pool is None:
            return
        children = multiprocessing.active_children()
        self._pool.shutdown(wait=False, cancel_futures=True)
        for child in children:
            child.terminate()
        for child in children:
            child.join()

    def results(self, work: Work, tasks: Sequence[Task], units: Sequence[int] | None = None,
                what: str = 'working', unit: str = 'frames') -> Iterator[tuple[int, Any]]:
        """
        Yield (place in *tasks*, what *work* returned) as tasks are finished.

        Parameters
        ----------
        work : function of a module
            work(task, tick) does one task; tick(), where it is not None, counts a unit.
        tasks : sequence of Task
            All that they depend on; they and what they give can be pickled.
        units : sequence of int, optional
            How many units each task is, for the progress bar.
        what, unit : str
            Words of that bar.

        Raises
        ------
        PersemError
            After all tasks have come to an end, when some failed; at once, when there is no
            scheduler or a worker died.

        """
        units = list(units or [1] * len(tasks))
        failed: list[str] = []
        with _bar(units, what, unit) as bar:
            if self._scheduler:
                found = _on_cluster(work, tasks, self._scheduler, units, bar)
            elif _number(self._workers, len(tasks)) > 1:
                found = self._in_processes(work, tasks, bar)
            else:
                found = _here(work, tasks, bar)
            with closing(found):        # whoever is told no more of it may stop listening
                for place, result in found:
                    if isinstance(result, Refused):
                        failed.append(result)
                    else:
                        yield place, result
        if failed:
            more = f' ({len(failed)} of {len(tasks)} failed)' if len(tasks) > 1 else ''
            raise PersemError(f'{failed[0]}{more}')

    def _in_processes(self, work: Work, tasks: Sequence[Task], bar: Any) -> Results:
        """Yield results of processes that share nothing with this one but a counter."""
        if self._pool is None:
            context = multiprocessing.get_context('spawn')      # a memory must not be forked
            self._done = context.Value('q', 0)
            self._pool = ProcessPoolExecutor(_number(self._workers, MOST), context,
                                             _start_worker, (self._done,))
        try:
            with _following(self._done, bar):
                places = {self._pool.submit(attempt_alone, work, task): k
                          for k, task in enumerate(tasks)}
                for future in as_completed(places):
                    yield places[future], future.result()
        except BrokenProcessPool:
            raise PersemError('a worker died, probably for want of memory; fewer --workers need '
                              'less, and what is finished is not computed again') from None


def results(work: Work, tasks: Sequence[Task], workers: int = 0, scheduler: str = '',
            units: Sequence[int] | None = None, what: str = 'working',
            unit: str = 'frames') -> Iterator[tuple[int, Any]]:
    """Yield what a Crew gives that has one kind of work only."""
    with Crew(workers, scheduler) as crew:
        yield from crew.results(work, tasks, units, what, unit)


class Refused(str):
    """The sentence that says why a task gave nothing."""


def attempt(work: Work, task: Task, tick: Callable[..., Any] | None = None) -> Any:
    """Return what *work* makes of a task, or why it gives nothing, Refused."""
    try:
        return work(task, tick)
    except PersemError as error:
        return Refused(error if task.name in str(error) else f'{task.name}: {error}')


def attempt_alone(work: Work, task: Task) -> Any:
    """Do the same on one thread: what a worker does."""
    one_thread()
    return attempt(work, task, _tick if _done is not None else None)


def one_thread() -> None:
    """Let this process compute on one core: a worker among others."""
    jit.set_threads(1)
    cv2.setNumThreads(1)


def _here(work: Work, tasks: Sequence[Task], bar: Any) -> Results:
    for place, task in enumerate(tasks):
        yield place, attempt(work, task, bar.update)


def _on_cluster(work: Work, tasks: Sequence[Task], address: str, units: Sequence[int],
                bar: Any) -> Results:
    """Yield results of a dask cluster, whose workers see the same files under the same paths."""
    with connected(address) as client:
        from distributed import as_completed as as_finished, CancelledError
        from distributed.scheduler import KilledWorker
        futures = client.map(attempt_alone, [work] * len(tasks), tasks, pure=False, retries=2)
        places = {future.key: k for k, future in enumerate(futures)}
        try:
            ready: Any = as_finished
            for future, result in ready(futures, loop=client.loop, with_results=True):
                bar.update(units[places[future.key]])
                yield places[future.key], result
        except (KilledWorker, CancelledError, OSError, RuntimeError, ImportError) as error:
            raise PersemError(f'--scheduler {address}: the work was lost; the workers need the '
                              'same persem_ros as here, the same paths and enough memory '
                              f'({" ".join(str(error).split())[:160]})') from None


def _number(asked: int, tasks: int) -> int:
    """Return the number of processes for some tasks."""
    most = asked or len(os.sched_getaffinity(0))
    if not asked:
        most = max(1, min(most, int(_free_bytes() / WORKER_BYTES)))
    return min(most, tasks)


def _free_bytes() -> float:
    """Return the memory that is free, 8 GB where the system does not say."""
    try:
        lines = Path('/proc/meminfo').read_text().splitlines()
        return 1024 * int(next(x for x in lines if x.startswith('MemAvailable')).split()[1])
    except (OSError, StopIteration, ValueError):
        return 8e9


def _start_worker(done: Any) -> None:
    """Prepare a worker: one thread, a counter, and it is the parent that hears Ctrl-C."""
    global _done
    _done = done
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    one_thread()


def _leave_with_parent() -> None:
    """End this process when its parent is gone, even by SIGKILL: nobody else would tell it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _tick() -> None:
    with _done.get_lock():
        _done.value += 1


@contextmanager
def _following(done: Any, bar: Any) -> Iterator[None]:
    """Let the progress bar follow the workers' counter."""
    stop, before = threading.Event(), done.value

    def follow() -> None:
        while not stop.wait(0.2):
            bar.update(done.value - before - bar.n)
    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _bar(units: Sequence[int], what: str, unit: str) -> Any:
    return tqdm(desc=what, total=sum(units), unit=f' {unit}', leave=False, dynamic_ncols=True,
                disable=not sys.stderr.isatty())
