"""Rigid transforms as 4x4 matrices, quaternions as x y z w; one, and in the plural many."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def quaternion_to_matrix(q: NDArray[np.float64] | Sequence[float]) -> NDArray[np.float64]:
    """Return the 3x3 rotation of the unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def matrix_to_quaternion(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a 3x3 rotation."""
    m = np.asarray(R, float)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    # Shepperd: divide by the largest of the four, so that nothing small is divided by.
    i = int(np.argmax([m[0, 0], m[1, 1], m[2, 2], trace]))
    q = np.empty(4)
    if i == 3:
        q[3] = 1 + trace
        q[:3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1 + m[i, i] - m[j, j] - m[k, k]
        q[j] = m[j, i] + m[i, j]
        q[k] = m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    q /= np.linalg.norm(q)
    return -q if q[3] < 0 else q


def transform(translation: NDArray[np.float64] | Sequence[float],
              q: NDArray[np.float64] | Sequence[float]) -> NDArray[np.float64]:
    """Return the 4x4 matrix of a translation (3,) and a unit quaternion (x, y, z, w)."""
    T = np.zeros((4, 4))        # an eye takes ten times as long, and poses come by the thousand
    T[3, 3] = 1.0
    T[:3, :3] = quaternion_to_matrix(q)
    T[:3, 3] = translation
    return T


def inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a rigid 4x4 transform."""
    R = T[:3, :3].T
    result = np.zeros((4, 4))
    result[3, 3] = 1.0
    result[:3, :3] = R
    result[:3, 3] = -R @ T[:3, 3]
    return result


def transformed(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return points (n, 3) moved by a rigid 4x4 transform.

    Axis by axis, as fast as a product of matrices: behind that of an image's points, threads of
    OpenBLAS keep a core busy for 0.1 s, and a frame added meanwhile took 7 ms instead of 4.

    """
    x, y, z = points.T
    return np.stack([a * x + b * y + c * z + t for a, b, c, t in T[:3]], axis=-1)


def slerp(
        q0: NDArray[np.float64], q1: NDArray[np.float64], fraction: float) -> NDArray[np.float64]:
    """Interpolate between unit quaternions along the shorter arc."""
    q0, q1 = np.asarray(q0, float), np.asarray(q1, float)
    dot = float(q0 @ q1)
    if dot < 0:
        q1, dot = -q1, -dot
    if dot > 0.9995:        # nearly the same: the arc is a chord
        q = q0 + fraction * (q1 - q0)
    else:
        angle = np.arccos(dot)
        q = (np.sin((1 - fraction) * angle) * q0 + np.sin(fraction * angle) * q1) / np.sin(angle)
    return q / np.linalg.norm(q)


def slerps(q0: NDArray[np.float64], q1: NDArray[np.float64],
           fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return slerp() of many unit quaternions (n, 4); fractions (n, 1)."""
    dot = (q0 * q1).sum(axis=1, keepdims=True)
    q1, dot = np.where(dot < 0, -q1, q1), np.abs(dot)
    angle = np.arccos(np.minimum(dot, 1.0))
    chord = dot > 0.9995
    sine = np.where(chord, 1.0, np.sin(angle))
    q = np.where(chord, q0 + fraction * (q1 - q0),
                 (np.sin((1 - fraction) * angle) * q0 + np.sin(fraction * angle) * q1) / sine)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def quaternions(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y, z, w of rotations (n, 3, 3): unit quaternions, shape (n, 4)."""
    diagonal = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    products = np.empty((len(R), 4, 4))         # 4 q q^T
    for i in range(3):
        products[:, i, i] = 1 + 2 * diagonal[i] - sum(diagonal)
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, j, k] = products[:, k, j] = R[:, j, k] + R[:, k, j]
        products[:, i, 3] = products[:, 3, i] = R[:, k, j] - R[:, j, k]
    products[:, 3, 3] = 1 + sum(diagonal)
    largest = np.argmax(np.einsum('nii->ni', products), axis=1)     # nothing small divides
    q = products[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, 3:] < 0, -q, q)


def rotations(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what unit quaternions (n, 4), x y z w, turn by: matrices (n, 3, 3)."""
    x, y, z, w = q.T
    return np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        axis=1).reshape(-1, 3, 3)


def inverses(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverses of rigid transforms (n, 4, 4)."""
    result = np.zeros_like(T)
    R = np.swapaxes(T[:, :3, :3], 1, 2)
    result[:, :3, :3] = R
    result[:, :3, 3] = -(R @ T[:, :3, 3:])[:, :, 0]
    result[:, 3, 3] = 1.0
    return result
