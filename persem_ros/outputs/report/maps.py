"""The map from above: the top-most voxel of every column, as pictures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.report.colors import ramp, SOURCE_COLORS

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.legend import Legend

CELLS = 1000        # the longer side of a picture, at most
OUTSIDE = 0.001     # share of the columns that may be cut off at each edge


def top_view(columns: dict[str, Any], voxel_size: float, legend: Legend) -> dict[str, Any]:
    """
    Return the map from above: x to the right, y up.

    Parameters
    ----------
    columns : dict
        VoxelMemory.voxels(): sorted by voxel index.
    voxel_size : float
        Metres.
    legend : persem_ros.settings.legend.Legend
        Gives each label its colour.

    Returns
    -------
    dict
        layers: list of dict (key, title, pixels (h, w, 4) uint8 red green blue alpha, bar: what a
        colour bar shows, or None); x, y: the extent (low, high) in metres; width, height: in
        cells; cell: metres; scale: columns along a cell's edge; left_out: number of columns
        beyond the edges.

    """
    another = np.any(np.diff(columns['voxel'][:, :2], axis=0) != 0, axis=1)
    top = np.flatnonzero(np.append(another, True))      # sorted: the last of a column
    at = columns['voxel'][top].astype(np.int64)
    low, high = _edges(at[:, :2])
    inside = np.all((at[:, :2] >= low) & (at[:, :2] <= high), axis=1)
    top, at = top[inside], at[inside]
    scale = int(-(-(high - low + 1).max() // CELLS))
    cell = (at[:, :2] - low) // scale
    shape = tuple((high - low) // scale + 1)
    order = np.argsort(at[:, 2], kind='stable')         # written last: the highest
    row = np.full(shape, -1, np.int64)
    row[cell[order, 0], cell[order, 1]] = order
    row = row.T[::-1]           # an image: y up, x to the right
    known, row = row >= 0, row.clip(0)
    found = {name: columns[name][top][row] for name in
             ('label', 'confidence', 'observations', 'source')}
    height = (at[:, 2][row] + 0.5) * voxel_size
    low_m = low * voxel_size
    high_m = low_m + np.array(shape) * scale * voxel_size
    return {'layers': list(_layers(found, height, known, legend, voxel_size * scale)),
            'x': (float(low_m[0]), float(high_m[0])), 'y': (float(low_m[1]), float(high_m[1])),
            'width': known.shape[1], 'height': known.shape[0], 'cell': voxel_size * scale,
            'left_out': int(np.count_nonzero(~inside)), 'scale': scale}


def tracks(memory: VoxelMemory, most: int = 2000) -> list[NDArray[np.float64]]:
    """Return the cameras' positions in the voxels' frame, metres, one (n, 3) array a sensor."""
    table = memory.frames
    which, first = np.unique(np.stack([table.session, table.sensor], axis=1), axis=0,
                             return_index=True)
    lines = [table.placed[(table.session == session) & (table.sensor == sensor), :3, 3]
             for session, sensor in which[np.argsort(first)]]
    return [(line - memory.origin)[::-(-len(line) // most)] for line in lines]


def on_top(track: NDArray[np.float64], top: dict[str, Any]) -> NDArray[np.float64]:
    """Return where a track (n, 3) lies in a top_view: (n, 2) shares of width and height."""
    (x0, x1), (y0, y1) = top['x'], top['y']
    return np.stack([(track[:, 0] - x0) / (x1 - x0), (y1 - track[:, 1]) / (y1 - y0)], axis=1)


def _edges(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the low and high corner that leave a few stray columns outside."""
    low, high = cells.min(axis=0), cells.max(axis=0)
    near = np.quantile(cells, [OUTSIDE, 1 - OUTSIDE], axis=0, method='nearest').astype(np.int64)
    stray = (high - low + 1) > 1.25 * (near[1] - near[0] + 1)   # few columns, much empty space
    return np.where(stray, near[0], low), np.where(stray, near[1], high)


def _layers(found: dict[str, Any], height: NDArray[np.float64], known: NDArray[np.bool_],
            legend: Legend, cell: float) -> Iterator[dict[str, Any]]:
    """Yield each layer's picture with its colour bar."""
    shade = relief(height, known, cell)[..., None]
    colors = (legend.colors(found['label']) * shade).clip(0, 255)
    yield _layer('class', 'class', colors, known, None)
    confidence = found['confidence']
    yield _layer('confidence', 'confidence', ramp()[(255 * confidence).astype(int)], known,
                 bar('share of the evidence for the label', 0.0, 1.0))
    seen = found['observations']
    most = max(2, int(seen[known].max()))
    steps = (255 * np.log(seen.clip(1)) / np.log(most)).astype(int)
    yield _layer('observations', 'observations', ramp()[steps], known,
                 bar('observations of the voxel (logarithmic)', 1, most, log=True))
    yield _layer('source', 'source', np.array(SOURCE_COLORS)[found['source']], known, None)
    low, high = np.quantile(height[known], [0.005, 0.995])
    steps = (255 * ((height - low) / max(high - low, 1e-9)).clip(0, 1)).astype(int)
    yield _layer('height', 'height', ramp()[steps], known,
                 bar('z in the map frame, m', float(low), float(high)))


def relief(
        height: NDArray[np.float64], known: NDArray[np.bool_], cell: float) -> NDArray[np.float64]:
    """Return a factor of brightness, (h, w) float: light falls from the upper left."""
    flat = np.where(known, height, np.nan)
    slope = np.zeros(height.shape)
    for axis in (0, 1):
        step = np.diff(flat, axis=axis, prepend=np.nan)
        slope -= np.nan_to_num(step)
    return 1.0 + 0.16 * np.tanh(-0.7 * slope / cell)


def bar(
        text: str, low: float, high: float, log: bool = False
) -> dict[str, list[tuple[float, str]] | str]:
    """Return what a colour bar shows: its text and five (place in percent, number) ticks."""
    places = np.linspace(0, 1, 5)
    values = low * (high / low) ** places if log else low + (high - low) * places
    return {'text': text, 'ticks': [(100 * p, f'{v:.0f}' if log else f'{v:.3g}')
                                    for p, v in zip(places, values)]}


def scale_bar(extent: float) -> float:
    """Return the metres of a scale bar that fills about a fifth of *extent* metres."""
    power = 10.0 ** np.floor(np.log10(extent / 4))
    return float(max(step * power for step in (1, 2, 5) if step * power <= extent / 4))


def _layer(key: str, title: str, rgb: NDArray[Any], known: NDArray[np.bool_],
           bar: dict[str, list[tuple[float, str]] | str] | None) -> dict[str, Any]:
    alpha = np.where(known, 255, 0)
    rgba = np.concatenate([np.where(known[..., None], rgb, 0), alpha[..., None]], axis=2)
    return {'key': key, 'title': title, 'bar': bar, 'pixels': rgba.astype(np.uint8)}
