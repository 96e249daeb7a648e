"""Curves, heat maps and the page of a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.evaluate.measure.measures import BETTER, MEASURES
from persem_ros.evaluate.show import page
from persem_ros.outputs.files import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure
    from persem_ros.evaluate.show.table import Table

FROM_LOG = 30       # positive values that span more than this factor get a logarithmic axis


def check() -> None:
    """Refuse to draw without matplotlib."""
    page.check()


def write(folder: Path, result: dict[str, Any], item: Table) -> None:
    """Write the figures and report.html of a sweep; item: its table."""
    from persem_ros.evaluate.show import style
    with style.look():
        shown = [page.figure(name, caption, style.save(figure, folder / 'figures' / name))
                 for name, caption, figure in figures(result)]
    write_text(folder / 'report.html', page.environment().get_template('sweep.html').render(
        result=result, item=item, figures=shown, **page.common()))


def figures(result: dict[str, Any]) -> Iterator[tuple[str, str, Figure]]:
    """Yield (name, caption, figure): curves for one axis, heat maps for two, else none."""
    axes = list(result['axes'])
    if result['each']:
        return
    if len(axes) == 1:
        yield ('curves', f'Accuracy, flicker, time and size of the map over {axes[0]}; thick: '
               'mean, thin: each sequence, dashed: truth.', curves(result, axes[0]))
    elif len(axes) == 2:
        for method in result['methods']:
            if method not in ('raw2d', 'ema2d'):
                yield (f'heat-{method}', f'{method} over {axes[0]} and {axes[1]}, mean of the '
                       'sequences; the brighter, the better.', heat(result, axes, method))


def curves(result: dict[str, Any], name: str) -> Figure:
    """Draw all methods over one setting."""
    from persem_ros.evaluate.show.style import new_figure, SOFT, STYLES, WORDS
    values = result['axes'][name]
    x, ticks, log = _positions(values)
    figure = new_figure(10.5, 5.2)
    all_axes = figure.subplots(2, 3).ravel()
    for axes, key in zip(all_axes, MEASURES):
        for method in result['methods']:
            color = STYLES[method][0]
            for sequence in result['recordings'] if len(result['recordings']) > 1 else ():
                axes.plot(x, _series(result, lambda p: p['sequences'][sequence]['methods'][
                    method][key]), color=color, linewidth=0.6, alpha=0.35)
            axes.plot(x, _series(result, lambda p: p['mean']['methods'][method][key]),
                      color=color, linewidth=2, marker=STYLES[method][1], label=method)
        if key == 'flicker':
            axes.plot(x, _series(result, lambda p: p['mean']['truth_flicker']), '--',
                      color=SOFT, label='truth')
        axes.set(ylabel=WORDS[key])
    for axes, (key, word) in zip(all_axes[3:], (
            ('voxels', 'voxels'), ('history_s', 'history, s'), ('refinement_s', 'refinement, s'))):
        axes.plot(x, _series(result, lambda p: p['mean'][key]), color=STYLES['persem'][0],
                  linewidth=2, marker='o')
        axes.set(ylabel=word)
        axes.set_ylim(bottom=0)
    for axes in all_axes:
        axes.set(xlabel=name)
        if log:
            axes.set_xscale('log')
        if ticks:
            axes.set_xticks(x, ticks)
    figure.legend(*all_axes[2].get_legend_handles_labels(), loc='outside upper right', ncols=6)
    return figure


def heat(result: dict[str, Any], names: list[str], method: str) -> Figure:
    """Draw one method over two settings."""
    from persem_ros.evaluate.show.style import new_figure, WORDS
    rows, columns = (result['axes'][name] for name in names)
    figure = new_figure(max(8.0, 1.6 * len(columns) + 3), max(3.2, 0.42 * len(rows) + 2.1))
    for axes, key in zip(figure.subplots(1, 3, sharey=True), MEASURES):
        grid = np.array(_series(result, lambda p: p['mean']['methods'][method][key])).reshape(
            len(rows), len(columns))
        drawn = axes.imshow(grid, cmap='viridis' if BETTER[key] > 0 else 'viridis_r',
                            aspect='auto')
        bar = figure.colorbar(drawn, ax=axes, location='bottom', shrink=0.8)
        if BETTER[key] < 0:
            bar.ax.invert_xaxis()       # bright, the better, is to the right of all
        axes.grid(False)
        axes.set_title(WORDS[key])
        middle = np.nanmean([np.nanmin(grid), np.nanmax(grid)]) if np.isfinite(grid).any() else 0
        for (v, u), value in np.ndenumerate(grid):
            bright = (value - middle) * BETTER[key] > 0
            axes.text(u, v, f'{value:.2f}', ha='center', va='center', fontsize=8,
                      color='black' if bright else 'white')
        axes.set_xticks(range(len(columns)), map(str, columns))
        axes.set_yticks(range(len(rows)), map(str, rows))
        axes.set(xlabel=names[1])
    figure.axes[0].set(ylabel=names[0])
    return figure


def _series(
        result: dict[str, Any], value: Callable[[dict[str, Any]], float | None]) -> list[float]:
    """Return one number per point, NaN for what is not known."""
    found = (value(point) for point in result['points'])
    return [np.nan if v is None else v for v in found]


def _positions(
        values: list[float | str | list[int]]) -> tuple[Sequence[float], list[str] | None, bool]:
    """Return places on the x axis, texts for them (None: numbers), whether it is logarithmic."""
    numbers = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(numbers) < len(values):
        return range(len(values)), [str(v) for v in values], False
    log = min(numbers) > 0 and max(numbers) / min(numbers) > FROM_LOG
    return numbers, None, log
