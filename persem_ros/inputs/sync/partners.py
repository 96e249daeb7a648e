"""Why a label image found no depth image: what came, when, and which setting would help."""

from bisect import bisect_left
from collections import deque
import math

from persem_ros.settings.config import Sync

REMEMBERED = 2048       # stamps of a topic
FEW = 0.9               # depth images per label image: fewer means that some were lost …
MARGIN = 2              # … beyond those at the ends of the stretch that is compared
HOLE = 0.6              # of the depth's period: the nearest image is never farther, unless lost


class Partners:
    """
    The stamps of one camera's label and depth images, as they came (node).

    Parameters
    ----------
    keep : float
        Seconds that a depth image waits for its labels at least.

    """

    def __init__(self, keep: float) -> None:
        self._keep = keep
        self.clear()

    def clear(self) -> None:
        """Forget everything (the clock went back)."""
        self._depth: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)  # (stamp, arrival)
        self._labels: deque[int] = deque(maxlen=REMEMBERED)

    def depth(self, stamp: int, now: int) -> None:
        """Remember a depth image."""
        self._depth.append((stamp, now))

    def labels(self, stamp: int) -> None:
        """Remember a label image."""
        self._labels.append(stamp)

    def lost(self) -> tuple[int, int] | None:
        """Return (depth images, label images) of the same stretch where depth is too few."""
        if not self._labels:
            return None
        first, last = min(self._labels), max(self._labels)
        depth = sum(first <= stamp <= last for stamp, _ in self._depth)
        return (depth, len(self._labels)) \
            if depth + MARGIN < FEW * len(self._labels) else None

    def explain(self, stamp: int, arrival: int, sync: Sync) -> str:
        """
        Return why the label image of *stamp*, which came at *arrival*, found no depth image.

        A whole sentence with the distance that missed and the setting that would help.

        """
        if not self._depth:
            return 'no depth image has come at all'
        by_stamp = sorted(self._depth)
        i = bisect_left(by_stamp, (stamp, 0))
        near = min(by_stamp[max(i - 1, 0):i + 1], key=lambda item: abs(item[0] - stamp))
        distance, waited = (near[0] - stamp) / 1e9, (arrival - near[1]) / 1e9
        if abs(distance) <= sync.tolerance:
            return self._not_at_that_time(waited, sync)
        period = _median_gap([s for s, _ in by_stamp])
        if period and abs(near[0] - stamp) > HOLE * period:
            return (f'its depth image never came: the nearest is {1e3 * abs(distance):.0f} ms '
                    f'away, they come every {period / 1e6:.0f} ms')
        return (f'the nearest depth image is {1e3 * abs(distance):.0f} ms '
                f'{"later" if distance > 0 else "earlier"}, sync.tolerance is '
                f'{1e3 * sync.tolerance:.0f} ms; labels keep the stamp of their image, or, where '
                f'they cannot: --set sync.offset_labels={distance:.3f} if that distance is '
                f'always the same, or --set sync.tolerance={_up(abs(distance))}')

    def _not_at_that_time(self, waited: float, sync: Sync) -> str:
        """Return why a depth image that did come was not there: *waited* s before the labels."""
        keep = max(sync.max_wait, self._keep)
        if waited > keep:
            return (f'its depth image came {waited:.1f} s before it and waited for {keep:g} s; '
                    f'--set sync.max_wait={math.ceil(1.5 * waited)} lets it wait for longer')
        if -waited > sync.max_wait:
            return (f'its depth image came {-waited:.1f} s after it, it waited for '
                    f'{sync.max_wait:g} s; --set sync.max_wait={math.ceil(-1.5 * waited)}')
        return ('its depth image had come and was taken by another label image or dropped because '
                f'the queue was full (sync.queue_bytes is {sync.queue_bytes})')


def _median_gap(stamps: list[int]) -> int:
    """Return the median distance of ascending stamps, 0 where there are too few."""
    gaps = sorted(b - a for a, b in zip(stamps, stamps[1:]))
    return gaps[len(gaps) // 2] if gaps else 0


def _up(seconds: float) -> str:
    """Return the next larger number of two digits, with some room, as text."""
    step = 10.0 ** (math.floor(math.log10(seconds)) - 1)
    return f'{math.ceil(1.2 * seconds / step) * step:.6g}'
