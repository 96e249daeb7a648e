"""How good and how steady labels are: streaming counts, results as in metrics.json (section 6)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.core.refine.regions import REGIONS
from persem_ros.errors import PersemError
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.results.counting import CODES, count_keys, counted, LANES
from persem_ros.outputs.results.tally import codes_of, EVERYWHERE, percent, Tally

TRUTH = 'truth'         # the truth measured against itself: its flicker is the floor


Number = TypeVar('Number', np.bool_, np.uint8, np.int32, np.float64)


class Before(NamedTuple):
    """What the frame before left."""

    shape: tuple[int, ...]
    valid: NDArray[np.bool_]                    # (pixels,)
    labels: dict[str, NDArray[np.uint16]]       # by method, (pixels,)


class Metrics:
    """
    Counts over one sequence, for several methods at once.

    Parameters
    ----------
    methods : sequence of str
        Names of the methods, in the order of the result.
    taxonomy : mapping, optional
        Many-to-one table that is applied to truth and predictions before counting. A truth id
        outside the table is ignored, a predicted one is wrong.

    """

    def __init__(self, methods: Sequence[str],
                 taxonomy: Mapping[int, int] | None = None) -> None:
        self.methods = tuple(methods)
        self._tallies = {name: Tally() for name in (*self.methods, TRUTH)}
        self._table = _table(taxonomy)
        self._pixels = np.zeros(CODES, np.int64)        # valid ones, by region
        self._before: dict[str, Before] = {}            # by sensor
        self._has_truth = self._has_regions = False

    def update(self, valid: NDArray[np.bool_],
               predictions: Mapping[str, NDArray[Any]] | Iterable[tuple[str, NDArray[Any]]],
               truth: NDArray[Any] | None = None, regions: NDArray[np.uint8] | None = None,
               sensor: str | None = '') -> None:
        """
        Count one integrated frame.

        Parameters
        ----------
        valid : ndarray, shape (H, W)
            The pixels that count, the same for every method: valid_pixels.
        predictions : mapping or pairs of str and ndarray, shape (H, W)
            Labels by method, integers; below 0 or above 65534: unknown, which is wrong.
        truth : ndarray, shape (H, W), integers, optional
            True labels; needed where *valid* is true.
        regions : ndarray, shape (H, W), optional
            Bits of REGIONS of each pixel's voxel, 0 where it has none.
        sensor : str, optional
            Flicker compares consecutive frames of one sensor; None: of no other frame.

        """
        shape = np.shape(valid)
        valid = _row(valid, np.bool_)
        classes = np.full(valid.size, UNKNOWN, np.uint16)
        if truth is not None:
            self._has_truth = True
            valid = mask_truth(_flat(truth, shape, 'truth'), self._table, valid, classes)
        if regions is None:
            codes = np.zeros(valid.size, np.uint8)
        else:
            self._has_regions = True
            codes = _row(regions, np.uint8) & np.uint8(CODES - 1)

        # None: no grid, so no pixel that could flicker.
        before = None if sensor is None else self._before.get(sensor)
        if before is None or before.shape != shape:     # a size that changes starts it anew
            before = Before(shape, np.zeros(valid.size, np.bool_), {})
        pairs, n_pairs = np.empty_like(valid), np.zeros(CODES, np.int64)
        count_valid(valid, before.valid, codes, pairs, self._pixels, n_pairs)
        images = predictions.items() if isinstance(predictions, Mapping) else predictions
        new: dict[str, NDArray[np.uint16]] = {}
        for name, image in (*images, *([] if truth is None else [(TRUTH, truth)])):
            if name not in self._tallies:
                raise PersemError(f'metrics: unexpected method {name!r}; expected one of '
                                  f'{", ".join(self.methods)}')
            tally = self._tallies[name]
            if name in before.labels:
                new[name], compared = before.labels[name], pairs
                tally.pairs += n_pairs
            else:                   # truth or method not given for the frame before
                new[name], compared = np.zeros(valid.size, np.uint16), np.zeros_like(pairs)
            tally.count(_flat(image, shape, name), classes, codes, compared, new[name],
                        self._table)
        if sensor is not None:
            self._before[sensor] = Before(shape, valid, new)

    def restart(self) -> None:
        """Begin flicker anew: the next frame does not follow the last one."""
        self._before.clear()

    def result(self) -> dict[str, Any]:
        """
        Return what was measured so far, as metrics.json has it.

        Returns
        -------
        dict
            truth_flicker in percent, methods {name: {pixel_accuracy, miou, flicker, iou}} in
            percent, regions {name: {share, truth_flicker, methods}}, empty where update was
            given none. None stands for what cannot be known: no truth, no pixels, one frame.

        """
        regions = {}
        if self._has_regions:
            regions = {name: {'share': self._share(name), **self._measured(name, iou=False)}
                       for name in (EVERYWHERE, *REGIONS)}
        return {**self._measured(EVERYWHERE, iou=True), 'regions': regions}

    @property
    def has_truth(self) -> bool:
        """Whether any frame so far had a truth, be it one of ignored ids alone."""
        return self._has_truth

    def flicker_counts(self) -> dict[str, tuple[int, int]]:
        """
        Return {method: (changed pixels, compared pixels)} so far, 'truth' among the methods.

        The difference between two calls is the flicker of the frames between them.

        """
        return {name: (int(tally.changed.sum()), int(tally.pairs.sum()))
                for name, tally in self._tallies.items()}

    def confusion(self, method: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """
        Return a method's confusion matrix.

        Returns
        -------
        ids : ndarray, shape (k,)
            All ids of truth or prediction, sorted; 65535 is "unknown".
        matrix : ndarray, shape (k, k)
            Pixels by true id (row) and predicted id (column).

        """
        true, predicted, counts = self._tallies[method].triples(EVERYWHERE)
        ids, places = np.unique(np.concatenate([true, predicted]), return_inverse=True)
        matrix = np.zeros((len(ids), len(ids)), np.int64)
        np.add.at(matrix, tuple(places.reshape(2, -1)), counts)
        return ids, matrix

    def _measured(self, region: str, iou: bool) -> dict[str, Any]:
        """Return flicker and accuracy of every method within one region."""
        return {'truth_flicker': self._tallies[TRUTH].flicker(region),
                'methods': {name: self._tallies[name].measured(region, self._has_truth, iou)
                            for name in self.methods}}

    def _share(self, region: str) -> float | None:
        """Return the percentage of all valid pixels that lie in the region."""
        return percent(self._pixels[codes_of(region)].sum(), self._pixels.sum())


def valid_pixels(
        labels: NDArray[Any], depth: NDArray[np.float64], ignore_labels: Sequence[int],
        min_depth: float, max_depth: float, truth: NDArray[Any] | None = None
) -> NDArray[np.bool_]:
    """
    Return the mask of the pixels that count in every method's metrics.

    Parameters
    ----------
    labels : ndarray, shape (H, W), integers
        The input labels.
    depth : ndarray, shape (H, W)
        Metres; a measurement in range makes a pixel valid.
    ignore_labels : sequence of int
        Ids that are no labels; those below 0 and above 65534 never are.
    min_depth, max_depth : float
        Metres.
    truth : ndarray, shape (H, W), integers, optional
        True labels, subject to the same ids.

    Returns
    -------
    ndarray, shape (H, W)

    """
    shape = np.shape(depth)
    depth = _row(depth, np.float64)
    given = [_flat(labels, shape, 'labels')] + (
        [] if truth is None else [_flat(truth, shape, 'truth')])
    valid = np.empty(depth.size, np.bool_)
    mask_depth(depth, float(min_depth), float(max_depth), valid)
    ignored = np.array([c for c in ignore_labels if 0 <= c < UNKNOWN], np.int32)
    for ids in given:
        mask_ids(ids, ignored, valid)
    return valid.reshape(shape)


def _table(taxonomy: Mapping[int, int] | None) -> NDArray[np.uint16]:
    """Return the look-up table id -> counted id, UNKNOWN for none, (65536,) uint16; none: (0,)."""
    if taxonomy is None:
        return np.empty(0, np.uint16)
    table = np.full(UNKNOWN + 1, UNKNOWN, np.uint16)
    for fine, coarse in taxonomy.items():
        if not (0 <= fine < UNKNOWN and 0 <= coarse < UNKNOWN):
            raise PersemError(f'taxonomy: {fine} to {coarse}: expected ids from 0 to '
                              f'{UNKNOWN - 1}')
        table[fine] = coarse
    return table


def _flat(labels: NDArray[Any], shape: tuple[int, ...], name: str) -> NDArray[np.int32]:
    """Return a label image as (H * W,) int32, or refuse another size."""
    if np.shape(labels) != shape:
        raise PersemError(f'metrics: {name} has shape {np.shape(labels)}, expected {shape} as '
                          'the mask of valid pixels')
    return _row(labels, np.int32)


def _row(image: NDArray[Any], kind: type[Number]) -> NDArray[Number]:
    """Return the pixels of an image one after the other, of the type that the kernels want."""
    return np.require(image, kind, ('C', 'W')).reshape(-1)


@kernel
def mask_depth(depth, low, high, valid):
    """Write whether each depth is in range: valid, (n,) bool."""
    for i in range(len(depth)):
        valid[i] = (low <= depth[i]) & (depth[i] <= high) & (depth[i] > 0.0)


@kernel
def mask_ids(ids, ignored, valid):
    """
    Make pixels invalid whose id does not count.

    A loop over all pixels for each of the few ignored ids, which the compiler turns into vector
    instructions, is faster than looking each pixel's id up (with depth and truth, 640 x 480
    pixels: 1.3 ms instead of 1.8).

    """
    for i in range(len(ids)):
        valid[i] &= np.uint32(ids[i]) < UNKNOWN     # a negative label is a huge unsigned one
    for c in ignored:
        for i in range(len(ids)):
            valid[i] &= ids[i] != c


@kernel
def mask_truth(truth, table, valid, classes):
    """Return valid & (true label is counted); write the counted ids, UNKNOWN for none."""
    counted(truth, table, classes)
    result = np.empty(len(truth), np.bool_)
    for i in range(len(truth)):
        classes[i] = classes[i] if valid[i] else UNKNOWN
        result[i] = classes[i] != UNKNOWN
    return result


@kernel
def count_valid(valid, had, codes, pairs, pixels, n_pairs):
    """Write pairs = valid & had, (n,) bool, and add the numbers of both by region code."""
    keys = np.empty(len(valid), np.uint16)
    for i in range(len(valid)):
        pairs[i] = valid[i] & had[i]
        keys[i] = np.uint16(codes[i]) << np.uint16(2) | np.uint16(valid[i]) << np.uint16(1) \
            | np.uint16(pairs[i])
    lanes = np.zeros((LANES, 4 * CODES), np.uint32)
    count_keys(keys, lanes)
    for key in range(4 * CODES):
        n = lanes[:, key].sum()
        pixels[key >> 2] += n * (key >> 1 & 1)
        n_pairs[key >> 2] += n * (key & 1)
