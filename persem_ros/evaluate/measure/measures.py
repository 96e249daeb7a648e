"""Measures from counts: accuracy, mean IoU and flicker, for a sequence or for resamples of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.evaluate.measure.counts import PLACES

MEASURES = ('pixel_accuracy', 'miou', 'flicker')
BETTER = {'pixel_accuracy': 1, 'miou': 1, 'flicker': -1}


def measure(hits: NDArray[Any], predicted: NDArray[Any], true: NDArray[Any], changed: NDArray[Any],
            pairs: NDArray[Any] | int, **_: Any) -> NDArray[np.float64]:
    """
    Return the measures of every method in percent, NaN where they cannot be known.

    All arrays may have further axes in front, for example one for resamples.

    Parameters
    ----------
    hits, predicted : ndarray, shape (methods, classes)
        Pixels that were right and that were predicted, by class.
    true : ndarray, shape (classes,)
        Pixels by true class.
    changed : ndarray, shape (methods + 1,)
        Pixels whose label changed.
    pairs : ndarray, shape ()
        Pixels that were compared.

    Returns
    -------
    ndarray, shape (methods, 3), float64
        In the order of MEASURES.

    """
    true = np.asarray(true)[..., None, :]
    with np.errstate(divide='ignore', invalid='ignore'):
        accuracy = 100.0 * hits.sum(-1) / true.sum(-1)
        iou = np.where(true > 0, 100.0 * hits / (true + predicted - hits), 0.0)
        miou = iou.sum(-1) / (true > 0).sum(-1)
        flicker = 100.0 * changed[..., :-1] / np.asarray(pairs)[..., None]
    return np.stack(np.broadcast_arrays(accuracy, miou, flicker), axis=-1)


def summary(
        blocks: dict[str, NDArray[np.int64]], methods: Sequence[str], ids: Sequence[int]
) -> dict[str, Any]:
    """
    Return what metrics.json has for a sequence, from its blocks.

    Parameters
    ----------
    blocks : dict
        counts.Block's arrays with the blocks as first axis.
    methods : sequence of str
        In the order of the arrays.
    ids : sequence of int
        The id that each class stands for.

    """
    total = {name: array.sum(0) for name, array in blocks.items()}
    regions: dict[str, dict[str, Any]] = {}
    for k, place in enumerate(PLACES):
        here = {name: total[name][k] for name in (
            'hits', 'predicted', 'true', 'changed', 'pairs', 'true_pairs', 'pixels')}
        values = measure(**here)
        regions[place] = {
            'share': percent(here['pixels'], total['pixels'][0]),
            'truth_flicker': percent(here['changed'][-1], here['true_pairs']),
            'methods': {name: dict(zip(MEASURES, map(number, values[m])))
                        for m, name in enumerate(methods)}}
    whole = regions[PLACES[0]]
    return {'truth_flicker': whole['truth_flicker'],
            'methods': {name: {**whole['methods'][name], 'iou': _iou(total, m, ids)}
                        for m, name in enumerate(methods)},
            'regions': regions}


def number(value: float) -> float | None:
    """Return a float, None for what cannot be known."""
    return float(value) if np.isfinite(value) else None


def percent(part: int, whole: int) -> float | None:
    """Return 100 part / whole, None for a part of nothing."""
    return 100.0 * float(part) / float(whole) if whole else None


def _iou(total: dict[str, NDArray[np.int64]], m: int,
         ids: Sequence[int]) -> dict[str, float | None]:
    """Return {id: IoU in percent} of the classes that occur in the truth, by id."""
    hits, predicted, true = total['hits'][0, m], total['predicted'][0, m], total['true'][0]
    found = {ids[c]: percent(hits[c], true[c] + predicted[c] - hits[c])
             for c in np.flatnonzero(true).tolist()}
    return {str(i): found[i] for i in sorted(found)}
