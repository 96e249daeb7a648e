"""Is depth in metres along the optical axis? Its numbers tell, and frames that see one place."""

from collections.abc import Iterator, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.agreement import FACTORS, misses, unit_factor, WORST
from persem_ros.core.transforms import inverse
from persem_ros.frames import Camera
from persem_ros.settings.config import Config, Memory

UNITS = {'millimetres': 0.001, 'centimetres': 0.01}     # metres per unit, of numbers too large
# L515 (0.25 mm), TUM (5000 units a metre), half and two millimetres, 5 mm units.
TRIED = (*FACTORS, 0.25, 0.2, 0.5, 2.0, 5.0)
FAR = 100.0         # metres: beyond them a depth that is all whole numbers is not in metres
MOST = 0.5          # share of the measurements that makes a finding
BASELINES = 0.1, 0.7    # of the depth, the motion that tells most where it is read right or small
ANCHORS = 4
CLEAR = 0.5         # of the error, that another kind of depth must leave at most
AGREE = 0.003       # relative depth error of frames that need no other reading
VISIBLE = 0.003     # relative depth error below which kinds are not told apart
EVERY = 4           # pixels between those whose numbers are looked at
Depths = Mapping[int, NDArray[np.float64]]      # metres, by number of the frame
Move = tuple[tuple[int, int], NDArray[np.float64]]      # i, j and what maps points of i to j


class Seen(NamedTuple):
    """A depth image (H, W) in metres, 0, NaN and infinity for none, its camera and its pose."""

    depth: NDArray[np.float64]
    camera: Camera
    T_map_camera: NDArray[np.float64]


def likely_unit(low: float, high: float, settings: Memory) -> str:
    """Return what to type where depths *low* to *high* are too large to be metres, else ''."""
    # Below twice the range, depths may as well be metres of a longer one.
    fitting = [f'if they are {name}: --set depth.scale={unit:g}' for name, unit in UNITS.items()
               if high > 2 * settings.max_depth and settings.min_depth <= unit * low
               and unit * high <= settings.max_depth]
    return ', '.join(fitting)


def about_depth(frames: Sequence[Seen], config: Config, unit: float = 1.0) -> Iterator[str]:
    """
    Yield what looks wrong with the depth of some frames: sentences with what to type.

    Parameters
    ----------
    frames : sequence of Seen (a persem_ros.frames.Frame is one, too)
        Of one camera, in stamp order; neighbours see the same places.
    config : persem_ros.settings.config.Config
        The settings with which the frames were read.
    unit : float
        Metres per unit of the depth images, as they were read.

    """
    frames = [f for f in frames if f.depth.shape == frames[0].depth.shape
              and np.array_equal(f.camera.K, frames[0].camera.K)]
    if not frames:
        return
    depths = {i: measured(frame.depth) for i, frame in enumerate(frames)}
    moves = moves_of(frames, depths)
    now = error_of(depths, moves, frames[0].camera.K)
    agree = now <= AGREE        # so well that no other reading is worth its computation
    wrong = not agree and _by_motion(frames, depths, unit) \
        or _by_numbers(depths, config.memory, unit)
    if wrong:
        yield wrong
    elif not agree and config.depth.kind != 'disparity':
        yield from _kind(frames, depths, moves, config.depth.kind)


def _by_numbers(depths: Depths, settings: Memory, unit: float) -> str:
    """Return the sentence about numbers that hardly are metres, '' where they may be."""
    values = np.concatenate([depth[::EVERY, ::EVERY].ravel() for depth in depths.values()])
    values = values[values > 0.0]
    if not values.size or unit != 1.0:
        return ''
    low, middle, high = np.percentile(values, (5, 50, 95))
    if middle >= FAR and (values == np.rint(values)).all():
        return (f'the depths are whole numbers ({low:.4g} to {high:.4g} m): millimetres? '
                f'--set depth.scale=0.001 reads them so')
    if np.mean(values > settings.max_depth) > MOST:
        proposal = likely_unit(low, high, settings)
        return proposal and (f'{100 * np.mean(values > settings.max_depth):.0f} % of the depths '
                             f'are beyond memory.max_depth ({low:.4g} to {high:.4g} m), is their '
                             f'unit right? {proposal[0].upper()}{proposal[1:]}')
    return ''


def _by_motion(frames: Sequence[Seen], depths: Depths, unit: float) -> str:
    """Return the sentence about a unit with which frames agree clearly better, else ''."""
    pairs = _pairs(frames, depths)
    poses = {i: frame.T_map_camera for i, frame in enumerate(frames)}
    factor, now, then = unit_factor(depths, poses, frames[0].camera.K, pairs, TRIED)
    if factor == 1.0:
        return ''
    where = 'nowhere within 10 %' if now > 0.99 * WORST else f'within {100 * now:.1f} %'
    return (f"the depth's unit looks wrong: depth of one frame meets that of another {where}, "
            f'but within {100 * then:.1f} % with --set depth.scale={unit * factor:g}')


def _kind(frames: Sequence[Seen], depths: Depths,
          moves: Sequence[Move], kind: str) -> Iterator[str]:
    """Yield the sentence about the other kind of depth, where frames agree clearly better."""
    lengths = np.sqrt(1.0 + (frames[0].camera.rays ** 2).sum(-1))
    other, scale = ('z', lengths) if kind == 'ray' else ('ray', 1.0 / lengths)
    K = frames[0].camera.K
    a = error_of(depths, moves, K)
    b = error_of({i: depth * scale for i, depth in depths.items()}, moves, K)
    if b < CLEAR * a and a - b > VISIBLE:
        what = 'the distance along the ray' if other == 'ray' else 'along the optical axis'
        yield (f'the depth looks like {what}: depth of one frame misses that of another by '
               f'{100 * a:.1f} %, but by {100 * b:.1f} % with --set depth.kind={other}')


def _pairs(frames: Sequence[Seen], depths: Depths) -> list[tuple[int, int]]:
    """Return pairs of frames that moved by about BASELINES of what they see, spread over all."""
    positions = np.array([frame.T_map_camera[:3, 3] for frame in frames])
    found = []
    for i in np.unique(np.linspace(0, len(frames) - 2, ANCHORS).astype(int)) if len(frames) > 1 \
            else ():
        seen = depths[int(i)][depths[int(i)] > 0]
        if seen.size:
            moved = np.linalg.norm(positions[i + 1:] - positions[i], axis=1)
            found += [(int(i), int(i + 1 + np.argmin(np.abs(moved - share * np.median(seen)))))
                      for share in BASELINES]
    return list(dict.fromkeys(found))


def moves_of(frames: Sequence[Seen],
             depths: Depths) -> list[Move]:
    """Return the pairs of _pairs(), each with the 4x4 that maps points of i to j."""
    return [((i, j), inverse(frames[j].T_map_camera) @ frames[i].T_map_camera)
            for i, j in _pairs(frames, depths)]


def error_of(depths: Depths, moves: Sequence[Move],
             K: NDArray[np.float64]) -> float:
    """Return the mean of what misses() gives, cut at WORST; infinity with nothing to compare."""
    errors = [misses(depths[i], depths[j], T, K) for (i, j), T in moves]
    found = np.concatenate([np.zeros(0), *errors])
    found = found[np.isfinite(found)]
    return float(np.minimum(found, WORST).mean()) if found.size else math.inf


def measured(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a depth image in which 0 alone is no measurement."""
    if depth.size and depth.min() >= 0.0 and depth.max() < np.inf:     # neither is so of NaN
        return depth
    return np.where(np.isfinite(depth) & (depth > 0.0), depth, 0.0)
