"""The poses of a data set, and pose files with one pose each (7-Scenes, ScanNet)."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import numbers_of, read_lines
from persem_ros.core.transforms import matrix_to_quaternion, slerp, transform
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from pathlib import Path

ROTATION_TOLERANCE = 1e-2       # largest entry of |R R^T - I| that is put down to rounding
EXPECTED = ('expected 16 or 12 numbers (a 4x4 or 3x4 matrix) or 7 numbers '
            '(x y z qx qy qz qw)')


@dataclass
class Poses:
    """
    The poses of a data set, as its files have them.

    Attributes
    ----------
    by_key : dict of str to ndarray, shape (4, 4)
        Poses that belong to one frame.
    stamps : list of int
        Stamps of a trajectory, ascending nanoseconds.
    matrices : list of ndarray, shape (4, 4)
        The trajectory's poses.
    lost : list of str
        Frames whose pose is NaN or infinite: the tracker's way to say "lost".
    order : str
        How quaternions were read: "x y z w" or "w x y z"; empty where there are none.
    other : Poses, optional
        The same file in the other order, where nothing in it says which it is.

    """

    by_key: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    stamps: list[int] = field(default_factory=list)
    matrices: list[NDArray[np.float64]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    order: str = ''
    other: Poses | None = None

    def add(self, key: str, T: NDArray[np.float64] | None) -> None:
        """Take the pose of a frame, None for a lost one."""
        if T is None:
            self.lost.append(key)
        else:
            self.by_key[key] = T

    def at(self, key: str, stamp: int) -> NDArray[np.float64] | None:
        """Return the pose of a frame, interpolated in a trajectory; None where there is none."""
        if not self.stamps:
            return self.by_key.get(key)
        i = bisect_left(self.stamps, stamp)
        if i < len(self.stamps) and self.stamps[i] == stamp:
            return self.matrices[i]
        if i == 0 or i == len(self.stamps):
            return None
        a, b = self.matrices[i - 1:i + 1]
        f = (stamp - self.stamps[i - 1]) / (self.stamps[i] - self.stamps[i - 1])
        q = slerp(matrix_to_quaternion(a[:3, :3]), matrix_to_quaternion(b[:3, :3]), f)
        return transform((1 - f) * a[:3, 3] + f * b[:3, 3], q)


def rigid(
        matrix: NDArray[np.float64], where: Path | str, tolerance: float = ROTATION_TOLERANCE
) -> NDArray[np.float64]:
    """
    Return a 4x4 matrix with the nearest rotation in it.

    Raises
    ------
    PersemError
        When it is farther from a rotation than *tolerance* (largest entry of |R R^T - I|), a
        mirror image, or its last row is not 0 0 0 1.

    """
    T = np.eye(4)
    matrix = np.asarray(matrix, float)
    T[:matrix.shape[0]] = matrix
    R = T[:3, :3]
    error = np.abs(R @ R.T - np.eye(3)).max()
    if not np.allclose(T[3], [0, 0, 0, 1], atol=1e-6):
        raise PersemError(f'{where}: expected 0 0 0 1 as the last row of the pose, got '
                          f'{" ".join(f"{v:g}" for v in T[3])}; is it transposed?')
    if not error <= tolerance or np.linalg.det(R) < 0:
        what = 'mirrors' if error <= tolerance else f'is off by {error:.3g}'
        raise PersemError(f'{where}: expected a rotation in the pose, but the matrix {what}')
    U, _, Vt = np.linalg.svd(R)
    T[:3, :3] = U @ Vt
    return T


def pose_of_numbers(values: NDArray[np.float64], where: Path | str) -> NDArray[np.float64] | None:
    """
    Return the 4x4 matrix of 16, 12 or 7 numbers, None where one is not finite.

    Raises
    ------
    PersemError
        For another count, a quaternion that is not of norm 1, or no rotation.

    """
    if len(values) not in (7, 12, 16):
        raise PersemError(f'{where}: {EXPECTED}, got {len(values)}')
    if not np.isfinite(values).all():
        return None
    if len(values) != 7:
        return rigid(values.reshape(-1, 4), where)
    norm = np.linalg.norm(values[3:])
    if abs(norm - 1) > 1e-2:
        raise PersemError(f'{where}: expected a quaternion of norm 1, got {norm:.3g}; the order '
                          'is x y z qx qy qz qw')
    return transform(values[:3], values[3:] / norm)


def poses_from_files(files: dict[str, Path]) -> Poses:
    """Return the Poses of {key: path}, one pose a file."""
    poses = Poses()
    for key, path in files.items():
        words = [word for _, line in read_lines(path) for word in line]
        T = pose_of_numbers(numbers_of(words, path), path)
        poses.add(key, T)
    return poses
