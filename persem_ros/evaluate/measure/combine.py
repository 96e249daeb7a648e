"""Several sequences become one evaluation: macro averages, differences, intervals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from persem_ros.evaluate.measure import intervals
from persem_ros.evaluate.measure.counts import PLACES
from persem_ros.evaluate.measure.measures import MEASURES
from persem_ros.evaluate.measure.result import Result

BASES = ('majority', 'raw2d', 'context_history')    # what methods are compared with
BLOCK_ARRAYS = ('hits', 'predicted', 'true', 'changed', 'pairs', 'true_pairs', 'pixels')


def combined(results: dict[str, Result],
             resamples: int = intervals.RESAMPLES) -> dict[str, Any]:
    """
    Return what evaluation.json holds.

    Parameters
    ----------
    results : dict
        Of evaluate_sequence, by the name of the sequence.
    resamples : int
        Of the bootstrap.

    Returns
    -------
    dict
        methods; sequences {name: summary}; macro, by place: sequences (how many have truth),
        share, truth_flicker, methods; differences {base: {place: {method: {measure: ...}}}}, as
        intervals.differences; the same with whole sequences drawn in between_sequences, and for
        each sequence alone in by_sequence.

    """
    methods = next(iter(results.values()))[0]['methods_order']
    summaries = {name: summary for name, (summary, _) in results.items()}
    blocks = {name: {key: arrays[key] for key in BLOCK_ARRAYS}
              for name, (_, arrays) in results.items()}
    drawn = {name: intervals.resampled(one, seed, resamples)
             for seed, (name, one) in enumerate(blocks.items())}
    bases = [base for base in BASES if base in methods]
    return {
        'methods': methods, 'sequences': summaries,
        'taxonomy': next(iter(summaries.values()))['taxonomy'],
        'macro': {place: _macro([s['regions'][place] for s in summaries.values()], methods)
                  for place in PLACES},
        'interval': {'covered_percent': intervals.COVERED, 'resamples': resamples,
                     'how': 'paired block bootstrap over stretches of consecutive frames'},
        'differences': {base: intervals.differences(
            list(blocks.values()), methods, base, resamples, list(drawn.values()))
            for base in bases},
        'between_sequences': {base: intervals.differences(
            list(blocks.values()), methods, base, resamples, whole=True) for base in bases},
        'by_sequence': {name: {base: intervals.differences(
            [one], methods, base, resamples, [drawn[name]]) for base in bases}
            for name, one in blocks.items()}}


def _macro(
        rows: list[dict[str, Any]], methods: list[str]) -> dict[str, Any]:
    """Return the macro average of one region over the sequences that know each value."""
    return {'sequences': sum(row['methods'][methods[0]]['pixel_accuracy'] is not None
                             for row in rows),
            'share': mean(row['share'] for row in rows),
            'truth_flicker': mean(row['truth_flicker'] for row in rows),
            'methods': {name: {key: mean(row['methods'][name][key] for row in rows)
                               for key in MEASURES} for name in methods}}


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of those that are known, None where none is."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None
