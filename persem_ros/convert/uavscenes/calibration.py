"""The calibration file of UAVScenes: Python source that is read, never run."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
import logging
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import read_text
from persem_ros.convert.poses import rigid
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from pathlib import Path

LOG = logging.getLogger(__name__)
SIZE = (2448, 2048)         # images that the intrinsics belong to, (width, height)
MISPRINT = 0.1              # one published matrix is 0.05 off a rotation: a digit is missing
FIELDS = {'camera_intrinsic': 9, 'camera_dist_coeffs': 5, 'camera_ext_R': 9, 'camera_ext_t': 3}


@dataclass(frozen=True, eq=False)
class Calibration:
    """
    A camera beside a LiDAR.

    Attributes
    ----------
    T_camera_lidar : ndarray, shape (4, 4)
        Maps LiDAR points (x forward, y left, z up) to the optical frame, metres.
    K : ndarray, shape (3, 3), optional
        Pixels, for images of SIZE.
    D : ndarray, shape (5,)
        k1 k2 p1 p2 k3.

    """

    T_camera_lidar: NDArray[np.float64]
    K: NDArray[np.float64] | None = None
    D: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


def nominal() -> Calibration:
    """Return the mount as drawn: the camera looks where the LiDAR looks, from the same place."""
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    return Calibration(T)


def read_calibration(path: Path | str, run: str) -> Calibration:
    """
    Return the Calibration of a run from calibration_results.py.

    Parameters
    ----------
    path : Path
        Python source with dictionaries NAME_calibration and scenename_to_calibration. Only
        literals are read; nothing is executed.
    run : str
        For example AMtown01.

    Raises
    ------
    PersemError
        When the file is something else, or does not know the run.

    """
    values = _assignments(path)
    scenes = values.pop('scenename_to_calibration', {})
    scenes = scenes if isinstance(scenes, dict) else {}
    name = scenes.get(run)
    if name is None:
        prefixes = [key for key in values if key.endswith('_calibration')
                    and run.startswith(key[:-len('_calibration')])]
        name = max(prefixes, key=len, default=None)
    entry = values.get(name) if isinstance(name, str) else None
    if not isinstance(entry, dict):
        raise PersemError(f'{path}: no calibration for the run {run!r}; known: '
                          f'{", ".join(map(str, scenes)) or "none"}')
    return _calibration(entry, f'{path}: {name}')


def _assignments(path: Path | str) -> dict[str, object]:
    """Return {name: literal} of the file's top level; a name as a value is its text."""
    try:
        tree = ast.parse(read_text(path))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise PersemError(f'{path}: expected Python source with calibrations: {error}') from None
    values: dict[str, object] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                values[node.targets[0].id] = _literal(node.value)
            except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
                LOG.debug('%s: %s is not a literal, skipped', path, node.targets[0].id)
    return values


def _literal(node: ast.expr) -> object:
    """Return the value of a literal; names are text, np.array(literal) is its argument."""
    if isinstance(node, ast.Dict):
        return {_literal(key): _literal(value)
                for key, value in zip(node.keys, node.values, strict=True) if key is not None}
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Call) and len(node.args) > 0:
        return _literal(node.args[0])
    return ast.literal_eval(node)


def _calibration(entry: dict[object, Any], where: str) -> Calibration:
    """Return the Calibration of one dictionary, or refuse it."""
    numbers = {}
    for name, count in FIELDS.items():
        try:
            numbers[name] = np.array(entry[name], float).reshape(count)
        except (KeyError, TypeError, ValueError, OverflowError):
            raise PersemError(f'{where}: expected {count} numbers in {name!r}') from None
        if not np.isfinite(numbers[name]).all():
            raise PersemError(f'{where}: {name!r} holds values that are not finite')
    R = numbers['camera_ext_R'].reshape(3, 3)
    error = np.abs(R @ R.T - np.eye(3)).max()
    if error > 1e-2:
        LOG.warning('%s: camera_ext_R is %.3f off a rotation; the nearest one is used', where,
                    error)
    T = rigid(np.column_stack([R, numbers['camera_ext_t']]), f'{where}: camera_ext_R', MISPRINT)
    return Calibration(T, numbers['camera_intrinsic'].reshape(3, 3),
                       numbers['camera_dist_coeffs'])
