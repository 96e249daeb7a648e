"""Folders of label, depth and pose files (7-Scenes, ScanNet, TUM, …) become a recording."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

from persem_ros.convert import axes, stamps
from persem_ros.convert.files import canonical, files_of, some
from persem_ros.convert.images import (
    metres,
    parse_unit,
    read_color,
    read_depth,
    read_labels,
    same_aspect,
    scaled_K,
)
from persem_ros.convert.intrinsics import read_intrinsics
from persem_ros.convert.poses import poses_from_files, poses_from_trajectory
from persem_ros.convert.scene import SceneWriter, chosen, report_dropped
from persem_ros.errors import PersemError
from persem_ros.outputs.recording import RecordingWriter

LOG = logging.getLogger(__name__)
# What is looked for when no pattern is given, the first that exists.
LAYOUTS = {
    'labels': ('*.label.png', '*.labels.png', 'labels/*', 'label/*', 'semantic/*'),
    'depth': ('*.depth.png', 'depth/*'),
    'pose': ('*.pose.txt', 'pose/*', 'poses/*', 'groundtruth.txt', 'trajectory.txt',
             'poses.txt', 'traj.txt'),
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
    depth_invalid: tuple = (0, 65535)
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
    """One frame on disk; the depth image has a stamp of its own where its name has."""

    key: str
    stamp: int
    labels: Path
    depth: Path
    depth_stamp: int
    extra: dict = field(default_factory=dict)       # color, truth: (stamp, path)


def convert_frames(folder, path, options=None, legend=None, **writing):
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
    unit = parse_unit(options.depth_unit or None) or _layout_unit(folder, options)
    items, poses = find_frames(folder, options)
    camera = read_intrinsics(_intrinsics_source(folder, options))
    K = _fitting_K(camera, items[0], unit, options)
    if options.check:
        _check_axes(items, poses, K, unit, options)
    with writer as out:
        scene = SceneWriter(out, legend)
        for item in tqdm(items, unit='frame', disable=None):
            _write_frame(scene, item, K, camera, unit, options)
            if not poses.stamps:
                scene.pose(item.stamp, _optical(poses.by_key[item.key], options))
        begin, end = items[0].stamp - 10**9, items[-1].stamp + 10**9
        for stamp, T in zip(poses.stamps, poses.matrices, strict=False):
            if begin <= stamp <= end:
                scene.pose(stamp, _optical(T, options))
        return scene.summary()


def find_frames(folder, options):
    """Return (list of Item, Poses): the frames that have labels, depth and a pose."""
    files = {what: _find(folder, what, getattr(options, what)) for what in
             ('labels', 'depth', 'color', 'truth')}
    for what in ('labels', 'depth'):
        if not files[what]:
            raise PersemError(f'{folder}: no {what} files like '
                              f'{getattr(options, what) or " or ".join(LAYOUTS[what])}; name them '
                              f"with --{what} 'PATTERN'")
    times = {what: _stamps(list(found), options) for what, found in files.items() if found}
    keys = list(files['labels'])
    poses = _find_poses(folder, options, keys, stamps.stamps_from_names(keys) is not None
                        or options.stamps not in ('auto', 'names', 'rate'))
    partner = {what: _partners(keys, times['labels'], list(files[what]), times[what],
                               options.tolerance) for what in files if files[what]}
    items = []
    dropped = {'without depth': [], 'without a pose': [], 'with a lost pose (NaN, Inf)': []}
    for key in keys:
        depth = partner['depth'].get(key)
        stamp = times['labels'][key]
        if depth is None:
            dropped['without depth'].append(key)
        elif poses.at(key, stamp) is None:
            lost = key in poses.lost
            dropped['with a lost pose (NaN, Inf)' if lost else 'without a pose'].append(key)
        else:
            extra = {what: (times[what][partner[what][key]], files[what][partner[what][key]])
                     for what in ('color', 'truth') if key in partner.get(what, ())}
            items.append(Item(key, stamp, files['labels'][key], files['depth'][depth],
                              times['depth'][depth], extra))
    if not items:
        raise PersemError(
            f'{folder}: no frame is complete: {len(keys)} label files ({some(keys)}), '
            f'{len(files["depth"])} depth files ({some(files["depth"])}), '
            f'{len(poses.by_key) or len(poses.stamps)} poses; names or stamps must match')
    report_dropped(dropped)
    unused = len(files['depth']) - len(set(partner['depth'].values()))
    if unused:
        LOG.info('%d depth files have no labels and are not used', unused)
    return chosen(sorted(items, key=lambda item: item.stamp), options.frames, options.every), poses


def _find(folder, what, pattern):
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


def _find_poses(folder, options, keys, stamped):
    for candidate in [options.pose] if options.pose else LAYOUTS['pose']:
        path = folder / candidate
        if path.is_file():
            return poses_from_trajectory(path, keys, stamped)
        found = files_of(folder, candidate) if '*' in candidate or path.is_dir() else {}
        if found:
            names = {canonical(key): key for key in keys}
            return poses_from_files({names[canonical(key)]: path for key, path in found.items()
                                     if canonical(key) in names})
    raise PersemError(f'{folder}: no poses like {options.pose or " or ".join(LAYOUTS["pose"])}; '
                      'name them with --pose FILE or PATTERN')


def _stamps(keys, options):
    """Return {key: stamp} of the frames, in the way that the options ask for."""
    named = stamps.stamps_from_names(keys) if options.stamps in ('auto', 'names') else None
    if named is not None:
        return named
    if options.stamps == 'names':
        bad = next(key for key in keys if stamps.stamp_of_name(key) is None)
        raise PersemError(f'--stamps names: {bad!r} is not a stamp; expected seconds with '
                          'decimals, or 10, 13, 16 or 19 digits; --stamps rate uses --rate')
    if options.stamps not in ('auto', 'rate'):
        return stamps.stamps_from_file(options.stamps, keys)
    if not 0 < options.rate < 1e6 or not 0 <= options.start < 1e9:
        raise PersemError(f'--rate {options.rate:g} --start {options.start:g}: expected a rate '
                          'above 0 Hz and a start of 0 s or later')
    return stamps.stamps_from_rate(keys, options.rate, options.start)


def _partners(keys, times, others, other_times, tolerance):
    """Return {key: other key}: the same name, else the nearest stamp; each is used once."""
    names = {canonical(other): other for other in others}
    result = {key: names[canonical(key)] for key in keys if canonical(key) in names}
    if result or stamps.stamps_from_names(keys) is None:
        return result
    pairs = _near(keys, times, others, other_times, round(tolerance * 1e9))
    taken = set()
    for _, key, other in sorted(pairs):
        if key not in result and other not in taken:
            result[key] = other
            taken.add(other)
    return result


def _near(keys, times, others, other_times, tolerance):
    """Yield (difference, key, other) of all pairs within *tolerance* nanoseconds."""
    others = sorted(others, key=other_times.get)
    first = 0
    for key in sorted(keys, key=times.get):
        while first < len(others) and other_times[others[first]] < times[key] - tolerance:
            first += 1
        for other in others[first:]:
            if other_times[other] > times[key] + tolerance:
                break
            yield abs(other_times[other] - times[key]), key, other


def _layout_unit(folder, options):
    """Return TUM's depth unit where the folder is laid out like TUM's, else None."""
    if not options.depth_unit and (folder / 'groundtruth.txt').is_file() \
            and (folder / 'depth').is_dir():
        LOG.info('a TUM folder: depth in units of 1/5000 m (--depth-unit to change it)')
        return TUM_UNITS_PER_METRE
    return None


def _intrinsics_source(folder, options):
    """Return what read_intrinsics takes: four numbers, or a file."""
    if options.intrinsics.count(',') == 3:
        return options.intrinsics
    for candidate in [options.intrinsics] if options.intrinsics else LAYOUTS['intrinsics']:
        if (folder / candidate).is_file():
            return folder / candidate
    if Path(options.intrinsics).is_file():
        return Path(options.intrinsics)
    raise PersemError(f'{folder}: no intrinsics like '
                      f'{options.intrinsics or " or ".join(LAYOUTS["intrinsics"])}; give '
                      '--intrinsics FILE or fx,fy,cx,cy')


def _fitting_K(camera, item, unit, options):
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


def _optical(T, options):
    return axes.optical_pose(T, options.direction, options.axes, options.world)


def _check_axes(items, poses, K, unit, options):
    """Reproject some depth images under every convention and say what fits."""
    need = sorted({i for pair in axes.pairs_to_check(len(items)) for i in pair})
    depths = {i: metres(*read_depth(items[i].depth, unit, options.depth_invalid)) for i in need}
    places = {i: poses.at(items[i].key, items[i].depth_stamp) for i in need}
    depths = {i: depth for i, depth in depths.items() if places[i] is not None}
    axes.judge(axes.compare_conventions(depths, places, K), options.direction, options.axes)


def _write_frame(scene, item, K, camera, unit, options):
    """Write the images of one frame, or refuse images that do not belong together."""
    depth, depth_encoding = read_depth(item.depth, unit, options.depth_invalid)
    height, width = depth.shape
    if scene.counts['depth'] and scene.size != (width, height):
        raise PersemError(f'{item.depth}: {width}x{height}, but the depth images before are '
                          f'{scene.size[0]}x{scene.size[1]}; expected one size')
    scene.size = width, height
    for what, path in (('labels', item.labels), ('truth', item.extra.get('truth', (0, None))[1])):
        if path is None:
            continue
        array, encoding = read_labels(path)
        if not same_aspect((array.shape[1], array.shape[0]), (width, height)):
            raise PersemError(f'{path}: {array.shape[1]}x{array.shape[0]}, but depth is '
                              f'{width}x{height}; expected one aspect ratio')
        getattr(scene, what)(item.stamp, array, encoding)
    scene.depth(item.depth_stamp, depth, depth_encoding, K, camera.D, camera.model)
    if 'color' in item.extra:
        stamp, path = item.extra['color']
        scene.color(stamp, *read_color(path))
