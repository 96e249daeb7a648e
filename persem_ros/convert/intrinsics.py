"""Pinhole matrix and distortion, from a text file, a ROS calibration file or four numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import numbers_of, read_lines, read_text
from persem_ros.errors import PersemError
from persem_ros.guard import yaml_text

COUNTS = dict(enumerate(('none', 'one', 'two', 'three', 'four', 'five', 'six')))
EXPECTED = 'expected 4 numbers (fx fy cx cy), a 3x3 or a 4x4 matrix'


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """
    A camera as its data set describes it.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Pixels; pixel centres at integers.
    D : ndarray
        Distortion coefficients, empty for none.
    model : str
        The distortion model's ROS name.
    size : tuple of int, optional
        (width, height) that K belongs to; None where the file does not say.

    """

    K: NDArray[np.float64]
    D: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    model: str = 'plumb_bob'
    size: tuple[int, int] | None = None


def read_intrinsics(source: Path | str) -> Intrinsics:
    """
    Return the Intrinsics of a file or of text.

    Parameters
    ----------
    source : Path or str
        A text file with a matrix or "fx fy cx cy", a YAML file of ROS' camera_calibration, or
        the four numbers themselves with commas.

    Raises
    ------
    PersemError
        When that is not what it is, or the focal lengths are not positive.

    """
    if isinstance(source, str) and is_numbers(source):
        words, where = _words(source), f'--intrinsics {source}'
    elif Path(source).suffix in ('.yaml', '.yml'):
        return _ros_calibration(source)
    else:
        words, where = [word for _, line in read_lines(source) for word in line], str(source)
    values = numbers_of(words, where)
    if len(values) == 4:
        fx, fy, cx, cy = values
        return Intrinsics(_checked([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], where))
    if len(values) not in (9, 16):
        raise PersemError(f'{where}: {EXPECTED}, got {len(values)} numbers')
    side = 3 if len(values) == 9 else 4
    return Intrinsics(_checked(values.reshape(side, side)[:3, :3], where))


def is_numbers(text: str) -> bool:
    """
    Whether --intrinsics is fx,fy,cx,cy itself, and no file.

    Raises
    ------
    PersemError
        For numbers that are not four.

    """
    words = _words(text)
    if len(words) == 4 or not words or Path(text).is_file():
        return len(words) == 4
    try:
        count = len(numbers_of(words, text))
    except PersemError:
        return False
    raise PersemError(f'--intrinsics {text}: expected four numbers fx,fy,cx,cy, got '
                      f'{COUNTS.get(count, count)}')


def _words(text: str) -> list[str]:
    """Return what stands between commas."""
    return [word for word in text.split(',') if word.strip()]


def _ros_calibration(path: Path | str) -> Intrinsics:
    """Return the Intrinsics of a camera_calibration YAML file."""
    try:
        content = yaml_text.load(read_text(path), str(path), yaml_text.SETTINGS)
        K = np.array(content['camera_matrix']['data'], float).reshape(3, 3)
        D = np.array(content['distortion_coefficients']['data'], float).reshape(-1)
        size = int(content['image_width']), int(content['image_height'])
        model = str(content['distortion_model'])
    except (PersemError, KeyError, TypeError, ValueError, OverflowError):
        raise PersemError(f'{path}: expected a ROS camera calibration with image_width, '
                          'image_height, camera_matrix, distortion_model and '
                          'distortion_coefficients') from None
    return Intrinsics(_checked(K, path), D, model, size)


def _checked(K: NDArray[np.float64] | list[list[float]], where: Path | str) -> NDArray[np.float64]:
    K = np.array(K, float)
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise PersemError(f'{where}: expected positive focal lengths, got fx = {K[0, 0]:g}, '
                          f'fy = {K[1, 1]:g}; {EXPECTED}')
    if abs(K[0, 1]) > 1e-6 or not np.allclose(K[1:], [[0, K[1, 1], K[1, 2]], [0, 0, 1]]):
        raise PersemError(f'{where}: expected a pinhole matrix [fx 0 cx; 0 fy cy; 0 0 1]')
    return K
