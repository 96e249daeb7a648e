"""Tasks side by side: on this machine's cores, or on a cluster; results as they are ready."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import as_completed, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
import os
from pathlib import Path
import signal
import sys
import threading
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.evaluate.work import sequence
from tqdm import tqdm

if TYPE_CHECKING:
    from persem_ros.evaluate.work.task import Task

WORKER_BYTES = 1.5e9        # free memory that a worker should find
PATIENCE = 10               # seconds for a scheduler to answer
_done = None                # frames that all workers have read, in shared memory


def results(
        tasks: list[Task], workers: int = 0, scheduler: str = '', frames: list[int] | None = None
) -> Iterator[tuple[int, dict[str, Any], dict[str, NDArray[np.int64]]]]:
    """
    Yield (place in *tasks*, summary, arrays) as tasks are finished.

    Parameters
    ----------
    tasks : sequence of task.Task
        The work.
    workers : int
        Processes; 0: one per core, as many as the memory allows. One works in this process,
        with all threads; several have one thread each.
    scheduler : str
        Address of a dask scheduler; '': this machine.
    frames : sequence of int, optional
        Frames to be read by each task, for the progress bar.

    Raises
    ------
    PersemError
        After all tasks have come to an end, when some failed; at once, when there is no
        scheduler or a worker died.

    """
    frames = list(frames or [1] * len(tasks))
    failed: list[Any] = []
    with _bar(frames) as bar:
        if scheduler:
            found = _on_cluster(tasks, scheduler, frames, bar)
        elif _workers(workers, len(tasks)) > 1:
            found = _in_processes(tasks, _workers(workers, len(tasks)), bar)
        else:
            found = _here(tasks, bar)
        for place, result in found:
            if isinstance(result, str):
                failed.append((place, result))
            else:
                yield place, *result
    if failed:
        more = f' ({len(failed)} of {len(tasks)} failed)' if len(tasks) > 1 else ''
        raise PersemError(f'{failed[0][1]}{more}')


def attempt(
        task: Task, tick: Callable[..., Any] | None = None
) -> str | tuple[dict[str, Any], dict[str, NDArray[np.int64]]]:
    """Return (summary, arrays) of a task, or the sentence that says why there is none."""
    try:
        return sequence.evaluate_sequence(task, tick)
    except PersemError as error:
        name = Path(task.recording).name
        return str(error) if name in str(error) else f'{name}: {error}'


def attempt_alone(task: Any) -> Any:
    """Do the same on one thread: what a worker does."""
    sequence.one_thread()
    return attempt(task, _tick if _done is not None else None)


def _here(
        tasks: list[Task], bar: Any
) -> Iterator[tuple[int, str | tuple[dict[str, Any], dict[str, NDArray[np.int64]]]]]:
    for place, task in enumerate(tasks):
        yield place, attempt(task, bar.update)


def _in_processes(
        tasks: list[Task], workers: int, bar: Any
) -> Iterator[tuple[int, str | tuple[dict[str, Any], dict[str, NDArray[np.int64]]]]]:
    """Yield results of processes that share nothing with this one but a counter."""
    context = multiprocessing.get_context('spawn')      # a memory must not be forked
    done = context.Value('q', 0)
    pool = ProcessPoolExecutor(workers, context, _start_worker, (done,))
    try:
        with _following(done, bar):
            places = {pool.submit(attempt_alone, task): k for k, task in enumerate(tasks)}
            for future in as_completed(places):
                yield places[future], future.result()
    except BrokenProcessPool:
        raise PersemError('a worker died, probably for want of memory; fewer --workers need '
                          'less, and what is finished is not computed again') from None
    finally:
        children = multiprocessing.active_children()
        pool.shutdown(wait=False, cancel_futures=True)
        for child in children:
            child.terminate()
        for child in children:
            child.join()


def _on_cluster(
        tasks: list[Task], address: str, frames: list[int], bar: Any
) -> Iterator[tuple[int, tuple[dict[str, Any], dict[str, NDArray[np.int64]]]]]:
    """Yield results of a dask cluster, whose workers see the recordings under the same path."""
    try:
        from distributed import as_completed as as_finished, CancelledError, Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise PersemError(f'--scheduler needs dask.distributed ({error}); install it with: pip '
                          "install 'persem_ros[cluster]'") from None
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise PersemError(f'--scheduler {address}: no scheduler answers there '
                          f'({" ".join(str(error).split())[:120]}); start one with: dask '
                          'scheduler, and workers with: dask worker ADDRESS --nthreads 1') \
            from None
    with client:
        if not client.scheduler_info()['workers']:
            raise PersemError(f'--scheduler {address}: it has no workers; start some with: dask '
                              f'worker {address} --nthreads 1')
        futures = client.map(attempt_alone, tasks, pure=False, retries=2)
        places = {future.key: k for k, future in enumerate(futures)}
        try:
            for future, result in as_finished(futures, loop=client.loop,
                                              with_results=True):
                bar.update(frames[places[future.key]])
                yield places[future.key], result
        except (KilledWorker, CancelledError, OSError, RuntimeError, ImportError) as error:
            raise PersemError(f'--scheduler {address}: the work was lost; the workers need the '
                              'same persem_ros as here, the same paths and enough memory '
                              f'({" ".join(str(error).split())[:160]})') from None


def _workers(asked: int, tasks: int) -> int:
    """Return the number of processes for some tasks."""
    most = asked or len(os.sched_getaffinity(0))
    if not asked:
        most = max(1, min(most, int(_free_bytes() / WORKER_BYTES)))
    return min(most, tasks)


def _free_bytes() -> Any:
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
    sequence.one_thread()


def _tick() -> None:
    with _done.get_lock():
        _done.value += 1


@contextmanager
def _following(done: Any, bar: Any) -> Iterator[Any]:
    """Let the progress bar follow the workers' counter."""
    stop = threading.Event()

    def follow() -> None:
        while not stop.wait(0.2):
            bar.update(done.value - bar.n)
    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _bar(frames: list[int]) -> Any:
    return tqdm(desc='evaluating', total=sum(frames), unit=' frames', leave=False,
                dynamic_ncols=True, disable=not sys.stderr.isatty())
