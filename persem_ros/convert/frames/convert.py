"""Folders of label, depth and pose files (7-Scenes, ScanNet, TUM, …) become a recording."""

from __future__ import annotations

from collections.abc import Iterator
import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert import axes
from persem_ros.convert.checks import check_conventions, sampled
from persem_ros.convert.frames.layout import (
    find_frames, FramesOptions, intrinsics_source, layout_unit, say_unregistered)
from persem_ros.convert.images import (
    metres, parse_unit, read_color, read_depth, read_labels, scaled_K, units_per_metre)
from persem_ros.convert.intrinsics import read_intrinsics
from persem_ros.convert.scene import write_scene
from persem_ros.errors import PersemError
from persem_ros.frames import same_aspect
from persem_ros.outputs.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from persem_ros.convert.frames.layout import Item
    from persem_ros.convert.intrinsics import Intrinsics
    from persem_ros.convert.poses import Poses
    from persem_ros.convert.scene import SceneWriter
    from persem_ros.settings.legend import Legend

LOG = logging.getLogger(__name__)


def convert_frames(folder: Path | str, path: Path | str, options: FramesOptions | None = None,
                   legend: Legend | None = None, **writing: Any) -> str:
    """
    Convert a folder of images and poses.

    Parameters
    ----------
    folder : str or Path
        The data set.
    path : str or Path
        The recording to write.
    options : FramesOptions, optional
        How to read the folder.
    legend : Legend, optional
        Written beside the labels.
    **writing
        storage, compress and force of RecordingWriter.

    Returns
    -------
    str
        One line that says what was written.

    Raises
    ------
    PersemError
        When something is missing, does not fit together or cannot be read.

    """
    options = options or FramesOptions()
    folder = Path(folder)
    if not folder.is_dir():
        raise PersemError(f'{folder}: no such folder')
    writer = RecordingWriter(path, **writing)       # refuse now, not after the reading
    unit = parse_unit(options.depth_unit or None) or layout_unit(folder, options)
    items, poses = find_frames(folder, options)
    camera = read_intrinsics(intrinsics_source(folder, options))
    K = _fitting_K(camera, items[0], unit, options)
    say_unregistered(folder)
    if options.check:
        poses = _check(items, poses, K, unit, options)
    return write_scene(
        writer, legend, _trajectory(items, poses, options), items,
        lambda scene, item: _write_frame(scene, item, K, camera, unit, options))


def _trajectory(
        items: list[Item], poses: Poses, options: FramesOptions
) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield (stamp, T_map_camera) of all poses that the frames need, in order of stamps."""
    if not poses.stamps:
        for item in items:
            yield item.stamp, _optical(poses.by_key[item.key], options)
    # A second on either side: a depth image's stamp may lie beyond its label image's.
    for stamp, T in zip(poses.stamps, poses.matrices, strict=True):
        if items[0].stamp - 10**9 <= stamp <= items[-1].stamp + 10**9:
            yield stamp, _optical(T, options)


def _fitting_K(
        camera: Intrinsics, item: Item, unit: float | None, options: FramesOptions
) -> NDArray[np.float64]:
    """Return K for the depth images' size, or refuse a camera of another shape."""
    height, width = read_depth(item.depth, unit, options.depth_invalid)[0].shape
    K, size = camera.K, camera.size or (width, height)
    if not same_aspect(size, (width, height)):
        raise PersemError(f'{item.depth}: {width}x{height}, but the intrinsics are of '
                          f'{size[0]}x{size[1]}; expected one aspect ratio')
    K = scaled_K(K, size, (width, height))
    if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
        raise PersemError(f'the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies outside the depth '
                          f'images of {width}x{height}; --intrinsics must belong to that size')
    return K


def _optical(T: NDArray[np.float64], options: FramesOptions) -> NDArray[np.float64]:
    return axes.optical_pose(T, options.direction, options.axes, options.world)


def _check(items: list[Item], poses: Poses, K: NDArray[np.float64], unit: float | None,
           options: FramesOptions) -> Poses:
    """Reproject some depth images to see whether unit, axes, world and quaternions fit."""
    depths, places = sampled(
        len(items), lambda i: metres(*read_depth(items[i].depth, unit, options.depth_invalid)),
        lambda i: poses.at(items[i].key, items[i].depth_stamp))
    if poses.other is not None:
        there = {i: T for i in depths if (
            T := poses.other.at(items[i].key, items[i].depth_stamp)) is not None}
        if axes.fits_better(depths, there, places, K, (options.direction, options.axes)):
            poses, places = poses.other, there
            LOG.warning('the quaternions of the poses are read in the order %s: depth of one '
                        'frame meets that of another only so', poses.order)
    check_conventions(depths, places, K, (options.direction, options.axes, options.world),
                      units_per_metre(items[0].depth, unit))
    return poses


def _write_frame(scene: SceneWriter, item: Item, K: NDArray[np.float64], camera: Intrinsics,
                 unit: float | None, options: FramesOptions) -> None:
    """Write the images of one frame, or refuse images that do not belong together."""
    depth, depth_encoding = read_depth(item.depth, unit, options.depth_invalid)
    size = depth.shape[1], depth.shape[0]
    if scene.depth_size not in (None, size):
        raise PersemError(f'{item.depth}: {size[0]}x{size[1]}, but the depth images before are '
                          f'{scene.depth_size[0]}x{scene.depth_size[1]}; expected one size')
    for what, write in (('labels', scene.labels), ('truth', scene.truth)):
        path = item.labels if what == 'labels' else item.extra.get(what, (0, None))[1]
        if path is None:
            continue
        array, encoding = read_labels(path)
        if not same_aspect(array.shape[::-1], size):
            raise PersemError(f'{path}: {array.shape[1]}x{array.shape[0]}, but depth is '
                              f'{size[0]}x{size[1]}; expected one aspect ratio')
        write(item.stamp, array, encoding)
    scene.depth(item.depth_stamp, depth, depth_encoding, K, camera.D, camera.model)
    if 'color' in item.extra:
        stamp, path = item.extra['color']
        scene.color(stamp, *read_color(path))
