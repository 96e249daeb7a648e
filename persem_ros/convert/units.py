"""Is the depth in the unit that it is read in? Frames with known poses tell it by parallax."""

import logging

import numpy as np
from persem_ros.convert.axes import misses, pairs_to_check, WORST
from persem_ros.convert.images import UNITS
from persem_ros.core.transforms import inverse

LOG = logging.getLogger(__name__)
FACTORS = (1.0, 0.1, 10.0, 0.01, 100.0, 0.001, 1000.0)      # on the depth as it is read
GAIN = 0.2      # of the error without motion, that a unit has to explain
SEEN = 0.02     # of the pixels, that must stay in the image to speak for a unit


def unit_factor(depths, poses, K):
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

    Returns
    -------
    float
        One of FACTORS; 1 where no other is clearly better.
    float
        Mean relative depth error as it is read, cut at WORST; NaN with nothing to compare.
    float
        The same of the factor, on the same pixels.

    """
    count = max(depths) + 1 if depths else 0
    pairs = [(i, j) for i, j in pairs_to_check(count) if i in depths and j in depths]
    moves = [inverse(poses[j]) @ poses[i] for i, j in pairs]
    still = _errors(depths, pairs, [_turn(T) for T in moves], K, 1.0)
    errors = {factor: _errors(depths, pairs, moves, K, factor) for factor in FACTORS}
    mine = errors[1.0]
    best = max(FACTORS, key=lambda factor: _gain(errors[factor], still))
    both = np.isfinite(mine) & np.isfinite(errors[best])
    if np.count_nonzero(both) < SEEN * mine.size:
        both = np.isfinite(errors[best])        # as it is read, the frames do not see each other
    if not both.any():
        return 1.0, float('nan'), float('nan')
    now, then = (float(np.minimum(e[both], WORST).mean()) for e in (mine, errors[best]))
    clear = _gain(errors[best], still) > GAIN and then < 0.8 * now and now - then > 1e-3
    return (best, now, then) if clear else (1.0, now, now)


def check_unit(depths, poses, K, per_metre):
    """
    Warn when another unit fits better than *per_metre*, the stored units that make a metre.

    Returns
    -------
    float
        The factor that the depth needs; 1 where it is right or cannot be told.
    float
        The error of unit_factor() as it is read.

    """
    factor, now, then = unit_factor(depths, poses, K)
    if factor != 1.0:
        where = 'nowhere within 10.0 %' if now > 0.99 * WORST else f'within {100 * now:.1f} %'
        LOG.warning('the depth unit looks wrong: depth of one frame meets that of another %s, but '
                    'within %.1f %% with --depth-unit %s', where, 100 * then,
                    name_of_unit(per_metre / factor))
    return factor, now


def name_of_unit(per_metre):
    """Return m, cm or mm, or else the number of units that make a metre."""
    for name, value in UNITS.items():
        if abs(per_metre / value - 1) < 1e-6:
            return name
    return f'{per_metre:g}'


def _turn(T):
    """Return a transform without its translation."""
    result = np.eye(4)
    result[:3, :3] = T[:3, :3]
    return result


def _errors(depths, pairs, moves, K, factor):
    """Return the misses of all pairs with the depth times *factor*, one array."""
    errors = [misses(factor * depths[i], factor * depths[j], T, K)
              for (i, j), T in zip(pairs, moves, strict=True)]
    return np.concatenate(errors) if errors else np.empty(0)


def _gain(errors, still):
    """Return the part of the error without motion that a factor explains; -1 unseen or flat."""
    seen = np.isfinite(errors) & np.isfinite(still)
    if np.count_nonzero(seen) < max(20, SEEN * errors.size):
        return -1.0
    with_motion, without = (np.minimum(e[seen], WORST).mean() for e in (errors, still))
    return (without - with_motion) / without if without - with_motion > 1e-3 else -1.0
