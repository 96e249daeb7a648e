"""Which files of a folder make a frame: patterns, usual layouts, stamps."""

from __future__ import annotations

from dataclasses import dataclass, field
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from persem_ros.convert.files import files_of, some
from persem_ros.convert.frames.partners import namesakes, partners_of
from persem_ros.convert.intrinsics import is_numbers
from persem_ros.convert.poses import poses_from_files
from persem_ros.convert.scene import chosen, report_dropped
from persem_ros.convert.stamps import (
    stamp_of_name, stamps_from_file, stamps_from_names, stamps_from_rate)
from persem_ros.convert.trajectories import poses_from_trajectory
from persem_ros.convert.uavscenes.layout import is_uavscenes
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from persem_ros.convert.poses import Poses

LOG = logging.getLogger(__name__)
# What is looked for when no pattern is given, the first that exists.
LAYOUTS = {
    'labels': ('*.label.png', '*.labels.png', 'labels/*', 'label/*', 'semantic/*'),
    'depth': ('*.depth.png', 'depth/*'),
    'pose': ('*.pose.txt', 'pose/*', 'poses/*', 'groundtruth.txt', 'trajectory.txt',
             'poses.txt', 'traj.txt', 'lowres_wide.traj', 'trajectory.log',
             'state_groundtruth_estimate0/data.csv'),
    'color': ('*.color.jpg', '*.color.png', 'color/*', 'rgb/*'),
    'truth': ('*.truth.png', 'truth/*'),
    'intrinsics': ('camera-intrinsics.txt', 'intrinsics.txt', 'camera.yaml', 'camera.txt',
                   'intrinsic/intrinsic_depth.txt'),
}
TUM_UNITS_PER_METRE = 5000.0


@dataclass
class FramesOptions:
    """
    How a folder is to be read; every pattern may stay empty and is then looked for.

    Attributes
    ----------
    labels, depth, pose, color, truth : str
        Patterns with one '*', or folders; pose also a trajectory file.
    intrinsics : str
        A file, or "fx,fy,cx,cy".
    depth_unit : str
        m, cm, mm or units per metre; empty: integers mm, floats m, a TUM folder 5000.
    depth_invalid : tuple of int
        Stored integers that mean "no measurement".
    stamps : str
        auto, names, rate or a file.
    rate, start : float
        Numbers per second; stamp of number 0 in seconds (0 itself means "latest" to tf).
    tolerance : float
        Largest difference of stamps in a frame, seconds.
    direction, axes, world : str
        Conventions of the pose files, see convert.axes.
    check : bool
        Whether depth images are reprojected to see that the axes fit.
    frames, every : str, int
        The part of the frames to convert, A:B and every n-th.

    """

    labels: str = ''
    depth: str = ''
    pose: str = ''
    color: str = ''
    truth: str = ''
    intrinsics: str = ''
    depth_unit: str = ''
    depth_invalid: tuple[int, ...] = (0, 65535)
    stamps: str = 'auto'
    rate: float = 30.0
    start: float = 1.0
    tolerance: float = 0.02
    direction: str = 'camera-to-world'
    axes: str = 'opencv'
    world: str = 'enu'
    check: bool = True
    frames: str = ''
    every: int = 1


@dataclass
class Item:
    """
    One frame on disk.

    Attributes
    ----------
    key : str
        What the star in the labels' pattern stands for.
    stamp, depth_stamp : int
        Nanoseconds; they differ where names are stamps.
    labels, depth : Path
        The files.
    extra : dict of str to (int, Path)
        Stamp and file of color and truth, where there are any.

    """

    key: str
    stamp: int
    labels: Path
    depth: Path
    depth_stamp: int
    extra: dict[str, tuple[int, Path]] = field(default_factory=dict)


def find_frames(folder: Path, options: FramesOptions) -> tuple[list[Item], Poses]:
    """
    Return the frames that have labels, depth and a pose, and the poses.

    Parameters
    ----------
    folder : Path
        The data set.
    options : FramesOptions
        How to read it.

    Returns
    -------
    list of Item
        In order of stamps.
    Poses
        As the files have them.

    """
    files = {what: _find(folder, what, getattr(options, what)) for what in
             ('labels', 'depth', 'color', 'truth')}
    for what in ('labels', 'depth'):
        if not files[what]:
            if is_uavscenes(folder):
                raise PersemError(f'{folder}: looks like UAVScenes: persem convert uavscenes ROOT '
                                  'RUN OUT')
            raise PersemError(f'{folder}: no {what.removesuffix("s")} files like '
                              f'{getattr(options, what) or " or ".join(LAYOUTS[what])}; name them '
                              f"with --{what} 'PATTERN'")
    keys = list(files['labels'])
    times, named = _stamps(keys, options)
    own_clock = named or options.stamps not in ('auto', 'names', 'rate')
    poses = _find_poses(folder, options, keys, own_clock)
    partners = {what: partners_of(times, named, list(files[what]), options.tolerance)
                for what in ('depth', 'color', 'truth') if files[what]}
    items = _complete(times, files, partners, poses)
    if not items:
        raise PersemError(
            f'{folder}: no frame is complete: {len(keys)} label files ({some(keys)}), '
            f'{len(files["depth"])} depth files ({some(files["depth"])}), '
            f'{len(poses.by_key) or len(poses.stamps)} poses; names or stamps must match')
    unused = len(files['depth']) - len(partners['depth'])
    if unused:
        LOG.info('%d depth files have no labels and are not used', unused)
    items.sort(key=lambda item: item.stamp)
    for one, two in zip(items, items[1:], strict=False):
        if one.stamp == two.stamp:
            raise PersemError(f'frames {one.key} and {two.key} have the same stamp, '
                              f'{one.stamp / 1e9:.9f} s; --stamps says where stamps come from')
    return chosen(items, options.frames, options.every), poses


