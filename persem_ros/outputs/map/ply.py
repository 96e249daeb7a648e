"""Map points as a binary little-endian PLY file (spec section 8)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.files import replacing
from persem_ros.outputs.map.cloud import colors_of, COPIED

if TYPE_CHECKING:
    from pathlib import Path

PROPERTIES = (
    ('x', 'float', '<f4'), ('y', 'float', '<f4'), ('z', 'float', '<f4'),
    ('red', 'uchar', 'u1'), ('green', 'uchar', 'u1'), ('blue', 'uchar', 'u1'),
    # int: Open3D's tensor reader skips ushort and uint with no more than a warning.
    ('label', 'int', '<i4'), ('majority', 'int', '<i4'), ('confidence', 'float', '<f4'),
    ('observations', 'int', '<i4'), ('source', 'uchar', 'u1'))
VERTEX = np.dtype([(name, code) for name, _, code in PROPERTIES])


def write_ply(path: Path | str, points: NDArray[np.void], comments: Sequence[str] = ()) -> None:
    """
    Write map points, whole or not at all.

    Parameters
    ----------
    path : str or Path
        The file.
    points : ndarray, shape (n,), persem_ros.outputs.map.cloud.POINT
        The points.
    comments : sequence of str
        Lines for the header; map_comments gives the usual ones.

    Raises
    ------
    PersemError
        When the file cannot be written.

    """
    write_ply_parts(path, len(points), [points], comments)


def write_ply_parts(path: Path | str, n: int, parts: Iterable[NDArray[np.void]],
                    comments: Sequence[str] = ()) -> None:
    """Write n map points that come in parts, as write_ply does with all of them."""
    lines = ['ply', 'format binary_little_endian 1.0',
             *(f'comment {" ".join(text.split())}' for text in comments),
             f'element vertex {n}',
             *(f'property {kind} {name}' for name, kind, _ in PROPERTIES), 'end_header', '']
    with replacing(path) as work:
        with open(work, 'wb') as out:
            out.write('\n'.join(lines).encode('ascii', 'replace'))
            for points in parts:
                out.write(_vertices(points).data.cast('B'))


def _vertices(points: NDArray[np.void]) -> NDArray[np.void]:
    """Return map points as they lie in the file."""
    vertices = np.empty(len(points), VERTEX)
    for name in ('x', 'y', 'z', *COPIED):
        vertices[name] = points[name]
    vertices['observations'] = np.minimum(points['observations'], np.iinfo(np.int32).max)
    vertices['red'], vertices['green'], vertices['blue'] = colors_of(points).T
    return vertices


def map_comments(
        map_frame: str, origin: tuple[float, float, float], voxel_size: float) -> list[str]:
    """Return header lines that say where the points lie: frame, origin and voxel size."""
    return [f'made by persem_ros; coordinates in metres in the frame {map_frame}',
            f'origin {" ".join(repr(float(x)) for x in origin)} (to be added to x y z)',
            f'voxel_size {float(voxel_size)!r}']
