"""Which files of a sequence of Forest Inspection belong together, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import canonical, files_of, some
from persem_ros.convert.forest import poses as forest_poses
from persem_ros.convert.poses import poses_from_files
from persem_ros.convert.stamps import number_of_name
from persem_ros.convert.trajectories import poses_from_trajectory
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from persem_ros.convert.poses import Poses

# What is looked for when no pattern is given: synthetic part first, then WildUAV.
LAYOUTS = {'labels': ('labels/*.png', 'semantic/*.png', 'label/*.png'),
           'depth': ('depth/*', 'depths/*'), 'color': ('color/*.png', 'img/*.png'),
           'pose': ('airsim_rec.txt', 'poses.txt', 'groundtruth.txt', 'pose/*', 'poses/*',
                    'metadata/*.json')}


@dataclass
class ForestOptions:
    """
    How a sequence is to be read.

    Attributes
    ----------
    labels, depth, color, pose : str
        Patterns with one '*', or for pose a file; empty: looked for.
    predictions : str
        Folder of a segmenter's label images, ids or the data set's colours; empty: the true
        labels are the input.
    depth_unit : str
        m, cm, mm or units per metre; empty: floats m, integers mm.
    depth_coding : str
        plain, or rgb24: R + 256 G + 65536 B over 2^24 - 1, times a kilometre.
    depth_is : str
        planar (along the optical axis) or ray (from the camera's centre).
    intrinsics : str
        A file or fx,fy,cx,cy; empty: of the metadata, else from fov.
    fov : float
        Horizontal field of view, degrees.
    direction, axes, world : str
        Of the poses, see convert.axes; empty: AirSim's (ned, ned), or opencv and enu for
        metadata.
    pitch : float
        Of the camera on the vehicle where poses come from airsim_rec.txt, degrees, up.
    rate, start : float
        Stamps where names are none: Hz, seconds.
    scale : float
        Factor on the images' size, up to 1.
    check : bool
        Whether depth images are reprojected to see that the axes fit.
    frames, every : str, int
        The part of the frames to convert.

    """

    labels: str = ''
    depth: str = ''
    color: str = ''
    pose: str = ''
    predictions: str = ''
    depth_unit: str = ''
    depth_coding: str = 'plain'
    depth_is: str = 'planar'
    intrinsics: str = ''
    fov: float = 90.0
    direction: str = 'camera-to-world'
    axes: str = ''
    world: str = ''
    pitch: float = 0.0
    rate: float = 10.0
    start: float = 1.0
    scale: float = 1.0
    check: bool = True
    frames: str = ''
    every: int = 1


def folder_of(root: Path | str, name: str) -> Path:
    """Return a sequence's folder, which the archives may hold twice (seq1/seq1)."""
    for folder in (Path(root) / name / name, Path(root) / name):
        if folder.is_dir():
            return folder
    there = sorted(p.name for p in Path(root).iterdir() if p.is_dir()) \
        if Path(root).is_dir() else []
    raise PersemError(f'{Path(root) / name}: no such folder'
                      + (f'; there are {some(there, 12)}' if there else ''))


def find(folder: Path, what: str, given: str, optional: bool = False) -> dict[str, Path]:
    """Return {key: path} of the pattern *given*, or of the first usual one that has files."""
    for pattern in [given] if given else LAYOUTS[what]:
        found = files_of(folder, pattern)
        if found:
            return found
    if optional and not given:
        return {}
    raise PersemError(f'{folder}: no {what.removesuffix("s")} files like '
                      f'{given or " or ".join(LAYOUTS[what])}; '
                      f"name them with --{what} 'PATTERN'")


def find_poses(
        folder: Path, given: str, keys: list[str], pitch: float
) -> tuple[Poses, dict[str, NDArray[np.float64]], bool]:
    """Return (Poses, {key: K}, whether they are AirSim's)."""
    for pattern in [given] if given else LAYOUTS['pose']:
        path = folder / pattern
        if path.is_file() and forest_poses.is_airsim(path):
            return forest_poses.airsim_poses(path, pitch), {}, True
        if path.is_file():
            return poses_from_trajectory(path, keys, False), {}, True
        found = files_of(folder, pattern) if '*' in pattern or path.is_dir() else {}
        if found and all(p.suffix == '.json' for p in found.values()):
            return *forest_poses.metadata_poses(found), False
        if found:
            return poses_from_files(found), {}, True
    raise PersemError(f'{folder}: no poses like {given or " or ".join(LAYOUTS["pose"])}; name '
                      'them with --pose FILE or PATTERN')


def partners(keys: dict[str, Path], files: dict[str, Path]) -> dict[str, Path]:
    """Return {key: path} of files with the same name, or else with the same number in it."""
    names = {canonical(other): path for other, path in files.items()}
    result = {key: names[canonical(key)] for key in keys if canonical(key) in names}
    if result:
        return result
    numbers = {number_of_name(other): path for other, path in files.items()}
    return {key: numbers[number_of_name(key)] for key in keys
            if number_of_name(key) is not None and number_of_name(key) in numbers}
