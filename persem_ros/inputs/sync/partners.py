"""Why a label image found no depth image: what came, when, and which setting would help."""

from bisect import bisect_left, insort
from collections import deque
import math

from persem_ros.settings.config import Sync

REMEMBERED = 2048       # stamps of a topic
FEW = 0.9               # depth images per label image: fewer means that some were lost …
MARGIN = 2              # … beyond those at the ends of the stretch that is compared
HOLE = 0.6              # of the depth's period: the nearest image is never farther, unless lost
PATIENCE = 5_000_000_000        # ns that depth is waited for before it is called lost


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
        self._labels: deque[tuple[int, int]] = deque(maxlen=REMEMBERED)
        self._given_up: list[tuple[int, int]] = []              # the same of labels, ascending
        self._late: deque[int] = deque(maxlen=REMEMBERED)       # ns that depth came after labels

    def depth(self, stamp: int, now: int, tolerance: float) -> None:
        """Remember a depth image; it is late where it fits labels that were given up (seconds)."""
        self._depth.append((stamp, now))
        i = bisect_left(self._given_up, (stamp, 0))
        near = min(range(max(i - 1, 0), min(i + 1, len(self._given_up))), default=None,
                   key=lambda j: abs(self._given_up[j][0] - stamp))
        if near is not None and abs(self._given_up[near][0] - stamp) <= tolerance * 1e9:
            self._late.append(now - self._given_up.pop(near)[1])

    def labels(self, stamp: int, now: int) -> None:
        """Remember a label image."""
        self._labels.append((stamp, now))

    def give_up(self, stamp: int, arrival: int, tolerance: float) -> None:
        """Remember that a label image, whose depth may still come, waits for it no longer."""
        if all(abs(depth - stamp) > tolerance * 1e9 for depth, _ in self._depth):
            insort(self._given_up, (stamp, arrival))
            del self._given_up[:-REMEMBERED]

    def lost(self) -> tuple[int, int] | None:
        """
        Return (depth images, label images) of the same stretch where depth is too few.

        The stretch ends with the newest depth image, or PATIENCE before the newest labels where
        that is later: what is newer may still come.

        """
        if not self._labels:
            return None
        newest = max(self._depth)[0] if self._depth else None
        now = self._labels[-1][1]
        stamps = [stamp for stamp, at in self._labels
                  if newest is not None and stamp <= newest or now - at >= PATIENCE]
        if not stamps:
            return None
        first, last = min(stamps), max(stamps)
        depth = sum(first <= stamp <= last for stamp, _ in self._depth)
        return (depth, len(stamps)) if depth + MARGIN < FEW * len(stamps) else None

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
        newer = stamp > by_stamp[-1][0]
        # How much longer the newest depth image took than these labels, by arrivals and stamps.
        behind, late = -distance - waited, self._late_sentence(sync)
        if newer and late:
            return late
        if newer and behind > sync.max_wait:
            return (f'its depth image has not come yet, depth seems to come {behind:.1f} s later '
                    f'than its label image; {_longer(behind, sync)}')
        if newer and -distance * 1e9 > PATIENCE:
            return f'no depth image has come for {-distance:.0f} s'
        period = _median_gap([s for s, _ in by_stamp])
        if period and abs(near[0] - stamp) > HOLE * period:
            return (f'its depth image {"has not come" if newer else "never came"}: the nearest is '
                    f'{1e3 * abs(distance):.0f} ms away, they come every {period / 1e6:.0f} ms'
                    + (f'; of others, {late}' if late else ''))
        return (f'the nearest depth image is {1e3 * abs(distance):.0f} ms '
                f'{"later" if distance > 0 else "earlier"}, sync.tolerance is '
                f'{1e3 * sync.tolerance:.0f} ms; labels keep the stamp of their image, or, where '
                f'they cannot: --set sync.offset_labels={distance:.3f} if that distance is '
                f'always the same, or --set sync.tolerance={_up(abs(distance))}')

    def _late_sentence(self, sync: Sync) -> str:
        """Return how late depth came for labels that were given up, '' where none did."""
        late = [ns / 1e9 for ns in self._late if ns > sync.max_wait * 1e9]
        if not late:
            return ''
        return (f'depth comes up to {max(late):.1f} s later than its label image ({len(late)} '
                f'depth images came after their labels were given up); {_longer(max(late), sync)}')

    def _not_at_that_time(self, waited: float, sync: Sync) -> str:
        """Return why a depth image that did come was not there: *waited* s before the labels."""
        keep = max(sync.max_wait, self._keep)
        if waited > keep:
            return (f'its depth image came {waited:.1f} s before it and waited for {keep:g} s; '
                    f'--set sync.max_wait={math.ceil(1.5 * waited)} lets it wait for longer')
        if -waited > sync.max_wait:
            return (f'its depth image came {-waited:.1f} s after it; '
                    f'{_longer(-waited, sync)}')
        return ('its depth image had come and was taken by another label image or dropped because '
                f'the queue was full (sync.queue_bytes is {sync.queue_bytes})')


def _longer(late: float, sync: Sync) -> str:
    """Return what lets labels wait for depth that comes *late* seconds after them."""
    return (f'labels wait for {sync.max_wait:g} s, '
            f'--set sync.max_wait={math.ceil(1.5 * late)} lets them wait for longer')


def _median_gap(stamps: list[int]) -> int:
    """Return the median distance of ascending stamps, 0 where there are too few."""
    gaps = sorted(b - a for a, b in zip(stamps, stamps[1:]))
    return gaps[len(gaps) // 2] if gaps else 0


def _up(seconds: float) -> str:
    """Return the next larger number of two digits, with some room, as text."""
    step = 10.0 ** (math.floor(math.log10(seconds)) - 1)
    return f'{math.ceil(1.2 * seconds / step) * step:.6g}'
