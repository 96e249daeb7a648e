"""Label images stamped when the network was done: how late, and whether that is constant."""

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray
from persem_ros.preflight.depth import is_cloud_of
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, Remedy, WARN
from persem_ros.preflight.sample import Sample, Stamps, View

EXACT = 1_000_000       # ns: stamps that agree, but for their rounding
SOON = 5_000_000        # ns, in which no network is done
FINE, FITS, FEW = 0.9, 0.8, 0.5     # shares of the images that could have a partner
SHARED, MISSED = 0.2, 3     # share of labels with depth, and number without, where depth is lost
LONGEST = 5_000_000_000             # ns, of a lag that is looked for
SAMPLE = 2000           # label images


def check(sample: Sample) -> Iterator[Finding]:
    """Yield how far labels are from depth where many find none, and the offset that helps."""
    for view in sample.views:
        yield from _cloud(view, sample) if is_cloud_of(view) else _view(view, sample)


def distances(labels: Stamps, depth: Stamps) -> NDArray[np.int64]:
    """
    Return how far each label image is behind the nearest depth image.

    Parameters
    ----------
    labels, depth : ndarray, shape (N,) and (M,), int64
        Stamps, ns; M is at least 1.

    Returns
    -------
    ndarray, shape (N,), int64
        Nanoseconds, positive where the label image is later.

    """
    depth = np.unique(depth)
    after = np.clip(np.searchsorted(depth, labels), 1, max(len(depth) - 1, 1))
    before, after = depth[after - 1], depth[np.minimum(after, len(depth) - 1)]
    nearer = np.abs(labels - before) <= np.abs(labels - after)
    return np.asarray(labels - np.where(nearer, before, after), np.int64)


