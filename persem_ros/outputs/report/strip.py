"""The strip of frames: which are kept while the replay runs, and their panels on the page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.report.colors import SOURCE_COLORS, VERDICT_COLORS
from persem_ros.outputs.report.png import data_uri, indexed_png, jpeg

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.rendering import Rendering
    from persem_ros.settings.legend import Legend

FRAMES = 12         # on the page
WIDTH = 640         # pixels of a panel, at most


@dataclass(frozen=True, eq=False)
class Sample:
    """
    What is kept of one frame, thinned to panels of at most WIDTH columns.

    Attributes
    ----------
    number : int
        Of the frame, from 0.
    stamp : int
        Nanoseconds.
    sensor : str
    images : dict of str to ndarray, shape (h, w)
        input, majority, refined and truth, those that there are; 65535: no label.
    source : ndarray, shape (h, w)
        What decided the voxel behind each pixel (cloud.SOURCES).
    valid : ndarray, shape (h, w)
        The pixels that count in the metrics.
    color : ndarray, shape (h, w, 3), optional
        Red, green, blue.

    """

    number: int
    stamp: int
    sensor: str
    images: dict[str, NDArray[np.uint16]]
    source: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    color: NDArray[np.uint8] | None


class Strip:
    """
    Frames spread evenly over a replay whose length is only roughly known.

    Every n-th frame is kept; n doubles when too many have come together.

    """

    def __init__(self, expected: int, frames: int = FRAMES) -> None:
        self.frames = frames
        self._samples: list[Sample] = []
        self._seen = 0
        self._step = max(1, int(expected) // (2 * frames))

    def offer(self, make: Callable[[int], Sample]) -> None:
        """Count a frame; keep the Sample that make(number) returns if it is one to be kept."""
        if self._seen % self._step == 0:
            self._samples.append(make(self._seen))
        self._seen += 1
        if len(self._samples) > 3 * self.frames:
            self._samples = self._samples[::2]
            self._step *= 2

    def chosen(self) -> list[Sample]:
        """Return at most as many Samples as fit on the page, first and last among them."""
        last = len(self._samples) - 1
        places = np.linspace(0, last, min(self.frames, last + 1)).round().astype(int)
        return [self._samples[place] for place in places]


def sample(number: int, frame: Frame, rendering: Rendering, method: str, fill: str,
           sources: NDArray[np.uint8]) -> Sample:
    """
    Return the Sample of a rendered frame.

    Parameters
    ----------
    number : int
        Of the frame, from 0.
    frame : persem_ros.frames.Frame
        For its stamp, sensor and colour.
    rendering : persem_ros.rendering.Rendering
        The frame as the methods see it.
    method : str
        The method whose image is "refined".
    fill : str
        render.fill: 'input' shows the frame's own label where the map has none.
    sources : ndarray, shape (voxels,), uint8
        By voxel number.

    """
    step = -(-rendering.labels.shape[1] // WIDTH)

    def thin(image: NDArray[Any]) -> NDArray[Any]:
        return image[min(step // 2, len(image) - 1)::step, step // 2::step]   # a cloud: one row

    given = {'input': rendering.labels, 'majority': rendering.images.get('majority'),
             'refined': rendering.images[method], 'truth': rendering.truth}
    images = {name: _ids(thin(image)) for name, image in given.items() if image is not None}
    for name in ('majority', 'refined'):
        if name in images and fill == 'input':
            images[name] = np.where(images[name] == UNKNOWN, images['input'], images[name])
    voxels = thin(rendering.voxels)
    source = np.where(voxels >= 0, sources[voxels] if len(sources) else 0, 0).astype(np.uint8)
    color = frame.color
    if color is not None:
        color = np.asarray(cv2.resize(color, voxels.shape[::-1], interpolation=cv2.INTER_AREA),
                           np.uint8)
    return Sample(number, frame.stamp, frame.sensor, images, source, thin(rendering.valid).copy(),
                  color)


def panels(sample: Sample, legend: Legend, method: str) -> list[dict[str, Any]]:
    """
    Return the panels of a Sample as the page shows them.

    Returns
    -------
    list of dict
        key, title, note (text below), image and overlay (data URIs, either may be missing),
        second (another overlay to choose) and shape (h, w).

    """
    color = None if sample.color is None else data_uri('image/jpeg', jpeg(sample.color))
    result: list[dict[str, Any]] = []
    if color:
        result.append({'key': 'color', 'title': 'image', 'image': color})
    for key, title in (('input', 'input labels'), ('majority', 'majority'),
                       ('refined', f'refined ({method})'), ('truth', 'truth')):
        if key in sample.images and not (key == 'majority' and method == 'majority'):
            result.append({'key': key, 'title': title, 'note': _right(sample, key),
                           'image': _label_png(sample.images[key], legend)})
    changed = sample.images['refined'] != sample.images['input']
    why = np.where(changed, sample.source + 1, 0).astype(np.uint8)
    result.append({
        'key': 'changed', 'title': 'what changed, and why', 'image': color,
        'overlay': _overlay(why, SOURCE_COLORS),
        'note': f'{100 * changed.mean():.1f} % of the pixels'})
    if 'truth' in sample.images:
        result[-1]['second'] = _overlay(verdict(sample), VERDICT_COLORS)
        result[-1]['second_note'] = _balance(sample)
    for panel in result:
        panel.setdefault('note', '')
        panel['shape'] = sample.source.shape
    return result


def verdict(sample: Sample) -> NDArray[np.uint8]:
    """Return (h, w) uint8: 1 where the change mended a label, 2 where it spoilt one, else 0."""
    before, after, truth = (sample.images[name] for name in ('input', 'refined', 'truth'))
    mended = sample.valid & (before != truth) & (after == truth)
    spoilt = sample.valid & (before == truth) & (after != truth)
    return (mended + 2 * spoilt).astype(np.uint8)


def _balance(sample: Sample) -> str:
    valid = max(1, np.count_nonzero(sample.valid))
    counts = np.bincount(verdict(sample).ravel(), minlength=3)
    return f'{100 * counts[1] / valid:.1f} % mended, {100 * counts[2] / valid:.1f} % spoilt'


def _right(sample: Sample, name: str) -> str:
    """Return how much of an image is right, as text; '' where that is not known."""
    if 'truth' not in sample.images or name == 'truth' or not sample.valid.any():
        return ''
    right = (sample.images[name] == sample.images['truth'])[sample.valid].mean()
    return f'{100 * right:.1f} % right'


def _ids(labels: NDArray[np.int32]) -> NDArray[np.uint16]:
    """Return labels as uint16, UNKNOWN for those that are none."""
    return np.where((labels < 0) | (labels > UNKNOWN), UNKNOWN, labels).astype(np.uint16)


def _label_png(labels: NDArray[np.uint16], legend: Legend) -> str:
    """Return a label image in the legend's colours as a data URI."""
    ids = np.flatnonzero(np.bincount(labels.ravel(), minlength=UNKNOWN + 1))
    if len(ids) > 256:      # more than a palette holds: the rest share its last colour
        ids = ids[:256]
    place = np.full(UNKNOWN + 1, len(ids) - 1, np.uint8)
    place[ids] = np.arange(len(ids))
    return data_uri('image/png', indexed_png(place[labels], legend.colors(ids)))


def _overlay(index: NDArray[np.uint8], colors: tuple[tuple[int, int, int], ...]) -> str:
    palette = np.array([(0, 0, 0), *colors], np.uint8)
    return data_uri('image/png', indexed_png(index, palette, clear=0))
