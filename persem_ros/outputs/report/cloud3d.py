"""The map for the 3-D view: few bytes a voxel, packed for the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any, TYPE_CHECKING
import zlib

import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.report.colors import ramp, SOURCE_COLORS

if TYPE_CHECKING:
    from persem_ros.settings.legend import Legend

VOXELS = 400_000    # more are too many for a telephone
SPAN = 65_535       # cells along an axis that uint16 can count


def packed(
        columns: dict[str, Any], voxel_size: float, legend: Legend, track: Sequence[Any] = ()
) -> dict[str, Any]:
    """
    Return what the page's viewer reads.

    Voxels whose six neighbours are all known cannot be seen and are left out. Where too many are
    left, 2 x 2 x 2 (then 4 x 4 x 4 ...) are shown as one: the one that was seen most often.

    Parameters
    ----------
    columns : dict
        VoxelMemory.voxels().
    voxel_size : float
        Metres.
    legend : persem_ros.settings.legend.Legend
        Gives each label its colour.
    track : sequence of ndarray, shape (n, 3)
        Camera positions in metres in the voxels' frame, a line each.

    Returns
    -------
    dict
        JSON-ready: shown, voxels (numbers of each), merged (edge in voxels of what is shown),
        size (its edge, metres), low (metres of the first cell's corner), span (cells), classes,
        colours and data: base64 of zlib of the columns one after the other.

    """
    voxel, row = columns['voxel'].astype(np.int64), np.arange(len(columns['voxel']))
    exposed = _exposed(voxel)
    visible = exposed > 0
    voxel, row, exposed, merged = voxel[visible], row[visible], exposed[visible], 1
    while len(row) > VOXELS or np.ptp(voxel, axis=0).max() > SPAN:
        voxel, row, merged = *_halved(voxel, row, columns['observations']), 2 * merged
        exposed = _exposed(voxel)
    low = voxel.min(axis=0)
    labels, label = np.unique(columns['label'][row], return_inverse=True)
    seen, most = columns['observations'][row], max(2, int(columns['observations'].max()))
    data = (*(voxel - low).astype(np.uint16).T, label.astype(np.uint16),
            (255 * columns['confidence'][row]).round().astype(np.uint8),
            (255 * np.log(seen.clip(1)) / np.log(most)).astype(np.uint8),
            columns['source'][row], exposed)
    size = voxel_size * merged
    heights = np.quantile(voxel[:, 2], [0.005, 0.995])
    return {
        'shown': len(row), 'voxels': len(columns['voxel']), 'hidden': int((~visible).sum()),
        'merged': merged, 'size': size, 'low': (low * size).tolist(),
        'span': (np.ptp(voxel, axis=0) + 1).tolist(), 'most': most,
        'heights': [float((heights[0] - low[2])), float((heights[1] - low[2]))],
        'classes': [{'id': int(i), 'name': legend.name(i), 'color': legend.color(i),
                     'voxels': int(n)}
                    for i, n in zip(labels, np.bincount(label.ravel()))],
        'sources': SOURCE_COLORS, 'ramp': ramp()[::5].tolist(),
        'track': [np.round(_thinned(line) / size - low, 3).ravel().tolist() for line in track],
        'data': base64.b64encode(zlib.compress(b''.join(
            np.ascontiguousarray(a).tobytes() for a in data), 7)).decode()}


def _exposed(voxel: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return (n,) uint8: bits of the sides -x +x -y +y -z +z that no known voxel covers."""
    span = np.ptp(voxel, axis=0) + 3
    steps = np.array([span[1] * span[2], span[2], 1])
    key = (voxel - voxel.min(axis=0) + 1) @ steps       # sorted, as the voxels are
    result = np.zeros(len(key), np.uint8)
    for bit in range(6):
        wanted = key + steps[bit // 2] * (1 if bit & 1 else -1)
        place = np.searchsorted(key, wanted).clip(max=len(key) - 1)
        result |= (key[place] != wanted).astype(np.uint8) << bit
    return result


def _halved(
        voxel: NDArray[np.int64], row: NDArray[np.int64], observations: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (voxel, row) with one row for 2 x 2 x 2 voxels, sorted: the most observed one."""
    voxel = voxel >> 1
    order = np.lexsort((observations[row], voxel[:, 2], voxel[:, 1], voxel[:, 0]))
    voxel, row = voxel[order], row[order]
    last = np.append(np.any(np.diff(voxel, axis=0) != 0, axis=1), True)
    return voxel[last], row[last]


def _thinned(line: NDArray[np.float64], most: int = 2000) -> NDArray[np.float64]:
    """Return at most about *most* rows of a line."""
    return line[::-(-len(line) // most)]
