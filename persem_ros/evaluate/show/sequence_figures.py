"""The figures of one sequence: panels, flicker over time, confusion, the map from above."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

import cv2
from matplotlib.patches import Patch
import numpy as np
from numpy.typing import NDArray
from persem_ros.evaluate.show.style import new_figure, SOFT, STYLES, WORDS
from persem_ros.frames import UNKNOWN
from persem_ros.outputs.map.cloud import SOURCES
from persem_ros.outputs.report.colors import SOURCE_COLORS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from persem_ros.settings.legend import Legend

LINES = ('raw2d', 'ema2d', 'majority', 'persem', 'geometry')
MATRICES = ('raw2d', 'majority', 'persem', 'geometry')
SMOOTH = 0.04           # of the sequence: window of the running mean of flicker
PALE = (222, 226, 230)  # what the majority decided
CELLS = 144             # confusion matrices with more are drawn without numbers


def figures(name: str, summary: dict[str, Any], arrays: dict[str, NDArray[Any]],
            legend: Legend) -> Iterator[tuple[str, str, Figure]]:
    """Yield (name, caption, figure) of one sequence; legend: names and colours of ids."""
    if any(key.startswith('panel/') for key in arrays):
        yield (f'panels-{name}', 'Of each part of the flight a frame in which the methods differ '
               'much. Black: no label; methods on voxels are measured and shown without what a '
               "published image has there, the input's label (render.fill).",
               panels(arrays, legend))
    if len(arrays['frame/stamp']) > 2:
        yield (f'flicker-{name}', 'Pixels that change from one frame to the next, running mean.',
               flicker(summary, arrays))
    if summary['has_truth']:
        yield (f'confusion-{name}', 'Where the pixels of each true class (row) went, percent.',
               confusion(summary, arrays))
    if 'top/label' in arrays:
        yield (f'map-{name}', f'The map of {summary["map_method"]} from above, top-most voxels; '
               'what the refinement changed is drawn larger than it is.',
               top(arrays, legend, summary['map_method']))


def panels(arrays: dict[str, NDArray[Any]], legend: Legend) -> Figure:
    """Draw the chosen frames: one a row, what they show in columns."""
    frames = sorted({int(k.split('/')[1]) for k in arrays if k.startswith('panel/')})
    columns = [what for what in ('color', 'truth', *STYLES)
               if any(f'panel/{f}/{what}' in arrays for f in frames)]
    shape = arrays[f'panel/{frames[0]}/{columns[-1]}'].shape
    figure = new_figure(2.1 * len(columns), (2.1 * shape[0] / shape[1] + 0.08) * len(frames) + 0.6)
    all_axes = figure.subplots(len(frames), len(columns), squeeze=False)
    seen: set[int] = set()
    for row, frame in zip(all_axes, frames):
        for axes, what in zip(row, columns):
            axes.set_xticks([])
            axes.set_yticks([])
            axes.spines[:].set_visible(False)
            image = arrays.get(f'panel/{frame}/{what}')
            if frame == frames[0]:
                axes.set_title(what, loc='center')
            if image is None:
                continue
            if what != 'color':
                seen |= set(np.unique(image).tolist())
                image = painted(image, legend)
            axes.imshow(image, interpolation='nearest')
        row[0].set_ylabel(f'frame {frame + 1}')
    _key(figure, seen, legend)
    return figure


def flicker(summary: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Figure:
    """Draw flicker over time, with the truth's."""
    names = [*summary['methods_order'], 'truth']
    seconds = (arrays['frame/stamp'] - arrays['frame/stamp'][0]) / 1e9
    changed, pairs = arrays['frame/changed'], arrays['frame/compared']
    window = np.ones(max(1, int(SMOOTH * len(seconds))))
    figure = new_figure(7.5, 2.7)
    axes = figure.subplots()
    for k, name in enumerate(names):
        if name not in (*LINES, 'truth') or not pairs[:, k].any():
            continue
        total = np.convolve(pairs[:, k], window, 'same')
        with np.errstate(divide='ignore', invalid='ignore'):
            share = 100 * np.convolve(changed[:, k], window, 'same') / total
        color, style = (SOFT, '--') if name == 'truth' else (STYLES[name][0], '-')
        axes.plot(seconds, share, style, color=color, label=name,
                  linewidth=3 if name == 'majority' else 1.4)
    axes.set(xlabel='time, s', ylabel=WORDS['flicker'])
    axes.set_ylim(bottom=0)
    axes.margins(x=0.01)
    figure.legend(loc='outside upper right', ncols=6)
    return figure


