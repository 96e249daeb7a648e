"""Do depth images agree with each other? Frames with known poses tell a unit by parallax."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverse

WORST = 0.1         # relative depth error at which a pixel counts as a miss
PIXELS = 5000       # looked at per pair
FACTORS = (1.0, 0.1, 10.0, 0.01, 100.0, 0.001, 1000.0)      # on the depth as it is read
GAIN = 0.2      # of the error without motion, that a unit has to explain
SEEN = 0.02     # of the pixels, that must stay in the image to speak for a unit


def unit_factor(depths: Mapping[int, NDArray[np.float64]],
                poses: Mapping[int, NDArray[np.float64]], K: NDArray[np.float64],
                pairs: Sequence[tuple[int, int]] | None = None,
                factors: Sequence[float] = FACTORS) -> tuple[float, float, float]:
    """
    Return the factor on the depth under which frames agree best with each other.

    A depth too large always keeps its pixels in the image and, where the scene is flat, fits
    well; one too small loses them. So a factor counts only by how much better it explains its
    own pixels than no motion at all does, and two are compared on the pixels of both.

    Parameters
    ----------
    depths : dict of int to ndarray, shape (H, W), float64
        Metres as they are read, per frame; 0 is no measurement.
    poses : dict of int to ndarray, shape (4, 4)
        T_map_camera of the frames.
    K : ndarray, shape (3, 3)
        Pinhole matrix.
    pairs : sequence of (int, int), optional
        Frames to compare; by default those of pairs_to_check().
    factors : sequence of float
        What is tried; 1 is among them.

    Returns
    -------
    float
        One of the factors; 1 where no other is clearly better.
    float
        Mean relative depth error as it is read, cut at WORST; NaN with nothing to compare.
    float
        The same of the factor, on the same pixels.

    """
    if pairs is None:
        count = max(depths) + 1 if depths else 0
        pairs = [(i, j) for i, j in pairs_to_check(count) if i in depths and j in depths]
    moves = [inverse(poses[j]) @ poses[i] for i, j in pairs]
    points = {i: unprojected(depths[i], K) for i in {i for i, _ in pairs}}
    still = _errors(points, depths, pairs, [_turn(T) for T in moves], K, 1.0)
    errors = {factor: _errors(points, depths, pairs, moves, K, factor) for factor in factors}
    mine = errors[1.0]
    best = max(factors, key=lambda factor: _gain(errors[factor], still))
    both = np.isfinite(mine) & np.isfinite(errors[best])
    if np.count_nonzero(both) < SEEN * mine.size:
        both = np.isfinite(errors[best])        # as it is read, the frames do not see each other
    if not both.any():
        return 1.0, float('nan'), float('nan')
    now, then = (float(np.minimum(e[both], WORST).mean()) for e in (mine, errors[best]))
    clear = _gain(errors[best], still) > GAIN and then < 0.8 * now and now - then > 1e-3
    return (best, now, then) if clear else (1.0, now, now)


def pairs_to_check(count: int, anchors: int = 8,
                   steps: Sequence[int] = (1, 3, 8)) -> list[tuple[int, int]]:
    """Return index pairs, spread over *count* frames, near enough to overlap."""
    starts = np.unique(np.linspace(0, max(count - 2, 0), anchors).astype(int))
    return [(int(i), int(i) + step) for i in starts for step in steps if i + step < count]


def misses(
        depth_i: NDArray[np.float64], depth_j: NDArray[np.float64], T_j_i: NDArray[np.float64],
        K: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return the relative depth errors of frame i, seen from frame j.

    Parameters
    ----------
    depth_i, depth_j : ndarray, shape (H, W), float64
        Metres, 0 is no measurement.
    T_j_i : ndarray, shape (4, 4)
        Maps optical points of i to j.
    K : ndarray, shape (3, 3)
        Pinhole matrix of both.

    Returns
    -------
    ndarray, shape (N,), float64
        Of the pixels of i with a measurement, some PIXELS of them, which ones depends on
        *depth_i* alone; infinite for what leaves the image, NaN for what meets no measurement.

    """
    return missed(unprojected(depth_i, K), depth_j, T_j_i, K)


def unprojected(depth: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, N) optical points of some PIXELS of the pixels with a measurement, metres."""
    height, width = depth.shape
    stride = max(1, int(np.sqrt(depth.size / PIXELS)))
    v, u = np.mgrid[:height:stride, :width:stride].reshape(2, -1)
    d = depth[v, u]
    u, v, d = u[d > 0], v[d > 0], d[d > 0]
    return np.asarray(np.linalg.inv(K) @ (np.stack([u, v, np.ones(len(u))]) * d), np.float64)


def missed(points: NDArray[np.float64], depth_j: NDArray[np.float64],
           T_j_i: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what misses() returns, of the (3, N) points of unprojected()."""
    height, width = depth_j.shape
    x, y, z = T_j_i[:3, :3] @ points + T_j_i[:3, 3:]
    ahead = z > 1e-6
    with np.errstate(divide='ignore', invalid='ignore'):
        u = np.where(ahead, K[0, 0] * x / z + K[0, 2], -1.0)
        v = np.where(ahead, K[1, 1] * y / z + K[1, 2], -1.0)
    seen = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    error = np.full(len(z), np.inf)
    z = z[seen]
    hit = depth_j[np.rint(v[seen]).astype(int), np.rint(u[seen]).astype(int)]
    miss = np.abs(z - hit) / np.maximum(hit, 1e-6)
    error[seen] = np.where(hit > 0, miss, np.nan)
    return error


def _turn(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a transform without its translation."""
    result = np.eye(4)
    result[:3, :3] = T[:3, :3]
    return result


def _errors(
        points: Mapping[int, NDArray[np.float64]], depths: Mapping[int, NDArray[np.float64]],
        pairs: Sequence[tuple[int, int]], moves: Sequence[NDArray[np.float64]],
        K: NDArray[np.float64], factor: float
) -> NDArray[np.float64]:
    """Return the misses of all pairs with the depth times *factor*, one array."""
    # Relative errors are those of a motion that is smaller by as much: no image is multiplied.
    scale = np.ones((4, 4))
    scale[:3, 3] = 1.0 / factor
    errors = [missed(points[i], depths[j], T * scale, K)
              for (i, j), T in zip(pairs, moves, strict=True)]
    return np.concatenate(errors) if errors else np.empty(0)


def _gain(errors: NDArray[np.float64], still: NDArray[np.float64]) -> float:
    """Return the part of the error without motion that a factor explains; -1 unseen or flat."""
    seen = np.isfinite(errors) & np.isfinite(still)
    if np.count_nonzero(seen) < max(20, SEEN * errors.size):
        return -1.0
    with_motion, without = (np.minimum(e[seen], WORST).mean() for e in (errors, still))
    return (without - with_motion) / without if without - with_motion > 1e-3 else -1.0
