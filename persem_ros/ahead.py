"""Reading ahead and writing behind: two small threads that keep both cores busy."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
import queue
import threading
from types import TracebackType
from typing import Any, TypeVar

Item = TypeVar('Item')
END = object()


def read_ahead(items: Iterable[Item], depth: int = 2) -> Generator[Item, None, None]:
    """
    Yield *items*, up to *depth* of which are made in advance by a thread.

    What the iterator raises is raised here, in its place. When the consumer stops early, the
    thread ends after the item that it is making.

    """
    ready: queue.Queue[tuple[Any, BaseException | None]] = queue.Queue(depth)
    stopped = threading.Event()

    def produce() -> None:
        try:
            for item in items:
                if not _put(ready, (item, None), stopped):
                    return
            _put(ready, (END, None), stopped)
        except BaseException as error:      # noqa: B902  handed over to the consumer
            _put(ready, (END, error), stopped)

    thread = threading.Thread(target=produce, name='read ahead', daemon=True)
    thread.start()
    try:
        while True:
            item, error = ready.get()
            if error is not None:
                raise error
            if item is END:
                return
            yield item
    finally:
        stopped.set()
        thread.join()


class WriteBehind:
    """
    Calls that a thread makes in order, while the caller goes on.

    A call that fails stops the rest; its error is raised by the next call or at the end.

    """

    def __init__(self, depth: int = 2) -> None:
        self._calls: queue.Queue[tuple[Any, tuple[Any, ...]]] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name='write behind', daemon=True)

    def __enter__(self) -> WriteBehind:
        """Start the thread."""
        self._thread.start()
        return self

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have function(*arguments) called; waits while the queue is full."""
        self._check()
        self._calls.put((function, arguments))

    def __exit__(
            self, kind: type[BaseException] | None, value: BaseException | None,
            traceback: TracebackType | None
    ) -> None:
        """Wait until all is done, or, after an error in the block, drop what is left."""
        if kind is not None:
            self._error = self._error or value
        self._calls.put((END, ()))
        self._thread.join()
        if kind is None:
            self._check()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while True:
            function, arguments = self._calls.get()
            if function is END:
                return
            if self._error is None:
                try:
                    function(*arguments)
                except BaseException as error:      # noqa: B902  handed over to the caller
                    self._error = error


def _put(ready: queue.Queue[Item], item: Item, stopped: threading.Event) -> bool:
    """Put an item into a bounded queue; False when the consumer has gone."""
    while not stopped.is_set():
        try:
            ready.put(item, timeout=0.1)
            return True
        except queue.Full:
            pass
    return False
