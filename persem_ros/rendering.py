"""Rendering a frame by several methods at once, on the same voxels and the same pixels."""

from dataclasses import dataclass

import numpy as np

from persem_ros.config import IMAGE_METHODS
from persem_ros.core.images import counted, resampled
from persem_ros.core.refine import label
from persem_ros.core.render import filled, render
from persem_ros.core.smoothing import EmaImages
from persem_ros.outputs.metrics import valid_pixels
from persem_ros.frames import UNKNOWN


@dataclass(frozen=True, eq=False)
class Rendering:
    """
    One frame as every method sees it, on the depth grid (h, w).

    Attributes
    ----------
    images : dict of str to ndarray, shape (h, w), int32
        Labels by method; UNKNOWN (65535) where a method has none.
    voxels : ndarray, shape (h, w), int32
        Voxel numbers, -1 for none.
    labels : ndarray, shape (h, w), int32
        The input labels.
    truth : ndarray, shape (h, w), int32, or None
    valid : ndarray, shape (h, w), bool
        The pixels that count (spec section 6).
    published : ndarray, shape (H, W), int32
        The refined image as a node publishes it, on the labels' grid.

    """

    images: dict
    voxels: np.ndarray
    labels: np.ndarray
    truth: np.ndarray
    valid: np.ndarray
    published: np.ndarray


class Renderer:
    """
    Labels of the map by method, and frames rendered from them.

    Parameters
    ----------
    pipeline : persem_ros.pipeline.Pipeline
    methods : sequence of str
        Image-space and voxel methods; the pipeline's own refine.method comes from the map
        itself, the others from a labelling of their own.

    """

    def __init__(self, pipeline, methods):
        self.pipeline, self.methods = pipeline, tuple(methods)
        self._labels = {}
        self._smoothers = {}

    def relabel(self):
        """Label the map anew by every method that needs it."""
        config = self.pipeline.config
        for method in self.methods:
            if method not in IMAGE_METHODS + ('majority', config.refine.method):
                self._labels[method] = label(self.pipeline.memory, method, config.refine)[0]

    def render(self, frame, observations=None):
        """Return the Rendering of a frame; observations save placing its pixels again."""
        config = self.pipeline.config
        voxels = self.pipeline.voxel_image(frame, observations)
        labels = resampled(frame.labels, frame.depth.shape)
        truth = None if frame.truth is None else resampled(frame.truth, frame.depth.shape)
        images = {}
        for method in self.methods:
            if method == 'raw2d':
                images[method] = labels
            elif method == 'ema2d':
                images[method] = self._smoothed(frame.sensor, labels).astype(np.int32)
            else:
                images[method] = filled(render(voxels, self._of(method)), labels, config.memory,
                                        'unknown', UNKNOWN)
        own = render(voxels, self._of(config.refine.method))
        published = filled(own, frame.labels, config.memory, config.render.fill,
                           self.pipeline.unknown)
        valid = valid_pixels(labels, frame.depth, config.memory.ignore_labels,
                             config.memory.min_depth, config.memory.max_depth, truth)
        return Rendering(images, voxels, labels, truth, valid, published)

    def _of(self, method):
        """Return the labels (voxels,) uint16 of a voxel method, by voxel number."""
        memory = self.pipeline.memory
        records = memory.m.voxels[:memory.n_numbers]
        if method == self.pipeline.config.refine.method:
            return np.ascontiguousarray(records['label'])
        majority = np.ascontiguousarray(records['majority'])
        older = self._labels.get(method)
        if older is not None:       # voxels newer than the labelling follow the majority
            majority[:len(older)] = older
        return majority

    def _smoothed(self, sensor, labels):
        """Return the labels of ema2d; ignored pixels leave the state as it is."""
        if sensor not in self._smoothers:
            self._smoothers[sensor] = EmaImages(self.pipeline.config.ema.alpha)
        return self._smoothers[sensor].update(
            counted(labels, _without_stride(self.pipeline.config.memory)))


def _without_stride(settings):
    """Return the settings that say which ids count, for whole images."""
    from dataclasses import replace
    return replace(settings, stride=1, dynamic_labels=(-1,))
