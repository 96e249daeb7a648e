"""Rendering a frame by several methods at once, on the same voxels and the same pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.images import counted, on_depth, on_labels
from persem_ros.core.frame.render import filled, render
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.core.refine.in_view import InView
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.regions import regions
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.results.metrics import valid_pixels
from persem_ros.settings.config import IMAGE_METHODS

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.frames import Frame
    from persem_ros.pipeline import Pipeline
    from persem_ros.settings.config import Memory


@dataclass(frozen=True, eq=False)
class Rendering:
    """
    One frame as every method sees it, on the depth grid (h, w).

    Attributes
    ----------
    images : dict of (h, w) int32
        Labels by method; UNKNOWN (65535) where a method has none.
    voxels : ndarray, shape (h, w), int32
        Voxel numbers, -1 for none.
    labels : ndarray, shape (h, w), int32
        The input labels.
    truth : ndarray, shape (h, w), int32, optional
    valid : ndarray, shape (h, w), bool
        The pixels that count (spec section 6).
    published : ndarray, shape (H, W), int32
        The refined image as a node publishes it, on the labels' grid.

    """

    images: dict[str, NDArray[np.int32]]
    voxels: NDArray[np.int32]
    labels: NDArray[np.int32]
    truth: NDArray[np.int32] | None
    valid: NDArray[np.bool_]
    published: NDArray[np.int32]


class Renderer:
    """
    Labels of the map by method, and frames rendered from them.

    Parameters
    ----------
    pipeline : Pipeline
    methods : sequence
        Image-space and voxel methods; the pipeline's own refine.method comes from the map
        itself, the others from a labelling of their own.

    """

    def __init__(self, pipeline: Pipeline, methods: Sequence[str]) -> None:
        self.pipeline, self.methods = pipeline, tuple(methods)
        # By method: labels of its own, by voxel number, and those of all voxels of today.
        self._labels: dict[str, NDArray[np.uint16]] = {}
        self._gathered: dict[str, NDArray[np.uint16]] = {}
        self._gathered_at: tuple[int, int] | None = None
        self._smoothers: dict[str, EmaImages] = {}
        self._codes: NDArray[np.uint8] | None = None
        self._in_view: InView | None = None     # where memory holds a part of a refined map

    def restart(self) -> None:
        """Smooth no image with one of another recording."""
        self._smoothers.clear()

    def relabel(self) -> None:
        """Label the map anew by every method that needs it; call it after each refinement."""
        if self.pipeline.memory.pager is None:
            for method in self._others():
                self._labels[method] = label(self.pipeline.memory, method,
                                             self.pipeline.config.refine)[0]
        self._gathered_at = None

    def classify(self) -> None:
        """Find the regions of a map that changes no more; call it after relabel()."""
        memory, settings = self.pipeline.memory, self.pipeline.config.refine
        if memory.pager is not None:
            self._in_view = InView(memory, self._others(), settings)
        else:
            self._codes = regions(memory, settings.neighbours)[0]

    def labelled(self, method: str) -> NDArray[np.uint16] | None:
        """Return the last labels by voxel number of a method beside the map's own, if any."""
        return self._labels.get(method)

    @property
    def codes(self) -> NDArray[np.uint8] | None:
        """Return the region codes by voxel number, as of the last render()."""
        return self._codes if self._in_view is None else self._in_view.codes

    def render(self, frame: Frame, observations: Observations | None = None) -> Rendering:
        """Render a frame; observations save placing its pixels again."""
        config = self.pipeline.config
        if self._in_view is not None:
            observations = self.pipeline.sighted(frame)
            self._in_view.look(observations.voxels)
        voxels = self.pipeline.voxel_image(frame, observations)
        labels = on_depth(frame, frame.labels)
        truth = None if frame.truth is None else on_depth(frame, frame.truth)
        own = render(voxels, self._of(config.refine.method))
        moving = _any_of(labels, config.memory.dynamic_labels)
        images = {}
        for method in self.methods:
            if method == 'raw2d':
                images[method] = labels
            elif method == 'ema2d':
                images[method] = self._smoothed(frame.sensor, labels).astype(np.int32) \
                    if frame.has_grid else labels
            else:
                image = own if method == config.refine.method else \
                    render(voxels, self._of(method))
                images[method] = image.astype(np.int32)
                if moving is not None:
                    np.copyto(images[method], labels, where=moving)
        published = filled(on_labels(frame, own, UNKNOWN), frame.labels, config.memory,
                           config.render.fill, self.pipeline.unknown)
        valid = valid_pixels(labels, frame.depth, config.memory.ignore_labels,
                             config.memory.min_depth, config.memory.max_depth, truth)
        return Rendering(images, voxels, labels, truth, valid, published)

    def _of(self, method: str) -> NDArray[np.uint16]:
        """
        Return the labels (voxels,) uint16 of a voxel method, by voxel number.

        Gathered from the voxels' records anew where the map has changed: 0.5 ms for 300 000 of
        them, which a replay that renders from the finished map pays once.

        """
        memory = self.pipeline.memory
        now = memory.n_observations, 0 if memory.pager is None else memory.pager.turn
        if self._gathered_at != now:
            self._gathered, self._gathered_at = {}, now
        if method not in self._gathered:
            records = memory.m.voxels[:memory.n_numbers]
            if self._in_view is not None and method in self._in_view.labels:
                found = self._in_view.labels[method]
            elif method == self.pipeline.config.refine.method:
                found = np.ascontiguousarray(records['label'])
            else:
                found = np.ascontiguousarray(records['majority'])
                older = self._labels.get(method)
                if older is not None:   # voxels newer than the labelling follow the majority
                    found[:len(older)] = older
            self._gathered[method] = found
        return self._gathered[method]

    def _others(self) -> list[str]:
        """Return the voxel methods that label the map beside its own."""
        own = self.pipeline.config.refine.method
        return [m for m in self.methods if m not in (*IMAGE_METHODS, 'majority', own)]

    def _smoothed(self, sensor: str, labels: NDArray[np.int32]) -> NDArray[np.uint16]:
        """Return the labels of ema2d; ignored pixels leave the state as it is."""
        if sensor not in self._smoothers:
            self._smoothers[sensor] = EmaImages(self.pipeline.config.ema.alpha)
        return self._smoothers[sensor].update(
            counted(labels, _still(self.pipeline.config.memory)))


def _still(settings: Memory) -> Memory:
    """Return the settings as if nothing moved: all ids count that are not ignored."""
    return replace(settings, dynamic_labels=(-1,))


def _any_of(labels: NDArray[np.int32], ids: Sequence[int]) -> NDArray[np.bool_] | None:
    """Return the mask of the labels that are among *ids*, None where no id can be."""
    ids = [c for c in ids if c >= 0]
    return np.logical_or.reduce([labels == c for c in ids]) if ids else None
