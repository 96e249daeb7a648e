"""Counting frames for all methods at once: by kind of voxel and true class (spec section 6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import kernel
from persem_ros.evaluate.measure.counts import Block, Counts
from persem_ros.frames import UNKNOWN

if TYPE_CHECKING:
    from persem_ros.evaluate.measure.classes import Classes
    from persem_ros.evaluate.measure.voxel_kinds import Kinds
    from persem_ros.settings.config import Memory

Number = TypeVar('Number', np.int32, np.float64)


class Before(NamedTuple):
    """What the frame before left, by pixel: class numbers as of count()."""

    shape: tuple[int, ...]          # of the depth image
    kinds: NDArray[np.int32]        # (pixels,)
    truth: NDArray[np.int32]        # (pixels,)
    images: NDArray[np.uint16]      # (methods on images, pixels)


class Counter:
    """
    Counts frames into blocks: stretches of consecutive frames, for intervals.

    Parameters
    ----------
    kinds : evaluate.measure.voxel_kinds.Kinds
    classes : Classes
        With which the kinds were made.
    methods : sequence of str
        Those on images first, then those on voxels in the order of kinds.classes.
    images : int
        Number of methods on images.
    settings : persem_ros.settings.config.Memory
        Depth range and ignored ids.

    """

    def __init__(self, kinds: Kinds, classes: Classes, methods: Sequence[str], images: int,
                 settings: Memory) -> None:
        self.kinds, self.classes, self.methods = kinds, classes, tuple(methods)
        self.low, self.high = float(settings.min_depth), float(settings.max_depth)
        self.ignored = np.zeros(UNKNOWN + 1, np.bool_)
        self.ignored[[c for c in settings.ignore_labels if 0 <= c <= UNKNOWN] + [UNKNOWN]] = True
        self.counts = Counts(len(methods), images)
        self.rows = np.zeros((len(kinds.codes), self.counts.size), np.int64)
        self.has_truth = False
        self._before: dict[str, Before] = {}        # by sensor
        self._shown = np.zeros((2, len(methods) + 1), np.int64)

    def frame(self, labels: NDArray[np.int32], depth: NDArray[np.float64],
              voxels: NDArray[np.int32], truth: NDArray[np.int32] | None = None,
              images: Sequence[NDArray[Any]] = (), sensor: str = '') -> NDArray[np.int64]:
        """
        Count one integrated frame.

        Parameters
        ----------
        labels : ndarray, shape (h, w)
            The input labels on the depth's grid.
        depth : ndarray, shape (h, w)
            Metres.
        voxels : ndarray, shape (h, w)
            Voxel numbers; -1: none.
        truth : ndarray, shape (h, w), optional
            True labels.
        images : sequence of ndarray, shape (h, w), integers
            Labels of the methods on images.
        sensor : str
            Flicker compares consecutive frames of one sensor.

        Returns
        -------
        changed, pairs : ndarray, shape (methods + 1,)
            Pixels of this frame whose label changed and that were compared, the truth last.

        """
        shape = depth.shape
        images = [_flat(image, np.int32) for image in images]
        for image in (labels, *images, *([] if truth is None else [truth])):
            self.classes.meet(image)
        self._make_room()
        self.has_truth |= truth is not None
        before = self._before.get(sensor)
        if before is None or before.shape != shape:
            before = Before(shape, np.full(depth.size, -1, np.int32),
                            np.full(depth.size, -1, np.int32),
                            np.zeros((len(images), depth.size), np.uint16))
        count(_flat(labels, np.int32), _flat(depth, np.float64), _flat(voxels, np.int32),
              _flat(labels if truth is None else truth, np.int32), truth is not None,
              np.array(images, np.int32).reshape(len(images), depth.size),
              self.kinds.of, self.kinds.classes, self.kinds.codes, self.kinds.moving,
              self.classes.index, self.ignored, self.classes.table is not None,
              self.low, self.high, before.kinds, before.truth, before.images, self.rows,
              self.counts.matrix, self.counts.changed, self.counts.pairs,
              self.counts.true_pairs, self.counts.pixels, self.classes.outside)
        self._before[sensor] = before
        return self._news()

    def block(self) -> Block:
        """Return the counts since the last block by region, as Block; begin the next."""
        counts = self.counts
        spread(self.rows, self.kinds.codes, self.kinds.classes, counts.matrix, counts.n_images)
        block = Block.of(counts)
        counts.clear()
        self.rows[:] = 0
        self._shown[:] = 0
        return block

    def _news(self) -> NDArray[np.int64]:
        """Return what the last frame added to changed and compared pixels."""
        counts = self.counts
        now = np.stack([counts.changed.sum(1), np.append(
            np.full(len(self.methods), counts.pairs.sum()), counts.true_pairs.sum())])
        new = now - self._shown
        self._shown = now
        return new

    def _make_room(self) -> None:
        """Let all tables hold the classes that are known by now."""
        if len(self.classes) > self.counts.size:
            size = 2 * self.counts.size
            while size < len(self.classes):
                size *= 2
            self.counts.grow(size)
            rows = np.zeros((len(self.rows), size), np.int64)
            rows[:, :self.rows.shape[1]] = self.rows
            self.rows = rows


def _flat(image: NDArray[Any], kind: type[Number]) -> NDArray[Number]:
    """Return the pixels of an image one after the other, of the type that count() wants."""
    return np.require(image, kind, ('C', 'W')).reshape(-1)


@kernel
def count(labels, depth, voxels, truth, with_truth, images, kind_of, classes, codes, moving,
          index, ignored, tabled, low, high, kind_before, truth_before, images_before, rows,
          matrix, changed, pairs, true_pairs, pixels, outside):
    """
    Count the pixels of one frame; kind, truth and images *before* are replaced on the way.

    kind_before is -1 where the pixel was not valid, truth_before where it had no truth.

    """
    n_images, methods = len(images), len(changed) - 1
    for p in range(len(labels)):
        c = np.int64(labels[p])
        valid = low <= depth[p] <= high and depth[p] > 0.0 and 0 <= c < 65535
        valid = valid and not ignored[c]
        t = np.int64(-1)
        if valid and with_truth:
            true = np.int64(truth[p])
            valid = 0 <= true < 65535 and not ignored[true]
            if valid:
                t = np.int64(index[true])
                if t == 0 and tabled:
                    outside[true] += 1
                    valid = False
        if not valid:
            kind_before[p] = -1
            truth_before[p] = -1
            continue
        v = voxels[p]
        kind = np.int64(kind_of[v]) if v >= 0 else 0
        code = np.int64(codes[kind])
        if moving[c] >= 0:
            kind = np.int64(moving[c]) + code
        pixels[code] += 1
        if t >= 0:
            rows[kind, t] += 1
        older = np.int64(kind_before[p])
        if older >= 0:
            pairs[code] += 1
            if older != kind:
                for m in range(n_images, methods):
                    changed[m, code] += \
                        classes[older, m - n_images] != classes[kind, m - n_images]
            if t >= 0 and truth_before[p] >= 0:
                true_pairs[code] += 1
                changed[methods, code] += t != truth_before[p]
        for m in range(n_images):
            i = np.int64(images[m, p])
            new = np.int64(index[i]) if 0 <= i < 65535 else 0
            if t >= 0:
                matrix[m, code, t, new] += 1
            if older >= 0:
                changed[m, code] += new != images_before[m, p]
            images_before[m, p] = new
        kind_before[p] = kind
        truth_before[p] = t


@kernel
def spread(rows, codes, classes, matrix, n_images):
    """Add the pixels of each kind and true class to the matrices of all methods on voxels."""
    for kind in range(len(rows)):
        for t in range(rows.shape[1]):
            n = rows[kind, t]
            if n > 0:
                for m in range(classes.shape[1]):
                    matrix[n_images + m, codes[kind], t, classes[kind, m]] += n