def _complete(times: dict[str, int], files: dict[str, dict[str, Path]],
              partners: dict[str, dict[str, tuple[str, int]]], poses: Poses) -> list[Item]:
    """Return the Items that have depth and a pose; say which frames are left out."""
    dropped: dict[str, list[str]] = {
        'without depth': [], 'without a pose': [], 'with a lost pose (NaN, Inf)': []}
    items = []
    for key, stamp in times.items():
        if key not in partners['depth']:
            dropped['without depth'].append(key)
        elif poses.at(key, stamp) is None:
            dropped['with a lost pose (NaN, Inf)' if key in poses.lost
                    else 'without a pose'].append(key)
        else:
            found = {what: (partner[key][1], files[what][partner[key][0]])
                     for what, partner in partners.items() if key in partner}
            depth_stamp, depth = found.pop('depth')
            items.append(Item(key, stamp, files['labels'][key], depth, depth_stamp, found))
    if items:
        report_dropped(dropped)
    return items


def _find(folder: Path, what: str, pattern: str) -> dict[str, Path]:
    """Return {key: path} of a given pattern, or of the first usual one that has files."""
    for candidate in [pattern] if pattern else LAYOUTS[what]:
        found = files_of(folder, candidate)
        if found:
            if not pattern:
                LOG.info('%s: %d files like %s', what, len(found), candidate)
            return found
    if pattern and what in ('color', 'truth'):
        raise PersemError(f'{folder}: no {what} files like {pattern}')
    return {}


def _find_poses(
        folder: Path, options: FramesOptions, keys: list[str], stamped: bool) -> Poses:
    for candidate in [options.pose] if options.pose else LAYOUTS['pose']:
        path = folder / candidate
        if path.is_file():
            return poses_from_trajectory(path, keys, stamped)
        found = files_of(folder, candidate) if '*' in candidate or path.is_dir() else {}
        if found:
            names = namesakes(keys, list(found))
            return poses_from_files({key: found[other] for key, other in names.items()})
    raise PersemError(f'{folder}: no poses like {options.pose or " or ".join(LAYOUTS["pose"])}; '
                      'name them with --pose FILE or PATTERN')


def _stamps(keys: list[str], options: FramesOptions) -> tuple[dict[str, int], bool]:
    """Return ({key: stamp}, whether the names are the stamps) as the options ask for."""
    named = stamps_from_names(keys) if options.stamps in ('auto', 'names') else None
    if named is not None:
        return named, True
    if options.stamps == 'names':
        bad = next(key for key in keys if stamp_of_name(key) is None)
        raise PersemError(f'--stamps names: {bad!r} is not a stamp; expected seconds with '
                          'decimals, or 10, 13, 16 or 19 digits; --stamps rate uses --rate')
    if options.stamps not in ('auto', 'rate'):
        return stamps_from_file(options.stamps, keys), False
    if not 0 < options.rate < 1e6 or not 0 <= options.start < 1e9:
        raise PersemError(f'--rate {options.rate:g} --start {options.start:g}: expected a rate '
                          'above 0 Hz and a start of 0 s or later')
    return stamps_from_rate(keys, options.rate, options.start), False


def layout_unit(folder: Path, options: FramesOptions) -> float | None:
    """Return TUM's depth unit where the folder is laid out like TUM's, else None."""
    if not options.depth_unit and (folder / 'groundtruth.txt').is_file() \
            and (folder / 'depth').is_dir():
        LOG.info('a TUM folder: depth in units of 1/5000 m (--depth-unit to change it)')
        return TUM_UNITS_PER_METRE
    return None


def say_unregistered(folder: Path) -> None:
    """Say of a folder laid out like 7-Scenes that its colour does not lie on its depth."""
    if all(next(folder.glob(f'frame-*.{what}'), None) is not None
           for what in ('color.png', 'depth.png', 'pose.txt')):
        LOG.info('%s: laid out like 7-Scenes, whose colour and depth are not registered: labels '
                 'computed on colour lie beside the depth by some pixels', folder)


def intrinsics_source(folder: Path, options: FramesOptions) -> Path | str:
    """Return what read_intrinsics takes: four numbers, or a file."""
    if is_numbers(options.intrinsics):
        return options.intrinsics
    for candidate in [options.intrinsics] if options.intrinsics else LAYOUTS['intrinsics']:
        if (folder / candidate).is_file():
            return folder / candidate
    if Path(options.intrinsics).is_file():
        return Path(options.intrinsics)
    raise PersemError(f'{folder}: no intrinsics like '
                      f'{options.intrinsics or " or ".join(LAYOUTS["intrinsics"])}; give '
                      '--intrinsics FILE or fx,fy,cx,cy')