def confusion(summary: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Figure:
    """Draw confusion matrices, each row in percent of its true class."""
    shown = [m for m in MATRICES if m in summary['methods_order']] or summary['methods_order'][:3]
    names = ['no label'] + [c['name'] for c in summary['classes']]
    matrices = arrays['matrix'][[summary['methods_order'].index(m) for m in shown]]
    rows = np.flatnonzero(matrices[0].sum(1))
    columns = np.flatnonzero(matrices.sum((0, 1)))
    columns = np.concatenate([rows, np.setdiff1d(columns, rows)])
    size = 0.5 * max(4, len(columns))
    figure = new_figure(size * len(shown) + 1.6, 0.5 * max(3, len(rows)) + 1.6)
    for axes, method, matrix in zip(figure.subplots(1, len(shown), sharey=True, squeeze=False)[0],
                                    shown, matrices):
        share = 100 * matrix[np.ix_(rows, columns)] / matrix[rows].sum(1)[:, None]
        axes.imshow(share, cmap='viridis', vmin=0, vmax=100)
        axes.grid(False)
        axes.set_title(method)
        axes.set_xticks(range(len(columns)), [names[c] for c in columns], rotation=60, ha='right')
        axes.set_yticks(range(len(rows)), [names[c] for c in rows])
        if share.size <= CELLS:
            for (y, x), value in np.ndenumerate(share):
                axes.text(x, y, f'{value:.0f}' if value >= 0.5 else '', ha='center',
                          va='center', fontsize=8, color='black' if value > 60 else 'white')
    return figure


def top(arrays: dict[str, NDArray[Any]], legend: Legend, method: str) -> Figure:
    """Draw the map of a method from above by label, source, entropy and switch rate."""
    label, extent = arrays['top/label'], arrays['top/extent']
    known = label != UNKNOWN
    height = 3.6 * np.clip(label.shape[0] / label.shape[1], 0.4, 1.6)
    figure = new_figure(9.0, 2 * height + 1.0)
    axes = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    colors = np.array([PALE, *SOURCE_COLORS[1:]], np.uint8)
    source = colors[cv2.dilate(arrays['top/source'], np.ones((3, 3), np.uint8))]
    views = [(f'label by {method}', np.where(known[..., None], painted(label, legend), 255)),
             (f'what decided, by {method}', np.where(known[..., None], source, 255))]
    for a, (title, image) in zip(axes, views):
        a.imshow(image, extent=extent, interpolation='nearest')
        a.set_title(title)
    for a, (key, title) in zip(axes[2:], (('entropy', 'entropy of the evidence, nat'),
                                          ('switch_rate', 'switch rate'))):
        drawn = a.imshow(np.where(known, arrays[f'top/{key}'], np.nan), extent=extent,
                         interpolation='nearest', cmap='viridis')
        a.set_title(title)
        figure.colorbar(drawn, ax=a, location='bottom', shrink=0.6)
    for a in axes:
        a.grid(False)
        a.set_aspect('equal')
        a.set_xlabel('x, m' if a in axes[2:] else '')
        a.set_ylabel('y, m' if a in axes[::2] else '')
    axes[1].legend(handles=[Patch(color=tuple(c / 255), label=name) for name, c in zip(
        SOURCES, colors)], fontsize=7, loc='upper left', bbox_to_anchor=(1.01, 1))
    _key(figure, np.unique(label[known]).tolist(), legend)
    return figure


def painted(image: NDArray[np.uint16], legend: Legend) -> NDArray[np.uint8]:
    """Return an image of ids in the legend's colours, (h, w, 3) uint8."""
    return legend.colors(np.asarray(image, np.uint16))


def _key(figure: Figure, ids: list[int] | set[int], legend: Legend) -> None:
    """Draw the legend of class colours below a figure."""
    found = {legend.name(i): legend.color(i) for i in sorted(ids) if i != UNKNOWN}
    handles = [Patch(color=(r / 255, g / 255, b / 255), label=name)
               for name, (r, g, b) in found.items()]
    if handles:
        figure.legend(handles=handles, loc='outside lower center', fontsize=8,
                      ncols=min(len(handles), 8))
