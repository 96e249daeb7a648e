"""The figures of several sequences together: trade-off, differences, classes, regions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

from matplotlib.ticker import MaxNLocator
import numpy as np
from persem_ros.evaluate.measure.combine import mean
from persem_ros.evaluate.measure.counts import PLACES
from persem_ros.evaluate.measure.measures import BETTER, MEASURES
from persem_ros.evaluate.show.paper_tables import PLACE_NAMES
from persem_ros.evaluate.show.style import INK, lighter, new_figure, SOFT, STYLES, WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CLASSES_SHOWN = ('raw2d', 'majority', 'persem', 'geometry')
HEAP = 2.0      # spans of the other methods on voxels: with geometry further away they are a heap


def figures(evaluation: dict[str, Any]) -> Iterator[tuple[str, str, Figure]]:
    """Yield (name, caption, figure) of what the evaluation allows."""
    if evaluation['macro']['all']['sequences']:
        yield ('tradeoff', 'Stability against correctness: the better, the further to the upper '
               'left. The axes on the right show the methods on voxels alone, without geometry '
               "where it is far from all others; the dashed line is the truth's own flicker.",
               tradeoff(evaluation))
    for base in ('majority',):
        if evaluation['differences'].get(base, {}).get('all'):
            yield ('differences', f'Differences from {base} with their intervals; filled: the '
                   'interval leaves out zero.', differences(evaluation, base))
    if {'majority', 'persem'} <= set(evaluation['methods']):
        yield ('regions', 'What persem changes against majority where the map is difficult, with '
               'intervals. The number is the share of the pixels.', regions(evaluation))
    if evaluation['macro']['all']['sequences']:
        yield ('classes', 'Intersection over union by class, mean of the sequences where the '
               'class occurs.', classes(evaluation))


def tradeoff(evaluation: dict[str, Any]) -> Figure:
    """Draw flicker against mean IoU; methods on voxels once more, enlarged."""
    rows = {name: row for name, row in evaluation['macro']['all']['methods'].items()
            if row['miou'] is not None and row['flicker'] is not None}
    inside = {name: row for name, row in rows.items() if name not in ('raw2d', 'ema2d')}
    beyond = _heaped(inside)
    inside = {name: row for name, row in inside.items() if not (beyond and name == 'geometry')}
    views = [rows, inside] if 1 < len(inside) < len(rows) else [rows]
    figure = new_figure(4.7 * len(views), 3.9)
    for axes, shown, title in zip(figure.subplots(1, len(views), squeeze=False)[0], views,
                                  ('all methods', 'methods on voxels' + (
                                      ', without geometry' if beyond else ''))):
        for name, row in shown.items():
            color, marker = STYLES[name]
            axes.plot(row['flicker'], row['miou'], marker, color=color, label=name,
                      markersize=13 if marker == '*' else 7, markeredgecolor='white', zorder=3)
        axes.set(xlabel=WORDS['flicker'], ylabel=WORDS['miou'], title=title)
        axes.margins(0.12)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.yaxis.set_major_locator(MaxNLocator(6))
        floor = evaluation['macro']['all']['truth_flicker']
        if floor is not None and (shown is rows):
            axes.axvline(floor, color=SOFT, linestyle='--', linewidth=1)
            axes.annotate('truth', (floor, 0.02), xycoords=('data', 'axes fraction'),
                          xytext=(3, 0), textcoords='offset points', color=SOFT)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside right center', markerscale=0.8)
    return figure


def _heaped(rows: dict[str, dict[str, float]]) -> bool:
    """Return whether geometry is so far from all others that these would lie in a heap."""
    others = [row for name, row in rows.items() if name != 'geometry']
    if 'geometry' not in rows or len(others) < 2:
        return False
    for key in ('miou', 'flicker'):
        low, high = min(row[key] for row in others), max(row[key] for row in others)
        if not low - HEAP * (high - low) <= rows['geometry'][key] <= high + HEAP * (high - low):
            return True
    return False


def differences(evaluation: dict[str, Any], base: str) -> Figure:
    """Draw the gains of all methods over *base* as points with their intervals."""
    found = evaluation['differences'][base]['all']
    names = [name for name in found if name not in ('raw2d', 'ema2d')] or list(found)
    keys = [key for key in MEASURES if any(found[n][key]['value'] is not None for n in names)]
    figure = new_figure(1.2 + 2.9 * max(1, len(keys)), 0.8 + 0.3 * len(names))
    all_axes = figure.subplots(1, max(1, len(keys)), sharey=True, squeeze=False)[0]
    for axes, key in zip(all_axes, keys):
        axes.axvline(0, color=INK, linewidth=1)
        for y, name in enumerate(names):
            _point(axes, found[name][key], y, STYLES[name][0])
        arrow = 'more is better →' if BETTER[key] > 0 else '← less is better'
        axes.set(xlabel=f'{WORDS[key].split(",")[0]}, points ({arrow})')
        axes.set_yticks(range(len(names)), names)
        lighter(axes, 'y')
    all_axes[0].invert_yaxis()
    return figure


def regions(evaluation: dict[str, Any]) -> Figure:
    """Draw the gains of persem over majority by region."""
    found = evaluation['differences']['majority']
    keys = [key for key in MEASURES if found['all']['persem'][key]['value'] is not None]
    figure = new_figure(1.2 + 2.9 * max(1, len(keys)), 2.0)
    all_axes = figure.subplots(1, max(1, len(keys)), sharey=True, squeeze=False)[0]
    for axes, key in zip(all_axes, keys):
        axes.axvline(0, color=INK, linewidth=1)
        for y, place in enumerate(PLACES):
            _point(axes, found[place]['persem'][key], y, STYLES['persem'][0])
        axes.set(xlabel=f'{WORDS[key].split(",")[0]}, points')
        axes.set_yticks(range(len(PLACES)), [
            PLACE_NAMES[p] + ('' if evaluation['macro'][p]['share'] is None else
                              f' ({evaluation["macro"][p]["share"]:.0f} %)') for p in PLACES])
        lighter(axes, 'y')
    all_axes[0].invert_yaxis()
    return figure


def _point(axes: Axes, row: dict[str, float | None], y: int, color: str) -> None:
    """Draw a difference with its interval; hollow where the interval holds zero."""
    value, low, high = row['value'], row['low'], row['high']
    if value is None:
        return
    sure = False
    if low is not None and high is not None:
        sure = low > 0 or high < 0
        axes.plot([low, high], [y, y], color=color, linewidth=2)
    axes.plot(value, y, 'o', color=color, markersize=6,
              markerfacecolor=color if sure else 'white', zorder=3)


def classes(evaluation: dict[str, Any]) -> Figure:
    """Draw bars of IoU by class."""
    shown = [m for m in CLASSES_SHOWN if m in evaluation['methods']] or evaluation['methods'][:4]
    summaries = evaluation['sequences'].values()
    names = {c['id']: c['name'] for s in summaries for c in s['classes']}
    found = sorted({int(i) for s in summaries for i in s['methods'][shown[0]]['iou']})
    figure = new_figure(max(4.5, 1.5 + 0.75 * len(found)), 3.2)
    axes = figure.subplots()
    width = 0.8 / len(shown)
    for k, method in enumerate(shown):
        values = [mean(s['methods'][method]['iou'].get(str(i)) for s in summaries)
                  for i in found]
        axes.bar(np.arange(len(found)) + (k + 0.5) * width - 0.4,
                 [v or 0 for v in values], width * 0.92, color=STYLES[method][0], label=method)
    axes.set_xticks(range(len(found)), [names.get(i, f'class {i}') for i in found],
                    rotation=35 if len(found) > 5 else 0,
                    ha='right' if len(found) > 5 else 'center')
    axes.set(ylabel='IoU, %')
    lighter(axes, 'x')
    figure.legend(loc='outside upper right', ncols=len(shown))
    return figure
