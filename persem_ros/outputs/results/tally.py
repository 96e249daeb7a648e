"""Counting labels of one method: pixels by true and predicted id, region and change."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.refine.regions import REGIONS
from persem_ros.frames import UNKNOWN

EVERYWHERE = 'all'
CODES = 8               # sums of the bits of REGIONS
FREE = np.uint64(2 ** 64 - 1)       # a free place in a table of counts


class Tally:
    """The counts of one method: pixels by (true, predicted) id and region, flicker pairs."""

    def __init__(self) -> None:
        self.keys = np.full(1024, FREE)     # true << 16 | predicted; at most half full
        self.counts = np.zeros((1024, CODES), np.int64)
        self.pairs, self.changed = np.zeros((2, CODES), np.int64)
        self.used = np.zeros(1, np.int64)

    def count(self, *arrays: NDArray[Any]) -> None:
        """Count one image, as for count_image(); the table grows with the pairs of ids."""
        done = 0
        while True:
            done = count_image(done, *arrays, self.keys, self.counts, self.used, self.changed)
            if done == len(arrays[0]):
                return
            keys = np.full(4 * len(self.keys), FREE)
            counts = np.zeros((len(keys), CODES), np.int64)
            refill(self.keys, self.counts, keys, counts)
            self.keys, self.counts = keys, counts

    def triples(
            self, region: str) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return true ids, predicted ids and numbers of pixels, (n,) int64 each, sorted."""
        order = np.argsort(self.keys)[:self.used[0]]
        counts = self.counts[order][:, codes_of(region)].sum(1)
        keys, counts = self.keys[order][counts > 0].astype(np.int64), counts[counts > 0]
        return keys >> 16, keys & UNKNOWN, counts

    def flicker(self, region: str) -> float | None:
        """Return the percentage of changed pixels in consecutive frames, or None."""
        codes = codes_of(region)
        return percent(self.changed[codes].sum(), self.pairs[codes].sum())

    def measured(self, region: str, has_truth: bool, iou: bool) -> dict[str, Any]:
        """Return {pixel_accuracy, miou, flicker[, iou]} in percent, None where unknown."""
        result: dict[str, Any] = {
            'pixel_accuracy': None, 'miou': None, 'flicker': self.flicker(region)}
        by_class: dict[int, float] = {}
        if has_truth:
            true, predicted, counts = self.triples(region)
            by_class = iou_by_class(true, predicted, counts)
            result['pixel_accuracy'] = percent(counts[true == predicted].sum(), counts.sum())
            result['miou'] = float(np.mean(list(by_class.values()))) if by_class else None
        if iou:
            result['iou'] = {str(c): value for c, value in by_class.items()}
        return result


def iou_by_class(
        true: NDArray[np.int64], predicted: NDArray[np.int64], counts: NDArray[np.int64]
) -> dict[int, float]:
    """
    Return {id: intersection over union in percent} of the ids that occur in the truth.

    Parameters
    ----------
    true, predicted : ndarray, shape (n,)
        Ids of each pair that was counted.
    counts : ndarray, shape (n,)
        Pixels of that pair.

    """
    in_truth, in_prediction, hit = np.zeros((3, UNKNOWN + 1), np.int64)
    np.add.at(in_truth, true, counts)
    np.add.at(in_prediction, predicted, counts)
    same = true == predicted
    np.add.at(hit, true[same], counts[same])
    return {int(c): 100.0 * float(hit[c]) / float(in_truth[c] + in_prediction[c] - hit[c])
            for c in np.flatnonzero(in_truth)}


def percent(part: int, whole: int) -> float | None:
    """Return 100 part / whole, or None for a part of nothing."""
    return 100.0 * float(part) / float(whole) if whole else None


def codes_of(region: str) -> NDArray[np.int64]:
    """Return the numbers 0 .. 7 whose bits put them into a region."""
    codes = np.arange(CODES)
    return codes if region == EVERYWHERE else codes[codes & REGIONS[region] != 0]


@kernel
def place_of(keys, key):
    """Return the place of *key* in the table, or the free place where it belongs."""
    mask = np.uint64(len(keys) - 1)
    place = (key * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(32)) & mask
    while keys[place] != key and keys[place] != FREE:
        place = (place + np.uint64(1)) & mask
    return place


@kernel
def refill(keys, counts, new_keys, new_counts):
    """Move all counts into a larger, empty table."""
    for i in range(len(keys)):
        if keys[i] != FREE:
            place = place_of(new_keys, keys[i])
            new_keys[place] = keys[i]
            new_counts[place] = counts[i]


@kernel
def count_image(start, labels, classes, codes, pairs, before, table, keys, counts, used, changed):
    """
    Count the pixels from *start* on; returns where it stopped, early when the table is full.

    before holds the previous frame's counted labels and is replaced on the way; pairs says
    where the two are to be compared. Unsigned all over: signed places are checked for
    negative ones at every access, which costs five times as much as the counting.

    """
    last, place = FREE, np.uint64(0)        # of the pixel before: nine in ten are like it
    code, alike, other = np.uint8(0), 0, 0      # so that it pays to add up like ones first
    for i in range(start, len(labels)):
        inside = np.uint32(labels[i]) < UNKNOWN
        c = np.uint64(table[labels[i]] if inside else np.uint16(UNKNOWN))
        if codes[i] != code:
            counts[place, code] += alike
            changed[code] += other
            code, alike, other = codes[i], 0, 0
        if classes[i] != UNKNOWN:
            key = np.uint64(classes[i]) << np.uint64(16) | c
            if key != last:
                counts[place, code] += alike
                last, place, alike = key, place_of(keys, key), 0
                if keys[place] == FREE:
                    if 2 * used[0] >= len(keys):
                        changed[code] += other
                        return i
                    keys[place] = key
                    used[0] += 1
            alike += 1
        other += pairs[i] & (c != before[i])
        before[i] = c
    counts[place, code] += alike
    changed[code] += other
    return len(labels)
