"""The queue between the subscriptions and the worker: bounded in seconds and bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import threading
import time
from typing import NamedTuple, TYPE_CHECKING

from persem_ros.inputs.sync.match import LABELS

if TYPE_CHECKING:
    from persem_ros.ros.topic import Input
    from persem_ros.settings.config import Sync

MAX_SMALL = 20000       # poses and camera infos; images are bounded in seconds and bytes


class Item(NamedTuple):
    """A message as it came."""

    arrival: int        # ns, time.monotonic_ns
    input: Input        # noqa: A003
    kind: str           # 'sensor_msgs/msg/Image'
    data: bytes


def _stamp(item: Item, offset: int) -> int | None:
    """Return the stamp of an image by the clock of the depth images, None without."""
    stamp = item.input.stamp_of(item.data)
    return stamp + offset if stamp is not None and item.input.role == LABELS else stamp


class Inbox:
    """
    Messages in the order of their arrival.

    Images, which are large, are dropped when they wait for too long or are too many, the oldest
    first; poses are kept, because later images need them.

    Parameters
    ----------
    sync : Sync
        sync.queue and sync.queue_bytes.
    on_drop : callable
        on_drop(item), from any thread.

    """

    def __init__(self, sync: Sync, on_drop: Callable[[Item], None]) -> None:
        """Start empty."""
        self.configure(sync)
        self.bytes = 0
        self._on_drop = on_drop
        self._images: deque[Item] = deque()
        self._small: deque[Item] = deque()
        self._changed = threading.Condition()
        self._woken = False

    def __len__(self) -> int:
        """Return the number of messages that wait."""
        return len(self._images) + len(self._small)

    def configure(self, sync: Sync) -> None:
        """Go on with other bounds."""
        self._seconds = round(sync.queue * 1e9)
        self._max_bytes = sync.queue_bytes

    def put(self, item: Item) -> None:
        """Add a message, on the thread of the subscriptions; never blocks for long."""
        dropped: list[Item] = []
        with self._changed:
            if item.input.is_image:
                self._images.append(item)
                self.bytes += len(item.data)
                while self._images and (self.bytes > self._max_bytes or item.arrival
                                        - self._images[0].arrival > self._seconds):
                    dropped.append(self._images.popleft())
                    self.bytes -= len(dropped[-1].data)
            else:
                self._small.append(item)
                if len(self._small) > MAX_SMALL:
                    dropped.append(self._small.popleft())
            self._changed.notify()
        for old in dropped:
            self._on_drop(old)

    def get(self, timeout: float) -> Item | None:
        """Return the message that came first, None when none came within *timeout* seconds."""
        end = time.monotonic() + timeout
        with self._changed:
            while not (self._images or self._small or self._woken):
                left = end - time.monotonic()
                if left <= 0 or not self._changed.wait(left):
                    break
            self._woken = False
            if not (self._images or self._small):
                return None
            first = not self._images or self._small and \
                self._small[0].arrival <= self._images[0].arrival
            item = (self._small if first else self._images).popleft()
            if item.input.is_image:
                self.bytes -= len(item.data)
            return item

    def skip(self, offset: int, tolerance: int) -> tuple[int, int] | None:
        """
        Leave out all images that are older than the newest label image that waits.

        Parameters
        ----------
        offset : int
            What is added to the stamps of label images, ns.
        tolerance : int
            By how much the stamps of a pair may differ, ns.

        Returns
        -------
        int, int
            The stamp of that label image, and how many label images were left out.
        None
            Where no label image waits.

        """
        with self._changed:
            stamps = [_stamp(item, offset) for item in self._images]
            newest: dict[Input, int] = {}       # of each topic with label images
            for item, stamp in zip(self._images, stamps):
                if item.input.role == LABELS and stamp is not None:
                    newest[item.input] = max(stamp, newest.get(item.input, stamp))
            if not newest:
                return None
            kept: deque[Item] = deque()
            cut, count = min(newest.values()), 0
            for item, stamp in zip(self._images, stamps):
                labels = item.input.role == LABELS
                if stamp is None or stamp >= cut - (0 if labels else tolerance):
                    kept.append(item)
                    continue
                self.bytes -= len(item.data)
                count += labels
            self._images = kept
            return cut, count

    def wake(self) -> None:
        """Let a waiting get() return now."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def clear(self) -> None:
        """Forget everything that waits."""
        with self._changed:
            self._images.clear()
            self._small.clear()
            self.bytes = 0
