"""A run of UAVScenes becomes a recording."""

import logging
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from persem_ros.convert import calibration, lidar
from persem_ros.convert.files import some
from persem_ros.convert.images import (
    nearest,
    parse_unit,
    read_array,
    read_color,
    read_depth,
    read_labels,
    same_aspect,
    scaled_K,
)
from persem_ros.convert.scene import SceneWriter, chosen, report_dropped
from persem_ros.convert.uavscenes_layout import find_calibration, find_run, images
from persem_ros.errors import PersemError
from persem_ros.outputs.recording import RecordingWriter

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
    frames, every : str, int
        The part of the frames to convert, A:B and every n-th.

    """

    interval: int = None
    predictions: str = ''
    depth: str = ''
    depth_unit: str = ''
    depth_invalid: tuple = (0, 65535)
    lidar: int = 0
    calibration: str = ''
    camera: str = 'sampleinfos'
    scale: float = 1.0
    color: bool = True
    frames: str = ''
    every: int = 1


def convert_uavscenes(root, name, path, options=None, legend=None, **writing):
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
    options = options or UavscenesOptions()
    _check_options(options)
    writer = RecordingWriter(path, **writing)       # refuse now, not after the reading
    run = find_run(root, name, options.interval)
    labels = _label_files(run, options)
    rig = _calibration(root, run, options)
    depth = _FolderDepth(options) if options.depth else _LidarDepth(run, rig, options)
    keys = chosen(_complete(run, labels, depth), options.frames, options.every)
    with writer as out:
        scene = SceneWriter(out, legend)
        for key in tqdm(keys, unit='frame', disable=None):
            _write_frame(scene, run, key, labels[key], depth, rig, options)
        begin, end = run.samples[keys[0]].stamp, run.samples[keys[-1]].stamp
        for sample in run.samples.values():
            if begin <= sample.stamp <= end:
                scene.pose(sample.stamp, sample.T_map_camera)
        return scene.summary()


class _FolderDepth:
    """Depth from a folder of images that are named like the camera's."""

    def __init__(self, options):
        self._options = options
        self._unit = parse_unit(options.depth_unit or None)
        self.files = images(_folder('--depth', options.depth))
        if not self.files:
            raise PersemError(f'--depth {options.depth}: no files named after stamps, like '
                              '1658137057.641204937.png')
        first = next(iter(self.files.values()))
        if self._unit is None and read_array(first).dtype.kind != 'f':
            raise PersemError(f'{first}: integers without a unit; say --depth-unit mm, cm, m or '
                              'the units that make a metre')

    def image(self, key, K_of, D, size):
        """Return (depth, encoding) of a frame, never larger than *size* (width, height)."""
        depth, encoding = read_depth(self.files[key], self._unit, self._options.depth_invalid)
        own = depth.shape[1], depth.shape[0]
        if not same_aspect(own, size):
            raise PersemError(f'{self.files[key]}: {own[0]}x{own[1]}, but the labels are '
                              f'{size[0]}x{size[1]}; expected one aspect ratio')
        return nearest(depth, size) if own[0] > size[0] else depth, encoding


class _LidarDepth:
    """Depth from the frame's scan and its neighbours, the nearest point of a pixel."""

    def __init__(self, run, rig, options):
        if run.lidar is None:
            raise PersemError(f'no folder interval{run.interval}_LIDAR of {run.name}; unpack the '
                              'LiDAR archive, or give --depth DIR')
        scans = lidar.scans_of(run.lidar)
        self.files = {key: path for key, path in scans.items() if key in run.samples}
        if not self.files:
            raise PersemError(f'{run.lidar}: no scans named image<stamp>_lidar<stamp>.txt with a '
                              f'pose; {len(scans)} scans, {len(run.samples)} poses')
        self._run, self._rig, self._around = run, rig, options.lidar
        self._order = list(self.files)
        self._index = {key: i for i, key in enumerate(self._order)}
        self._scans = OrderedDict()     # in the map frame, the last used

    def image(self, key, K_of, D, size):
        """Return (depth, encoding) of a frame, of *size* (width, height)."""
        i = self._index[key]
        near = self._order[max(0, i - self._around):i + self._around + 1]
        points = np.concatenate([self._in_map(other) for other in near])
        T = self._run.samples[key].T_map_camera
        points = (points - T[:3, 3]) @ T[:3, :3]
        return lidar.depth_of_points(points, K_of(size), D, size), '32FC1'

    def _in_map(self, key):
        """Return a scan's points in the map frame; the last few stay in memory."""
        if key not in self._scans:
            T = self._run.samples[key].T_map_camera @ self._rig.T_camera_lidar
            self._scans[key] = lidar.read_scan(self.files[key]) @ T[:3, :3].T + T[:3, 3]
            while len(self._scans) > 2 * self._around + 1:
                self._scans.popitem(last=False)
        return self._scans[key]


def _check_options(options):
    if not 0 < options.scale <= 1:
        raise PersemError(f'--scale {options.scale:g}: expected more than 0 and at most 1')
    if not 0 <= options.lidar <= MAX_SCANS:
        raise PersemError(f'--lidar {options.lidar}: expected 0 to {MAX_SCANS} scans')


def _folder(flag, text):
    path = Path(text)
    if not path.is_dir():
        raise PersemError(f'{flag} {text}: no such folder')
    return path


def _label_files(run, options):
    """Return {stamp as text: path} of the input labels."""
    if options.predictions:
        labels = images(_folder('--predictions', options.predictions))
        if not labels:
            raise PersemError(f'--predictions {options.predictions}: no files named after stamps, '
                              'like 1658137057.641204937.png')
        return labels
    if not run.truth:
        raise PersemError(f'no labels: neither interval{run.interval}_CAM_label_id of {run.name} '
                          'nor --predictions DIR')
    LOG.warning('no --predictions: the true labels are the label input')
    return run.truth


def _calibration(root, run, options):
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


def _complete(run, labels, depth):
    """Return the frames with labels, depth and a pose, in order; say what is left out."""
    dropped = {'without a pose': [], 'with a pose that is not finite': [], 'without depth': []}
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


def _write_frame(scene, run, key, path, depth, rig, options):
    """Write the images of one frame."""
    sample = run.samples[key]
    ids = named_ids(path)
    full = ids.shape[1], ids.shape[0]
    if not same_aspect(sample.size, full):
        raise PersemError(f'{path}: {full[0]}x{full[1]}, but the poses are of images of '
                          f'{sample.size[0]}x{sample.size[1]}; expected one aspect ratio')
    size = max(1, round(full[0] * options.scale)), max(1, round(full[1] * options.scale))
    own = (rig.K, rig.D, calibration.SIZE) if options.camera == 'calibration' else \
        (sample.K, sample.D if np.any(sample.D) else np.zeros(5), sample.size)

    def K_of(target):
        return scaled_K(own[0], own[2], target)

    image, encoding = depth.image(key, K_of, own[1], size)
    scene.labels(sample.stamp, nearest(ids, size), 'mono8')
    if key in run.truth:
        scene.truth(sample.stamp, nearest(named_ids(run.truth[key]), size), 'mono8')
    scene.depth(sample.stamp, image, encoding, K_of((image.shape[1], image.shape[0])), own[1])
    if options.color and key in run.color:
        scene.color(sample.stamp, *read_color(run.color[key], size))


def named_ids(path):
    """Return a label file as uint8 with 255 for all ids that UAVScenes gives no name."""
    array, _ = read_labels(path)
    table = np.full(256, UNNAMED, np.uint8)
    table[list(NAMED)] = NAMED
    return table[np.where((array >= 0) & (array < 256), array, UNNAMED)]
