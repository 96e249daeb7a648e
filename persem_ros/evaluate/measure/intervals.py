"""
Paired block bootstrap: how sure the difference between two methods is.

Consecutive frames are anything but independent, so whole stretches of them are drawn with
replacement, the same ones for both methods, and the measures are computed anew from what was
drawn. The map itself is not rebuilt: the interval says how much of a difference comes from which
frames were looked at, not from which flight was flown. Where there are enough sequences these are
drawn with replacement too, and say how much comes from which flight was flown.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.evaluate.measure.counts import PLACES
from persem_ros.evaluate.measure.measures import measure, MEASURES, number

RESAMPLES = 2000
COVERED = 95.0          # percent
FEWEST = 5              # blocks; fewer say nothing
NEEDED = ('hits', 'predicted', 'true', 'changed', 'pairs')
CHUNK = 200             # resamples at a time: bounded memory


def resampled(
        blocks: dict[str, NDArray[Any]], seed: int = 0, resamples: int = RESAMPLES
) -> NDArray[np.float64]:
    """
    Return the measures of resamples of a sequence.

    Parameters
    ----------
    blocks : dict of str to ndarray
        counts.Block's arrays with the blocks as first axis.
    seed : int
        Of the draws.
    resamples : int
        Number of draws.

    Returns
    -------
    ndarray, shape (resamples, places, methods, 3), float64
        NaN throughout for a sequence of fewer than FEWEST blocks.

    """
    n = len(blocks['pixels'])
    n_methods = blocks['hits'].shape[2]
    if n < FEWEST:
        return np.full((resamples, len(PLACES), n_methods, len(MEASURES)), np.nan)
    draws = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), resamples)
    parts = []
    for weights in np.array_split(draws.astype(np.float64), -(-resamples // CHUNK)):
        drawn = {name: (weights @ blocks[name].reshape(n, -1)).reshape(
            len(weights), *blocks[name].shape[1:]) for name in NEEDED}
        parts.append(measure(**drawn))
    return np.concatenate(parts)


def differences(
        sequences: list[dict[str, NDArray[Any]]], methods: Sequence[str], base: str,
        resamples: int = RESAMPLES, drawn: list[NDArray[np.float64]] | None = None,
        whole: bool = False
) -> dict[str, dict[str, dict[str, dict[str, float | None]]]]:
    """
    Return the macro-averaged gain of each method over *base* with its interval.

    Parameters
    ----------
    sequences : sequence of dict
        The blocks of each sequence.
    methods : sequence of str
        In the order of the arrays.
    base : str
        One of them.
    resamples : int
        Number of draws.
    drawn : sequence of ndarray, optional
        What resampled() returned for each sequence, so that it is computed once for all bases.
    whole : bool
        Draw whole sequences, as they are, instead of their frames; no interval for fewer than
        FEWEST of them.

    Returns
    -------
    dict
        By place, method and measure: value (points; negative is less), low and high (the
        interval, None where there are too few frames), rises and falls (number of sequences
        whose value rises or falls).

    """
    if drawn is None:
        drawn = [] if whole else [resampled(blocks, seed, resamples)
                                  for seed, blocks in enumerate(sequences)]
    point = np.stack([measure(**{name: blocks[name].sum(0) for name in NEEDED})
                      for blocks in sequences])         # (sequences, places, methods, 3)
    b = list(methods).index(base)
    each = point - point[:, :, b:b + 1]
    known = np.isfinite(each)
    times = known.sum(0)
    if whole:
        n = len(each)
        draws = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), resamples) \
            * (1.0 if n >= FEWEST else np.nan)
        total, times = (np.tensordot(draws, a, 1) for a in (np.where(known, each, 0.0), known))
    else:
        total = np.sum([np.where(known[k], one - one[:, :, b:b + 1], 0.0)
                        for k, one in enumerate(drawn)], axis=0)
    with np.errstate(invalid='ignore'):
        total = total / times
        value = np.where(known, each, 0.0).sum(0) / known.sum(0)
    edge = (100.0 - COVERED) / 2
    low, high = np.percentile(total, [edge, 100.0 - edge], axis=0)
    rises, falls = (known & (each > 0)).sum(0), (known & (each < 0)).sum(0)
    return {place: {name: {key: {
        'value': number(value[p, m, k]), 'low': number(low[p, m, k]),
        'high': number(high[p, m, k]), 'rises': int(rises[p, m, k]),
        'falls': int(falls[p, m, k])} for k, key in enumerate(MEASURES)}
        for m, name in enumerate(methods) if name != base} for p, place in enumerate(PLACES)}
