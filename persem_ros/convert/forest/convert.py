"""
A sequence of Forest Inspection becomes a recording.

The synthetic part (AirSim) and the real one (WildUAV). The data set documents colours of classes
and little else: everything that is not documented is an option here, with a default.

"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert import axes
from persem_ros.convert.checks import check_conventions, sampled
from persem_ros.convert.files import files_of, some
from persem_ros.convert.forest import poses as forest_poses
from persem_ros.convert.forest.colors import ids_of_colors
from persem_ros.convert.forest.layout import find, find_poses, folder_of, ForestOptions, partners
from persem_ros.convert.images import (
    metres, nearest, parse_unit, read_array, read_color, read_depth, read_labels, scaled_K,
    units_per_metre)
from persem_ros.convert.intrinsics import is_numbers, read_intrinsics
from persem_ros.convert.scene import check_scale, chosen, report_dropped, write_scene
from persem_ros.convert.stamps import stamps_from_names, stamps_from_rate
from persem_ros.errors import PersemError
from persem_ros.frames import same_aspect
from persem_ros.outputs.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from persem_ros.convert.scene import SceneWriter
    from persem_ros.settings.legend import Legend

LOG = logging.getLogger(__name__)
CODED_METRES = 1000.0       # of the largest 24-bit number, as CARLA packs depth


def convert_forest(root: Path | str, name: str, path: Path | str,
                   options: ForestOptions | None = None, legend: Legend | None = None,
                   **writing: Any) -> str:
    """
    Convert one sequence.

    Parameters
    ----------
    root : str or Path
        The folder that holds the sequences.
    name : str
        The sequence, for example seq1.
    path : str or Path
        The recording to write.
    options : ForestOptions, optional
        How to read it.
    legend : Legend
        Its colours are those of the label images.
    **writing
        As in convert_frames(), like what is returned and raised.

    """
    options = options or ForestOptions()
    check_scale(options.scale)
    if not 1 <= options.fov <= 170:
        raise PersemError(f'--fov {options.fov:g}: expected 1 to 170 degrees')
    writer = RecordingWriter(path, **writing)       # refuse now, not after the reading
    sequence = Sequence(folder_of(root, name), options, legend)
    if options.check:
        sequence.check()
    trajectory = ((sequence.stamps[key], sequence.pose(key)) for key in sequence.keys)
    return write_scene(writer, legend, trajectory, sequence.keys, sequence.write)


class Sequence:
    """The files of one sequence that belong together."""

    def __init__(self, folder: Path, options: ForestOptions, legend: Legend | None) -> None:
        self.options, self.legend = options, legend
        found = {'labels': find(folder, 'labels', options.labels, bool(options.predictions)),
                 'depth': find(folder, 'depth', options.depth),
                 'color': find(folder, 'color', options.color, True)}
        self.inputs = files_of(Path(options.predictions), '*') if options.predictions \
            else found['labels']
        if not options.predictions:
            LOG.warning('no --predictions: the true labels are the label input')
        self.poses, self.matrices, self.airsim = find_poses(
            folder, options.pose, list(self.inputs), options.pitch)
        self.truth, self.depth, self.color = (partners(self.inputs, found[what])
                                              for what in ('labels', 'depth', 'color'))
        self.stamps = stamps_from_names(self.inputs) or stamps_from_rate(
            list(self.inputs), options.rate, options.start)
        if options.depth_coding not in ('plain', 'rgb24'):
            raise PersemError(f'--depth-coding {options.depth_coding}: expected plain or rgb24')
        dropped = {'without depth': [k for k in self.inputs if k not in self.depth],
                   'without a pose': [k for k in self.inputs if k in self.depth and
                                      forest_poses.pose_of_image(self.poses, k) is None]}
        left = [k for k in self.inputs if not any(k in keys for keys in dropped.values())]
        if not left:
            raise PersemError(
                f'{folder}: no frame is complete: {len(self.inputs)} label images '
                f'({some(self.inputs)}), {len(found["depth"])} depth files, '
                f'{len(self.poses.by_key)} poses; the names must match')
        report_dropped(dropped)
        left.sort(key=self.stamps.__getitem__)
        self.keys = chosen(left, options.frames, options.every)

    def pose(self, key: str) -> NDArray[np.float64]:
        """Return T_map_camera of a frame."""
        T = forest_poses.pose_of_image(self.poses, key)
        assert T is not None, 'frames without a pose were left out'
        return axes.optical_pose(T, *self.conventions)

    @property
    def conventions(self) -> tuple[str, str, str]:
        """Return direction, axes and world of the poses."""
        return (self.options.direction, self.options.axes or ('ned' if self.airsim else 'opencv'),
                self.options.world or ('ned' if self.airsim else 'enu'))

    def write(self, scene: SceneWriter, key: str) -> None:
        """Write the images of one frame."""
        depth = self.read_depth(key)
        size = _scaled((depth.shape[1], depth.shape[0]), self.options.scale)
        K = self.K(key, size)
        stamp = self.stamps[key]
        labels = nearest(self.ids(self.inputs[key], size), size)
        scene.labels(stamp, labels, 'mono8' if labels.dtype == np.uint8 else 'mono16')
        if key in self.truth:
            truth = nearest(self.ids(self.truth[key], size), size)
            scene.truth(stamp, truth, 'mono8' if truth.dtype == np.uint8 else 'mono16')
        scene.depth(stamp, nearest(depth, size), '32FC1', K)
        if key in self.color:
            scene.color(stamp, *read_color(self.color[key], size))

    def K(self, key: str, size: tuple[int, int]) -> NDArray[np.float64]:
        """Return the pinhole matrix of a frame for images of *size* (width, height)."""
        if self.options.intrinsics:
            text = self.options.intrinsics
            found = read_intrinsics(text if is_numbers(text) else Path(text))
            full = found.size or self._full(key)
            return scaled_K(found.K, full, size)
        if key in self.matrices:
            return scaled_K(self.matrices[key], self._full(key), size)
        return forest_poses.fov_matrix(*size, self.options.fov)

    def ids(self, path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return a label file as ids: those that it has, or those of its colours."""
        array = read_array(path)
        if not same_aspect((array.shape[1], array.shape[0]), size):
            raise PersemError(f'{path}: {array.shape[1]}x{array.shape[0]}, but depth is '
                              f'{size[0]}x{size[1]}; expected one aspect ratio')
        if array.ndim == 2:
            ids = read_labels(path)[0]
            if ids.min() < 0 or ids.max() > 65535:
                raise PersemError(f'{path}: expected ids from 0 to 65535')
            return ids.astype(np.uint8 if ids.max() < 256 else np.uint16)
        if self.legend is None:
            raise PersemError(f'{path}: colours instead of ids, and no legend that says which are '
                              'whose; give one with --legend')
        return ids_of_colors(array[..., 2::-1], self.legend, path)

    def read_depth(self, key: str) -> NDArray[np.float32]:
        """Return the depth of a frame, (h, w) float32, metres along the axis; 0: none."""
        path = self.depth[key]
        if self.options.depth_coding == 'rgb24':
            array = read_array(path)
            if array.ndim != 3 or array.dtype != np.uint8:
                raise PersemError(f'{path}: --depth-coding rgb24 needs an 8-bit colour image')
            b, g, r = (array[..., k].astype(np.float64) for k in range(3))
            depth = (r + 256 * g + 65536 * b) / (2**24 - 1) * CODED_METRES
        else:
            depth = metres(*read_depth(path, parse_unit(self.options.depth_unit or None)))
        if self.options.depth_is == 'ray':
            height, width = depth.shape
            K = self.K(key, (width, height))
            x = (np.arange(width) - K[0, 2]) / K[0, 0]
            y = (np.arange(height) - K[1, 2]) / K[1, 1]
            depth = depth / np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
        return depth.astype(np.float32)

    def check(self) -> None:
        """Reproject some depth images to see whether unit, axes and world fit."""
        depths, places = sampled(
            len(self.keys), lambda i: self.read_depth(self.keys[i]),
            lambda i: forest_poses.pose_of_image(self.poses, self.keys[i]))
        if not depths:
            return
        shape = next(iter(depths.values())).shape
        per_metre = 0 if self.options.depth_coding == 'rgb24' else units_per_metre(
            self.depth[self.keys[0]], parse_unit(self.options.depth_unit or None))
        check_conventions(depths, places, self.K(self.keys[0], shape[::-1]), self.conventions,
                          per_metre)

    def _full(self, key: str) -> tuple[int, int]:
        """Return the (width, height) of the images that the intrinsics belong to."""
        array = read_array(self.color.get(key) or self.depth[key])
        return array.shape[1], array.shape[0]


def _scaled(size: tuple[int, int], scale: float) -> tuple[int, int]:
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
