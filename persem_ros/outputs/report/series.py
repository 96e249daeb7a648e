"""Flicker over time, from the same counts as the totals in metrics.json."""

from __future__ import annotations

from typing import Any

import numpy as np

POINTS = 300        # of a line on the page, at most


class FlickerSeries:
    """The counts of flicker after every frame, by method."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._counts: list[dict[str, tuple[int, int]]] = []

    def add(self, stamp: int, counts: dict[str, tuple[int, int]]) -> None:
        """Add what was counted up to now: {method: (changed pixels, compared pixels)}."""
        self._stamps.append(stamp)
        self._counts.append(counts)

    def lines(self) -> dict[str, Any]:
        """
        Return the flicker of each frame against the one before, or of a few frames together.

        Returns
        -------
        dict
            t: seconds since the first frame; frames: how many a point sums up; lines:
            {method: percent}, None where nothing could be compared.

        """
        together = -(-max(1, len(self._stamps) - 1) // POINTS)
        ends = list(range(0, len(self._stamps), together))
        if ends and ends[-1] != len(self._stamps) - 1:
            ends.append(len(self._stamps) - 1)
        names = self._counts[-1] if self._counts else ()
        lines = {}
        for name in names:
            totals = np.array([self._counts[i][name] for i in ends], np.int64)
            changed, compared = np.diff(totals, axis=0).T
            lines[name] = [100.0 * int(c) / int(n) if n else None
                           for c, n in zip(changed, compared)]
        lines = {name: line for name, line in lines.items() if any(v is not None for v in line)}
        return {'t': [(self._stamps[i] - self._stamps[0]) / 1e9 for i in ends[1:]],
                'frames': together, 'lines': lines}


def chart(series: dict[str, Any]) -> dict[str, Any] | None:
    """
    Return the lines in the places where the page draws them, percent of width and height.

    Returns
    -------
    dict or None
        x, y: ticks (place, text); lines: {method: list of polylines 'x,y x,y ...'}; top: the
        flicker at the upper edge; None where there is nothing to draw.

    """
    t, lines = series['t'], series['lines']
    values = [v for line in lines.values() for v in line if v is not None]
    if len(t) < 2 or not values or t[-1] <= t[0]:
        return None
    step = nice(max(values) / 5 or 1.0)
    top = step * max(1, int(np.ceil(max(values) * 1.02 / step)))
    every = nice((t[-1] - t[0]) / 5)
    x_ticks = np.arange(np.ceil(t[0] / every), t[-1] / every + 1e-9) * every
    return {'top': top, 'start': t[0], 'end': t[-1],
            'x': [(100 * (x - t[0]) / (t[-1] - t[0]), f'{x:g}') for x in x_ticks.round(6)],
            'y': [(100 - 100 * y / top, f'{y:g}')
                  for y in np.arange(0, top + step / 2, step).round(6)],
            'lines': {name: _polylines(t, line, top) for name, line in lines.items()}}


def nice(step: float) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that is not below *step*."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(min(k * power for k in (1, 2, 5, 10) if k * power >= step * (1 - 1e-9)))


def _polylines(t: list[float], line: list[float | None], top: float) -> list[str]:
    """Return the stretches of a line without gaps as SVG points."""
    stretches: list[list[str]] = []
    points: list[str] = []
    for x, y in zip(t, line):
        if y is None:
            stretches, points = stretches + [points], []
        else:
            points.append(f'{1000 * (x - t[0]) / (t[-1] - t[0]):.1f},{1000 - 1000 * y / top:.1f}')
    return [' '.join(points) for points in stretches + [points] if points]
