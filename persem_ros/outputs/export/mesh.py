"""The map as a mesh of coloured cubes: .ply of any size, .glb of what viewers can hold."""

from __future__ import annotations

from pathlib import Path
import shutil
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.outputs.export.faces import outer_faces
from persem_ros.outputs.export.libraries import needed
from persem_ros.outputs.files import replacing, write_bytes
from persem_ros.outputs.map.ply import map_comments

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.source import MapSource

MOST_GLB = 20_000_000       # faces: a .glb is held in memory while it is written, and cannot
#                             count more than 4 GB; viewers give up earlier
VERTEX = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
                   ('red', 'u1'), ('green', 'u1'), ('blue', 'u1'), ('label', '<i4')])
FACE = np.dtype([('n', 'u1'), ('corners', '<u4', 4)])


def write_mesh(path: Path | str, source: MapSource, choice: Choice) -> int:
    """
    Write the outer faces of the chosen voxels, each in the colour of its label.

    Coordinates are metres in the map frame, map.origin taken off, as in map.ply. A .glb has y up
    and its faces as triangles, as the format asks for; a .ply has quadrilaterals.

    Returns
    -------
    int
        Number of faces.

    Raises
    ------
    PersemError
        For another suffix, a choice of nothing, and a .glb of more faces than it can hold.

    """
    suffix = Path(path).suffix.lower()
    if suffix not in ('.ply', '.glb'):
        raise PersemError(f'--mesh {path}: expected a name that ends in .ply or .glb')
    source.summary_of_something(choice)
    return (_write_ply if suffix == '.ply' else _write_glb)(Path(path), source, choice)


def _write_ply(path: Path, source: MapSource, choice: Choice) -> int:
    """Write a binary PLY: vertices and faces grow in two files, which are joined at the end."""
    n = 0
    with replacing(path) as work, \
            TemporaryDirectory(dir=work.parent, prefix=f'{work.name}.') as folder:
        first, second = Path(folder) / 'vertices', Path(folder) / 'faces'
        with open(first, 'wb') as vertices, open(second, 'wb') as faces:
            for corners, labels in outer_faces(source, choice, 'mesh'):
                points = np.empty((len(labels), 4), VERTEX)
                for axis, name in enumerate('xyz'):
                    points[name] = corners[..., axis] * source.voxel_size
                rgb = source.legend.colors(labels)
                for k, name in enumerate(('red', 'green', 'blue')):
                    points[name] = rgb[:, k, None]
                points['label'] = labels[:, None]
                quads = np.empty(len(labels), FACE)
                quads['n'] = 4
                quads['corners'] = 4 * n + np.arange(4 * len(labels)).reshape(-1, 4)
                vertices.write(points.tobytes())
                faces.write(quads.tobytes())
                n += len(labels)
                if 4 * n >= 1 << 32:
                    raise PersemError(f'{source.path}: more faces than a mesh can count; choose '
                                      'a part with --crop')
        with open(work, 'wb') as out:
            out.write(_header(source, n))
            for part in (first, second):
                with open(part, 'rb') as data:
                    shutil.copyfileobj(data, out, 1 << 20)
    return n


def _header(source: MapSource, faces: int) -> bytes:
    """Return the header of a PLY mesh."""
    comments = map_comments(source.map_frame, tuple(source.origin), source.voxel_size)
    return '\n'.join([
        'ply', 'format binary_little_endian 1.0',
        *(f'comment {" ".join(text.split())}' for text in comments),
        f'element vertex {4 * faces}', 'property float x', 'property float y', 'property float z',
        'property uchar red', 'property uchar green', 'property uchar blue', 'property int label',
        f'element face {faces}', 'property list uchar uint vertex_indices', 'end_header', '',
    ]).encode('ascii', 'replace')


def _write_glb(path: Path, source: MapSource, choice: Choice) -> int:
    """Write a binary glTF through trimesh."""
    trimesh = needed('trimesh', 'a .glb')
    parts = []
    n = 0
    for corners, labels in outer_faces(source, choice, 'mesh'):
        parts.append((corners.astype(np.int32), labels))
        n += len(labels)
        if n > MOST_GLB:
            raise PersemError(f'{source.path}: more than {MOST_GLB} faces are too many for a '
                              '.glb; choose a part with --crop, or write a .ply')
    corners, labels = (np.concatenate(column) for column in zip(*parts))
    points = (corners.reshape(-1, 3) * source.voxel_size).astype(np.float32)
    colors = np.repeat(np.concatenate([source.legend.colors(labels), np.full(
        (n, 1), 255, np.uint8)], axis=1), 4, axis=0)
    quads = np.arange(4 * n, dtype=np.int64).reshape(-1, 4)
    mesh = trimesh.Trimesh(points[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32),
                           np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
                           vertex_colors=colors, process=False)
    write_bytes(path, trimesh.Scene({'map': mesh}).export(file_type='glb'))
    return n
