"""The map as points: one per voxel, as in ~/map and map.ply (spec section 8)."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from persem_ros.settings.legend import Legend

POINT = np.dtype({
    'names': ['x', 'y', 'z', 'rgb', 'label', 'majority', 'confidence', 'observations', 'source'],
    'formats': ['<f4', '<f4', '<f4', '<f4', '<u2', '<u2', '<f4', '<u4', 'u1'],
    'offsets': [0, 4, 8, 12, 16, 18, 20, 24, 28],
    'itemsize': 32})
SOURCES = ('majority', 'history', 'trust', 'context', 'geometry')
COPIED = ('label', 'majority', 'confidence', 'observations', 'source')


def map_points(columns: dict[str, Any], voxel_size: float, legend: Legend) -> NDArray[np.void]:
    """
    Return the map's points.

    Parameters
    ----------
    columns : mapping
        voxel (n, 3) int32, label and majority (n,) uint16, confidence (n,) float32,
        observations (n,) uint32, source (n,) uint8: VoxelMemory.voxels().
    voxel_size : float
        Metres.
    legend : persem_ros.settings.legend.Legend
        Gives each label its colour.

    Returns
    -------
    ndarray, shape (n,), POINT
        In the order of the columns. x y z are the voxels' centres in metres in the map frame,
        map.origin taken off: that keeps large coordinates exact in float32.

    """
    points = np.zeros(len(columns['voxel']), POINT)
    centres = (columns['voxel'] + 0.5) * voxel_size
    for axis, name in enumerate('xyz'):
        points[name] = centres[:, axis]
    for name in COPIED:
        points[name] = columns[name]
    rgb = legend.colors(columns['label']).astype(np.uint32)
    points['rgb'] = (rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]).view(np.float32)
    return points


def colors_of(points: NDArray[np.void]) -> NDArray[np.uint8]:
    """Return red, green, blue of points as (n, 3) uint8."""
    packed = np.ascontiguousarray(points['rgb']).view(np.uint32)
    return np.stack([packed >> 16, packed >> 8, packed], axis=1).astype(np.uint8)
