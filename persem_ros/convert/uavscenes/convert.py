"""A run of UAVScenes becomes a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import logging
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.checks import sampled
from persem_ros.convert.files import some
from persem_ros.convert.images import metres, nearest, read_color, read_labels, scaled_K
from persem_ros.convert.scene import check_scale, chosen, report_dropped, write_scene
from persem_ros.convert.uavscenes import calibration
from persem_ros.convert.uavscenes.depth import FolderDepth, LidarDepth
from persem_ros.convert.uavscenes.layout import find_calibration, find_run, folder_of, images
from persem_ros.convert.units import check_unit
from persem_ros.errors import PersemError
from persem_ros.frames import same_aspect
from persem_ros.outputs.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.convert.scene import SceneWriter
    from persem_ros.convert.uavscenes.calibration import Calibration
    from persem_ros.convert.uavscenes.layout import Run, Sample
    from persem_ros.settings.legend import Legend

LOG = logging.getLogger(__name__)
NAMED = (0, 1, 2, 3, 4, 5, 6, 9, 10, 11, 13, 14, 15, 16, 17, 18, 19, 20, 24)
UNNAMED = 255
MAX_SCANS = 50      # on either side


@dataclass
class UavscenesOptions:
    """
    How a run is to be converted.

    Attributes
    ----------
    interval : int, optional
        1 or 5; None: the one that is there.
    predictions : str
        Folder of a segmenter's label images; empty: the true labels are the input.
    depth, depth_unit : str
        Folder of depth images, and their unit; empty: depth from LiDAR.
    depth_invalid : tuple of int
        Stored integers that mean "no measurement".
    lidar : int
        How many scans before and after the frame's own are taken as well.
    calibration : str
        calibration_results.py; empty: looked for.
    camera : str
        Whose intrinsics: sampleinfos or calibration.
    scale : float
        Factor on the images' size, up to 1.
    color : bool
        Whether camera images are written.
    check : bool
        Whether images of *depth* are reprojected to see that their unit fits.
    frames, every : str, int
        The part of the frames to convert, A:B and every n-th.

    """

    interval: int | None = None
    predictions: str = ''
    depth: str = ''
    depth_unit: str = ''
    depth_invalid: tuple[int, ...] = (0, 65535)
    lidar: int = 0
    calibration: str = ''
    camera: str = 'sampleinfos'
    scale: float = 1.0
    color: bool = True
    check: bool = True
    frames: str = ''
    every: int = 1


def convert_uavscenes(root: Path | str, name: str, path: Path | str,
                      options: UavscenesOptions | None = None, legend: Legend | None = None,
                      **writing: Any) -> str:
    """
    Convert one run.

    Parameters
    ----------
    root : str or Path
        The folder with the unpacked archives.
    name : str
        The run, for example AMtown01.
    path : str or Path
        The recording to write.
    options : UavscenesOptions, optional
        What to take.
    legend : Legend, optional
        Written beside the labels.
    **writing
        As in convert_frames(), like what is returned and raised.

    """
    options = options or UavscenesOptions()
    _check_options(options)
    writer = RecordingWriter(path, **writing)       # refuse now, not after the reading
    run = find_run(root, name, options.interval)
    labels = _label_files(run, options)
    rig = _calibration(root, run, options)
    depth = FolderDepth(options) if options.depth else LidarDepth(run, rig, options)
    keys = chosen(_complete(run, labels, depth), options.frames, options.every)
    if isinstance(depth, FolderDepth) and options.check:
        _check_unit(run, keys, depth, rig, options)
    return write_scene(
        writer, legend, _trajectory(run, keys), keys,
        lambda scene, key: _write_frame(scene, run, key, labels[key], depth, rig, options))


def _trajectory(run: Run, keys: list[str]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield (stamp, T_map_camera) of all images of the full rate that the frames span."""
    begin, end = run.samples[keys[0]].stamp, run.samples[keys[-1]].stamp
    for sample in sorted(run.samples.values(), key=lambda sample: sample.stamp):
        if begin <= sample.stamp <= end:
            yield sample.stamp, sample.T_map_camera


def _check_options(options: UavscenesOptions) -> None:
    check_scale(options.scale)
    if not 0 <= options.lidar <= MAX_SCANS:
        raise PersemError(f'--lidar {options.lidar}: expected 0 to {MAX_SCANS} scans')


def _label_files(run: Run, options: UavscenesOptions) -> dict[str, Path]:
    """Return {stamp as text: path} of the input labels."""
    if options.predictions:
        labels = images(folder_of('--predictions', options.predictions))
        if not labels:
            raise PersemError(f'--predictions {options.predictions}: no files named after stamps, '
                              'like 1658137057.641204937.png')
        return labels
    if not run.truth:
        raise PersemError(f'no labels: neither interval{run.interval}_CAM_label_id of {run.name} '
                          'nor --predictions DIR')
    LOG.warning('no --predictions: the true labels are the label input')
    return run.truth


