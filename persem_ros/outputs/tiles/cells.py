"""What a tile shows: the voxels of a cube, or one voxel for each of its cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.settings.legend import Legend

EDGE = 64               # cells along a tile's edge
GONE = 64               # flag beside the bits of the open sides
STEPS = 16              # of the scale of observations, a doubling
# One point, as it lies in a .glb: every field at a multiple of four bytes.
POINT = np.dtype([('at', 'u1', 4), ('color', 'u1', 4), ('label', '<u2'), ('', '<u2'),
                  ('confidence', 'u1'), ('seen', 'u1'), ('source', 'u1'), ('sides', 'u1'),
                  ('last', '<f4')])


def seen_most(columns: Columns, cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """
    Return the rows that stand for their cells, in the order of cells.

    Of the voxels in a cell it is the one that was seen most often, those that are not gone first;
    of several the first. A coarse cell so shows what some voxel has, never a mean of several.

    Parameters
    ----------
    columns : dict
        Of n voxels: observations, gone.
    cell : ndarray, shape (n,), int64
        A number for each voxel's cell.

    """
    rank = columns['observations'].astype(np.int64)
    rank[columns['gone'] != 0] -= 1 << 33
    order = np.lexsort((-rank, cell))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(cell[order]) != 0
    return order[first]


def points_of(at: NDArray[np.int64], columns: Columns, beside: NDArray[np.int64],
              legend: Legend, start: int) -> NDArray[np.void]:
    """
    Return the points of a tile, without those that no one can see.

    A cell whose six neighbours are all there is hidden.

    Parameters
    ----------
    at : ndarray, shape (n, 3)
        Cells, 0 … EDGE - 1, each once.
    columns : dict
        label, confidence, observations, source, gone, last_stamp of n voxels.
    beside : ndarray, shape (m, 3)
        Cells around the tile that are there, with coordinates -1 … EDGE.
    legend : Legend
        Gives the colours.
    start : int
        Nanoseconds from which time is counted.

    Returns
    -------
    ndarray, shape (m,), POINT
        color is linear, as glTF has it; seen is 16 log2(observations); sides has the open ones
        (bits of -x +x -y +y -z +z) and GONE; last is in seconds.

    """
    sides = open_sides(at, np.concatenate([at[columns['gone'] == 0], beside]))
    visible = sides > 0
    points = np.zeros(int(visible.sum()), POINT)
    points['at'][:, :3] = at[visible]
    chosen = {name: columns[name][visible] for name in (
        'label', 'confidence', 'observations', 'source', 'gone', 'last_stamp')}
    points['color'][:, :3] = linear(legend.colors(chosen['label']))
    points['color'][:, 3] = 255
    points['label'], points['source'] = chosen['label'], chosen['source']
    points['confidence'] = np.rint(255 * chosen['confidence'].clip(0, 1))
    points['seen'] = np.rint(STEPS * np.log2(chosen['observations'].clip(1))).clip(max=255)
    points['sides'] = sides[visible] | np.where(chosen['gone'] != 0, GONE, 0).astype(np.uint8)
    points['last'] = (chosen['last_stamp'] - start) / 1e9
    return points


def open_sides(at: NDArray[np.int64], solid: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return (n,) uint8: bits of the sides -x +x -y +y -z +z that no solid cell covers."""
    there = np.zeros((EDGE + 2,) * 3, bool)
    there[tuple((solid + 1).T)] = True
    x, y, z = (at + 1).T
    result = np.zeros(len(at), np.uint8)
    for bit in range(6):
        step = np.zeros(3, np.int64)
        step[bit // 2] = 1 if bit & 1 else -1
        covered = there[x + step[0], y + step[1], z + step[2]]
        result |= (~covered).astype(np.uint8) << np.uint8(bit)
    return result


def linear(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return sRGB colours as linear ones."""
    share = np.arange(256) / 255
    table = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255 * table).astype(np.uint8)[rgb]
