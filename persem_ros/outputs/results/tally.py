"""Counting labels of one method: pixels by true and predicted id, region and change."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.refine.regions import REGIONS
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.results.counting import (
    CODES, count_image, count_keys, counted, FREE, LANES, pack, refill, widest)

EVERYWHERE = 'all'
FEW = 6                 # bits of ids that are counted in a table of all their pairs


class Tally:
    """
    The counts of one method: pixels by (true, predicted) id and region, flicker pairs.

    Ids below 63, which nearly all legends have alone, are counted in a table of all pairs:
    finding a pair's place is full of branches, which noisy labels mispredict (all metrics of a
    frame of 640 x 480, three methods: 6 ms instead of 12). Images with larger ids go to a table
    that is looked up.

    """

    def __init__(self) -> None:
        self._bits = 4
        self._few = self._empty()           # region, true, predicted; the last id: UNKNOWN
        self._keys = np.full(1024, FREE)    # true << 16 | predicted; at most half full
        self._counts = np.zeros((1024, CODES), np.int64)
        self._used = np.zeros(1, np.int64)
        self.pairs, self.changed = np.zeros((2, CODES), np.int64)

    def count(self, labels: NDArray[np.int32], classes: NDArray[np.uint16],
              codes: NDArray[np.uint8], pairs: NDArray[np.bool_], before: NDArray[np.uint16],
              table: NDArray[np.uint16]) -> None:
        """
        Count one image; all arrays but the table are of its pixels.

        Parameters
        ----------
        labels : ndarray, shape (n,), int32
            The method's ids.
        classes : ndarray, shape (n,), uint16
            The counted true ids, UNKNOWN where there is none.
        codes : ndarray, shape (n,), uint8
            Regions.
        pairs : ndarray, shape (n,), bool
            Where the frame before is to be compared.
        before : ndarray, shape (n,), uint16
            Its counted ids, which those of this image replace.
        table : ndarray, shape (65536,), uint16
            From ids to counted ids; of size 0: they are the same.

        """
        ids = np.empty(len(labels), np.uint16)
        largest = max(counted(labels, table, ids), widest(classes))
        if largest >= (1 << FEW) - 1:
            self._count_many(ids, classes, codes, pairs, before)
            return
        while largest >= (1 << self._bits) - 1:
            self._widen()
        keys = np.empty(len(ids), np.uint16)
        pack(ids, classes, codes, pairs, before, self._bits, keys)
        size = 1 << self._bits
        lanes = np.zeros((LANES, 2 * CODES * size * size), np.uint32)
        count_keys(keys, lanes)
        found = lanes.sum(axis=0, dtype=np.int64).reshape(2, CODES, size, size)
        self.changed += found[1].sum(axis=(1, 2))
        self._few += found[0]
        self._few += found[1]

    def triples(
            self, region: str) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return true ids, predicted ids and numbers of pixels, (n,) int64 each, sorted."""
        codes, last = codes_of(region), len(self._few[0]) - 1
        few = self._few[codes].sum(axis=0)
        few[last] = 0                   # no truth
        true, predicted = (ids.astype(np.int64) for ids in np.nonzero(few))
        predicted[predicted == last] = UNKNOWN
        taken = self._keys != FREE
        keys = np.concatenate([true << 16 | predicted, self._keys[taken].astype(np.int64)])
        counts = np.concatenate([few[few > 0], self._counts[taken][:, codes].sum(1)])
        keys, places = np.unique(keys, return_inverse=True)
        sums = np.zeros(len(keys), np.int64)
        np.add.at(sums, places, counts)
        keys, sums = keys[sums > 0], sums[sums > 0]
        return keys >> 16, keys & UNKNOWN, sums

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

    def _empty(self) -> NDArray[np.int64]:
        return np.zeros((CODES, 1 << self._bits, 1 << self._bits), np.int64)

    def _widen(self) -> None:
        """Give ids one bit more; the last one stays that of UNKNOWN."""
        old, self._bits = self._few, self._bits + 1
        self._few = self._empty()
        last = old.shape[1] - 1
        self._few[:, :last, :last] = old[:, :last, :last]
        self._few[:, :last, -1] = old[:, :last, last]

    def _count_many(self, *arrays: NDArray[Any]) -> None:
        """Count an image of any ids; the table grows with the pairs of ids."""
        done = 0
        while True:
            done = count_image(done, *arrays, self._keys, self._counts, self._used, self.changed)
            if done == len(arrays[0]):
                return
            keys = np.full(4 * len(self._keys), FREE)
            counts = np.zeros((len(keys), CODES), np.int64)
            refill(self._keys, self._counts, keys, counts)
            self._keys, self._counts = keys, counts


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
