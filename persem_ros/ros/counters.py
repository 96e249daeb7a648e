"""What the node knows of itself: rates, latencies, drops; written by the worker, read by all."""

from __future__ import annotations

from collections import Counter, deque
import time

from persem_ros.inputs.sync.pairing import UNUSED

WINDOW = 5.0        # s over which rates are taken
KEPT = 1000         # latencies


class Rate:
    """Events per second over the last seconds."""

    def __init__(self) -> None:
        """Start without events."""
        self._times: deque[float] = deque(maxlen=KEPT)

    def note(self) -> None:
        """Count an event."""
        self._times.append(time.monotonic())

    def __call__(self) -> float:
        """Return the rate in Hz."""
        first = time.monotonic() - WINDOW
        return sum(t >= first for t in list(self._times)) / WINDOW


class Statistics:
    """
    Counters of the node.

    Attributes
    ----------
    dropped : collections.Counter
        By reason.
    frames : int
        Frames integrated or, while paused, rendered.
    last_frame : float or None
        When, time.monotonic().
    forgotten : int
        Voxels that were too far away or too many.
    refined_in : float
        Seconds that the last refinement took.
    error : str
        The last thing that went wrong.

    """

    def __init__(self) -> None:
        """Start at zero."""
        self.dropped: Counter[str] = Counter()
        self.frames = 0
        self.last_frame: float | None = None
        self.frame_rate = Rate()
        self.refinements = 0
        self.forgotten = 0
        self.refined_in = 0.0
        self.visited = 0
        self.error = ''
        self._latencies: deque[tuple[float, float]] = deque(maxlen=KEPT)     # when, s

    def frame(self, latency: float) -> None:
        """Count a frame that was done *latency* seconds after its last message came."""
        self.frames += 1
        self.last_frame = time.monotonic()
        self.frame_rate.note()
        self._latencies.append((self.last_frame, latency))

    def losses(self) -> Counter[str]:
        """Return what was dropped by reason, but for depth that no label image wanted."""
        return Counter({reason: n for reason, n in dict(self.dropped).items()
                        if reason != UNUSED})

    @property
    def unused(self) -> int:
        """Return the number of depth images that no label image wanted: no loss."""
        return self.dropped[UNUSED]

    def latencies(self) -> tuple[float, float]:
        """Return (p50, p95) of the recent latencies in seconds, (0, 0) without frames."""
        first = time.monotonic() - 2 * WINDOW
        recent = sorted(latency for at, latency in list(self._latencies) if at >= first)
        if not recent:
            return 0.0, 0.0
        return recent[len(recent) // 2], recent[min(len(recent) - 1, len(recent) * 95 // 100)]