def lags(labels: Stamps, depth: Stamps, tolerance: int) -> list[tuple[int, int]]:
    """
    Return the lags of labels behind their depth that explain most stamps.

    Parameters
    ----------
    labels, depth : ndarray, int64
        Stamps, ns, ascending and each once.
    tolerance : int
        Nanoseconds by which one may miss.

    Returns
    -------
    list of (int, int)
        (lag in ns, number of label images that find depth), the best one first: of equal numbers
        the shortest lag, since a network is late, and rather less than more.

    """
    period = int(np.median(np.diff(depth))) if len(depth) > 1 else LONGEST
    candidates = {int(labels[0] - depth[0])}
    for base in (0, period // 2):   # a lag that varies across one base does not across the other
        i = np.maximum(np.searchsorted(depth, labels - base, 'right') - 1, 0)
        middle = _middle(labels - depth[i])
        candidates |= {middle + k * period
                       for k in range(-1, min(100, LONGEST // max(period, 1)) + 1)}
    found = {}
    for lag in candidates:
        for center in (np.median, np.median, _middle):
            misses = distances(labels - lag, depth)
            near = misses[2 * np.abs(misses) <= period]
            lag += int(center(near)) if len(near) else 0
        found[lag] = int(np.count_nonzero(np.abs(distances(labels - lag, depth)) <= tolerance))
    return sorted(found.items(), key=lambda item: (-item[1], item[0] < -tolerance, abs(item[0])))


def lost(labels: Stamps, depth: Stamps) -> int:
    """
    Return of how many label images the depth was lost; 0: that is not what their stamps say.

    It is where a good share of them (SHARED) has the very stamp of a depth image, and the others
    are whole periods away from the nearest one, between the first and the last.

    """
    off = distances(labels, depth)
    exact = np.abs(off) <= EXACT
    inside = ~exact & (labels > depth[0]) & (labels < depth[-1])
    if exact.sum() < max(SHARED * len(labels), 3) or inside.sum() < MISSED:
        return 0
    period = np.percentile(np.diff(labels), 10)
    if period <= 2 * SOON:
        return 0
    beside = np.abs(off[inside] - period * np.rint(off[inside] / period))
    return int(inside.sum()) if np.percentile(beside, 95) <= SOON else 0


def _missing(missing: int, n: int) -> Finding:
    """Return that depth of *missing* of n label images was lost, which no offset brings back."""
    return Finding(WARN, f'{missing} of {n} label images have no depth image, others have one of '
                         'their very stamp: depth was lost when it was recorded, not stamped '
                         'otherwise; frames without it are left out, the others are right; to '
                         'record all of it: docs/transports.md')


def _view(view: View, sample: Sample) -> Iterator[Finding]:
    offset = round(sample.config.sync.offset_labels * 1e9)
    labels = (np.unique(view.stamps['labels']) + offset)[:SAMPLE]
    depth = np.unique(view.stamps['depth'])
    if len(labels) < 3 or len(depth) < 3:
        return
    depth = depth[(depth >= labels[0] - LONGEST) & (depth <= labels[-1] + LONGEST)] \
        if depth[0] <= labels[-1] and labels[0] <= depth[-1] else depth
    tolerance = round(sample.config.sync.tolerance * 1e9)
    off = distances(labels, depth)
    near = np.abs(off) <= tolerance
    missing = lost(labels, depth)
    if missing:
        yield _missing(missing, len(labels))
        return
    possible = min(len(labels), len(depth))
    now = int(near.sum())
    exact = int(np.count_nonzero(np.abs(off) <= EXACT))
    # Where all find depth no other lag explains more.
    best, count = lags(labels, depth, tolerance)[0] if now < len(labels) else (0, now)
    fine = now >= FINE * possible and not _steady(off[near], best, count, now)
    if fine or exact >= max(FEW * now, 1):
        if now == len(labels) and exact == 0:
            yield from _constant(off, depth, offset)
        yield from _loose(off, depth, tolerance)
        yield from _at_the_end(labels, depth, offset, (best, count), now, possible)
        return
    severity = WARN if now >= FEW * possible else REFUSE
    low, middle, high = (x / 1e6 for x in np.percentile(off, (5, 50, 95)))
    said = (f'label images are {low:.0f} to {high:.0f} ms (median {middle:.0f} ms) behind the '
            f'depth image that is nearest, {now} of {len(labels)} within sync.tolerance '
            f'({tolerance / 1e6:g} ms)')
    yield Finding(severity, *_advice(said, labels, depth, offset, (best, count), possible,
                                     tolerance))


def _cloud(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield that labels are too far from clouds, which have stamps of their own by right."""
    labels = np.unique(view.stamps['labels']) + round(sample.config.sync.offset_labels * 1e9)
    if len(labels) < 3 or len(view.stamps['depth']) < 3:
        return
    off = np.abs(distances(labels, view.stamps['depth']))
    tolerance = round(sample.config.sync.tolerance * 1e9)
    now = int(np.count_nonzero(off <= tolerance))
    if now >= FINE * min(len(labels), len(view.stamps['depth'])):
        return
    wide = float(np.percentile(off, 95)) / 1e9
    yield Finding(WARN if now >= FEW * len(labels) else REFUSE,
                  f'{now} of {len(labels)} label images are within sync.tolerance '
                  f'({tolerance / 1e6:g} ms) of a cloud, most within {1e3 * wide:.0f} ms; points '
                  'are taken to where the camera was at the stamp of the image',
                  (Remedy({'sync.tolerance': _up(1.1 * wide)}),))


def _constant(off: NDArray[np.int64], depth: Stamps, offset: int) -> Iterator[Finding]:
    """Yield that all labels are beside their depth by the same: another camera, or a lag."""
    low, middle, high = (int(x) for x in np.percentile(off, (5, 50, 95)))
    if high - low > 2 * EXACT or abs(middle) < SOON:
        return
    period = int(np.median(np.diff(depth)))
    late = middle if middle > 0 else middle + period
    yield Finding(NOTE, f'all label images are {abs(middle) / 1e6:.0f} ms '
                        f'{"behind" if middle > 0 else "before"} the nearest depth image',
                  (Remedy({'sync.offset_labels': f'{(offset - late) / 1e9:.3f}'},
                          'if they are stamped when the network was done, that late, or '
                          f'whole periods of the depth ({period / 1e6:.0f} ms) later'),))


def _loose(off: NDArray[np.int64], depth: Stamps, tolerance: int) -> Iterator[Finding]:
    """Yield that labels lie anywhere between the depth images, and the tolerance takes all."""
    period = int(np.median(np.diff(depth)))
    low, high = (int(x) for x in np.percentile(off, (5, 95)))
    if 2 * tolerance < FINE * period or high - low < FEW * period or high - low < 2 * EXACT:
        return
    yield Finding(WARN, f'label images are {low / 1e6:.0f} to {high / 1e6:.0f} ms from the '
                        'nearest depth image, as if their stamps had nothing to do with it: of '
                        f'depth every {period / 1e6:.0f} ms, sync.tolerance ('
                        f'{tolerance / 1e6:g} ms) takes any; if labels are stamped when the '
                        'network was done, they lie on later images than they were made of, and '
                        'whoever publishes them has to keep the stamp of the image',
                  (Remedy({'sync.offset_labels': '-SECONDS'},
                          'takes off what the network needs, where that is known'),))


def _at_the_end(labels: Stamps, depth: Stamps, offset: int, best: tuple[int, int], now: int,
                possible: int) -> Iterator[Finding]:
    """Yield that whole periods of lag explain the last label images, too."""
    lag, count = best
    period = int(np.median(np.diff(depth)))
    if count <= now or count < possible or labels[-1] <= depth[-1] or not SOON < lag <= LONGEST:
        return
    after = int(np.count_nonzero(labels > depth[-1]))
    yield Finding(WARN, f'{after} label image{"s come" if after > 1 else " comes"} after the last '
                        f'depth image, and all {count} have one {lag / 1e6:.0f} ms earlier '
                        f'(depth comes every {period / 1e6:.0f} ms): the recording ended so, or '
                        'labels are stamped when the network was done',
                  (Remedy({'sync.offset_labels': f'{(offset - lag) / 1e9:.3f}'},
                          'in the second case'),))


def _advice(said: str, labels: Stamps, depth: Stamps, offset: int, best: tuple[int, int],
            possible: int, tolerance: int) -> tuple[str, tuple[Remedy, ...]]:
    """Return the sentence and what to type, by what explains the stamps."""
    lag, count = best
    if count < FITS * possible:     # then what counts is how far the rest is, not how many fit
        found = [other for other, _ in lags(labels, depth, tolerance)]
        least = min(float(np.percentile(np.abs(distances(labels - other, depth)), 95))
                    for other in found)
        lag = lags(labels, depth, round(least) + EXACT)[0][0]
    value = f'{(offset - lag) / 1e9:.3f}'
    period = float(np.median(np.diff(depth))) / 1e9
    if count >= FITS * possible:
        # Beside depth that comes faster than labels, a lag of whole periods more fits as well.
        more = sum(other > lag and fitting >= count - 1
                   for other, fitting in lags(labels, depth, tolerance)) > 1
        return (f'{said}; {count} fit a depth image {lag / 1e6:.0f} ms '
                f'{"earlier" if lag >= 0 else "later"}, as if they were stamped when '
                f'{"the network was done" if abs(lag) <= LONGEST else "a recording was played"}',
                (Remedy({'sync.offset_labels': value},
                        f'or whole periods of the depth ({1e3 * period:.0f} ms) less, by what '
                        'the network needs: stamps cannot tell which' if more else ''),))
    rest = np.abs(distances(labels - lag, depth))
    wide = 1.1 * float(np.percentile(rest, 95)) / 1e9
    if wide < 0.5 * period:
        return (f'{said}; {lag / 1e6:.0f} ms {"earlier" if lag >= 0 else "later"} they '
                f'fit, give or take {1e3 * wide:.0f} ms: whoever publishes them had better keep '
                'the stamp of the image, for a frame is placed by the stamp of its labels',
                (Remedy({'sync.offset_labels': value, 'sync.tolerance': _up(wide)},
                        f'maps them all, each by a pose up to {1e3 * wide:.0f} ms off'),))
    return (f'{said}, and no constant lag explains it: whoever publishes the label images has to '
            'keep the stamp of the image that they were made of',
            (Remedy({'sync.tolerance': _up(float(np.percentile(np.abs(
                distances(labels, depth)), 95)) / 1e9)}, 'if the nearest one is right'),))


def _steady(off: NDArray[np.int64], best: int, count: int, now: int) -> bool:
    """Return whether all labels are off by the same, and another lag explains more of them."""
    if not 0 < now < count or abs(_middle(off)) <= EXACT or abs(best - _middle(off)) <= EXACT:
        return False
    return bool(np.percentile(off, 95) - np.percentile(off, 5) <= 2 * EXACT)


def _middle(values: NDArray[np.int64]) -> int:
    """Return the middle between the outer values but for a few, ns."""
    low, high = np.percentile(values, (5, 95))
    return int(round((low + high) / 2))


def _up(seconds: float) -> str:
    """Return the next larger number of two digits, as text."""
    step = 10.0 ** (math.floor(math.log10(max(seconds, 1e-6))) - 1)
    return f'{math.ceil(seconds / step) * step:.6g}'
