"""What other threads ask of the worker: calls that it answers between two frames."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
import queue
from typing import Any, TypeVar

from persem_ros.errors import PersemError

Answer = TypeVar('Answer')
Call = tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]


class Calls:
    """
    Functions that wait to be called, each with the future of whoever asked.

    Parameters
    ----------
    wake : callable
        wake() has the worker look at what waits.

    Attributes
    ----------
    closed : bool
        True: whatever is asked from here on is refused at once.

    """

    def __init__(self, wake: Callable[[], None]) -> None:
        """Start without calls."""
        self.closed = False
        self._wake = wake
        self._waiting: queue.SimpleQueue[Call] = queue.SimpleQueue()

    def ask(self, function: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        """Have function(*arguments) called; from any thread."""
        future: Future[Answer] = Future()
        if self.closed:
            future.set_exception(PersemError('the node is shutting down'))
        else:
            self._waiting.put((future, function, arguments))
            self._wake()
        return future

    def answer(self) -> None:
        """Call all that waits; on the worker's thread."""
        while not self._waiting.empty():
            future, function, arguments = self._waiting.get()
            try:
                future.set_result(function(*arguments))
            except Exception as error:      # noqa: B902  for whoever asked
                future.set_exception(error)

    def refuse(self) -> None:
        """Refuse all that waits; the worker's thread is no more."""
        while not self._waiting.empty():
            self._waiting.get()[0].set_exception(PersemError('the node is shutting down'))
