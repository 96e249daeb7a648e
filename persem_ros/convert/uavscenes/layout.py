"""Where UAVScenes keeps a run's files, in all the forms that unpacking gives them."""

from __future__ import annotations

from dataclasses import dataclass, field
from glob import escape
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import files_of, read_text
from persem_ros.convert.poses import rigid
from persem_ros.convert.stamps import stamp_of_name
from persem_ros.errors import PersemError

INFOS = 'sampleinfos_interpolated.json'
WRAPPERS = ('', '*/', '*/*/')       # run folders under ROOT, in archives' folders, in doubled ones


@dataclass(frozen=True, eq=False)
class Sample:
    """One entry of the samples' file: an image of the full rate."""

    stamp: int
    T_map_camera: NDArray[np.float64]       # (4, 4)
    K: NDArray[np.float64]                  # (3, 3)
    D: NDArray[np.float64]                  # (5,)
    size: tuple[int, int]                   # width, height


@dataclass
class Run:
    """
    The files of one run; every mapping goes from an image's stamp as text to a path.

    Attributes
    ----------
    name : str
        Without the interval, for example AMtown01.
    interval : int
        1 or 5.
    truth, color : dict of str to Path
        Label images of true ids and camera images; empty where not unpacked.
    lidar : Path or None
        The folder of the scans.
    samples : dict of str to Sample
        Poses and intrinsics.
    lost : list of str
        Images whose pose is not finite.

    """

    name: str
    interval: int
    truth: dict[str, Path] = field(default_factory=dict)
    color: dict[str, Path] = field(default_factory=dict)
    lidar: Path | None = None
    samples: dict[str, Sample] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)


def find_run(root: Path | str, name: str, interval: int | None = None) -> Run:
    """
    Return the Run called *name* below *root*.

    Parameters
    ----------
    root : Path
        The folder with the unpacked archives, single or doubled, or with the run folders.
    name : str
        AMtown01, or with its interval interval5_AMtown01.
    interval : int, optional
        1 or 5; without it the one that is there, 5 where both are.

    Raises
    ------
    PersemError
        When there is no such folder or run (the runs that are there are named), or its poses
        are missing or broken.

    """
    root = Path(root)
    if not root.is_dir():
        raise PersemError(f'{root}: no such folder')
    prefix = next((n for n in (1, 5) if name.startswith(f'interval{n}_')), None)
    name = name.removeprefix(f'interval{prefix}_')
    wanted = interval or prefix
    for n in (wanted,) if wanted else (5, 1):
        infos = _below(root, n, name, INFOS)
        if infos:
            break
    else:
        runs = _runs(root)
        if not runs:
            raise PersemError(f'{root}: no runs of UAVScenes there; ROOT should hold what the '
                              'archives unpack to, interval5_CAM_LIDAR/interval5_AMtown01/'
                              f'{INFOS} for example, or the folders interval5_<RUN> themselves')
        raise PersemError(f'{root}: no {INFOS} of the run {name!r}'
                          f'{f" at interval {wanted}" if wanted else ""}; runs there: '
                          f'{", ".join(runs)}')
    run = Run(name, n, lidar=_below(root, n, name, f'interval{n}_LIDAR'))
    run.truth = images(_below(root, n, name, f'interval{n}_CAM_label_id'))
    run.color = images(_below(root, n, name, f'interval{n}_CAM'))
    _read_samples(infos, run)
    return run


def is_uavscenes(folder: Path) -> bool:
    """Whether a folder is ROOT, or a run or an archive below it."""
    return bool(_runs(Path(folder))) or any(
        next(Path(folder).glob(name), None) for name in (INFOS, 'interval[15]_*'))


def folder_of(flag: str, text: str) -> Path:
    """Return the folder that an option names, or refuse it."""
    path = Path(text)
    if not path.is_dir():
        raise PersemError(f'{flag} {text}: no such folder')
    return path


def images(folder: Path | None) -> dict[str, Path]:
    """Return {stamp as text: path} of a folder's files named after stamps; none without."""
    found = files_of(folder, '*') if folder else {}
    return {key: path for key, path in found.items() if stamp_of_name(key) is not None}


def find_calibration(root: Path | str) -> Path | None:
    """Return the path of calibration_results.py at or below *root*, or None."""
    for wrapper in WRAPPERS:
        for path in sorted(Path(root).glob(f'{wrapper}calibration_results.py')):
            return path
    return None


def _below(root: Path, n: int, name: str, leaf: str) -> Path | None:
    """Return the shallowest ROOT/…/interval<n>_<name>/<leaf>, or None."""
    for wrapper in WRAPPERS:
        for path in sorted(root.glob(f'{wrapper}interval{n}_{escape(name)}/{leaf}')):
            return path
    return None


def _runs(root: Path) -> list[str]:
    """Return the names of the runs with poses below *root*."""
    return sorted({path.parent.name for wrapper in WRAPPERS
                   for path in root.glob(f'{wrapper}interval[15]_*/{INFOS}')})


def _read_samples(path: Path, run: Run) -> None:
    """Fill the samples of a run from the file of poses and intrinsics."""
    try:
        entries = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise PersemError(f'{path}: not JSON: {error}') from None
    if not isinstance(entries, list) or not entries:
        raise PersemError(f'{path}: expected a list with one object per image')
    for i, entry in enumerate(entries):
        try:
            key = Path(entry['OriginalImageName']).stem
            T = np.array(entry['T4x4'], float).reshape(4, 4)
            K = np.array(entry['P3x3'], float).reshape(3, 3)
            D = np.array([entry.get(name, 0.0) for name in ('K1', 'K2', 'P1', 'P2', 'K3')], float)
            size = int(entry['Width']), int(entry['Height'])
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            raise PersemError(f'{path}: entry {i}: expected OriginalImageName, Width, Height, '
                              'P3x3 and T4x4') from None
        stamp = stamp_of_name(key)
        if stamp is None:
            raise PersemError(f'{path}: entry {i}: expected an image named after its stamp, got '
                              f'{key[:60]!r}')
        if not np.isfinite(T).all():
            run.lost.append(key)
            continue
        if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and min(size) > 0):
            raise PersemError(f'{path}: {key}: expected positive focal lengths in P3x3')
        run.samples[key] = Sample(stamp, rigid(T, f'{path}: {key}'), K, D, size)