def _calibration(root: Path | str, run: Run, options: UavscenesOptions) -> Calibration:
    """Return the Calibration that LiDAR depth or the intrinsics need; nominal without a file."""
    if options.depth and options.camera != 'calibration':
        return calibration.nominal()
    path = options.calibration or find_calibration(root)
    if path:
        return calibration.read_calibration(path, run.name)
    if options.camera == 'calibration':
        raise PersemError(f'{root}: no calibration_results.py, which --camera calibration needs; '
                          'give --calibration FILE')
    LOG.warning('no calibration_results.py (--calibration FILE): the camera is taken to sit on '
                'the LiDAR, to look exactly where it looks; a degree off is 1.4 m at 80 m')
    return calibration.nominal()


def _complete(
        run: Run, labels: dict[str, Path], depth: FolderDepth | LidarDepth) -> list[str]:
    """Return the frames with labels, depth and a pose, in order; say what is left out."""
    dropped: dict[str, list[str]] = {
        'without a pose': [], 'with a pose that is not finite': [], 'without depth': []}
    keys = []
    for key in sorted(labels):
        if key in run.lost:
            dropped['with a pose that is not finite'].append(key)
        elif key not in run.samples:
            dropped['without a pose'].append(key)
        elif key not in depth.files:
            dropped['without depth'].append(key)
        else:
            keys.append(key)
    if not keys:
        raise PersemError(
            f'no frame of {run.name} is complete: {len(labels)} label images '
            f'({some(sorted(labels), 2)}), {len(depth.files)} with depth '
            f'({some(depth.files, 2)}), {len(run.samples)} poses; the stamps must match')
    report_dropped(dropped)
    without = [key for key in keys if key not in run.truth]
    if without and run.truth:
        LOG.warning('%d frames have no true labels (%s)', len(without), some(without))
    return keys


def _camera(
        sample: Sample, rig: Calibration, options: UavscenesOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, int]]:
    """Return (K, D, (width, height)) of a sample, or of the calibration."""
    if options.camera == 'calibration':
        assert rig.K is not None, 'only nominal() has none, and is not used for the camera'
        return rig.K, rig.D, calibration.SIZE
    return sample.K, sample.D if np.any(sample.D) else np.zeros(5), sample.size


def _check_unit(run: Run, keys: list[str], depth: FolderDepth, rig: Calibration,
                options: UavscenesOptions) -> None:
    """Reproject some depth images to see whether their unit fits."""
    depths, poses = sampled(len(keys), lambda i: metres(*depth.stored(keys[i])),
                            lambda i: run.samples[keys[i]].T_map_camera)
    if depths:
        K, _, full = _camera(run.samples[keys[0]], rig, options)
        shape = next(iter(depths.values())).shape
        factor, error = check_unit(depths, poses, scaled_K(K, full, shape[::-1]),
                                   depth.units_per_metre(keys[0]))
        if factor == 1.0 and error == error:        # not NaN: some frames overlap
            LOG.info('depth of one frame meets that of another within %.1f %%', 100 * error)


def _write_frame(
        scene: SceneWriter, run: Run, key: str, path: Path, depth: FolderDepth | LidarDepth,
        rig: Calibration, options: UavscenesOptions) -> None:
    """Write the images of one frame."""
    sample = run.samples[key]
    ids = named_ids(path)
    full = ids.shape[1], ids.shape[0]
    if not same_aspect(sample.size, full):
        raise PersemError(f'{path}: {full[0]}x{full[1]}, but the poses are of images of '
                          f'{sample.size[0]}x{sample.size[1]}; expected one aspect ratio')
    size = max(1, round(full[0] * options.scale)), max(1, round(full[1] * options.scale))
    own = _camera(sample, rig, options)

    def K_of(target: tuple[int, int]) -> NDArray[np.float64]:
        return scaled_K(own[0], own[2], target)

    image, encoding = depth.image(key, K_of, own[1], size)
    scene.labels(sample.stamp, nearest(ids, size), 'mono8')
    if key in run.truth:
        scene.truth(sample.stamp, nearest(named_ids(run.truth[key]), size), 'mono8')
    scene.depth(sample.stamp, image, encoding, K_of((image.shape[1], image.shape[0])), own[1])
    if options.color and key in run.color:
        scene.color(sample.stamp, *read_color(run.color[key], size))


def named_ids(path: Path) -> NDArray[np.uint8]:
    """Return a label file as uint8 with 255 for all ids that UAVScenes gives no name."""
    array, _ = read_labels(path)
    table = np.full(256, UNNAMED, np.uint8)
    table[list(NAMED)] = NAMED
    return table[np.where((array >= 0) & (array < 256), array, UNNAMED)]
