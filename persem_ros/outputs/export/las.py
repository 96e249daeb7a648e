"""The map as LAS or LAZ 1.4: a point a voxel, ASPRS classes, our columns as extra bytes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.outputs.export.libraries import needed
from persem_ros.outputs.export.place import place_of, projected
from persem_ros.outputs.files import replacing

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.outputs.export.source import MapSource
    from persem_ros.settings.legend import Legend

UNCLASSIFIED = 1            # the ASPRS code of what has no other
OWN_CODES = 64              # from here on codes are the file's own, and get names
# Extra bytes: name, type, description (32 characters at most).
EXTRA = (('label', 'u2', 'class id'), ('majority', 'u2', 'class id most often seen'),
         ('confidence', 'f4', 'of the class, 0 to 1'),
         ('observations', 'u4', 'frames that saw the voxel'),
         ('source', 'u1', 'what decided'))


def write_las(path: Path | str, source: MapSource, choice: Choice) -> tuple[int, list[int]]:
    """
    Write the chosen voxels' centres, compressed where the name ends in .laz.

    Parameters
    ----------
    path : str or Path
        .laz or .las.
    source : MapSource
        The map.
    choice : Choice
        Which of its voxels.

    Returns
    -------
    n : int
        Number of points.
    without : list of int
        Labels without a code in the legend: they are 1, unclassified.

    Raises
    ------
    PersemError
        Where laspy or lazrs is missing, map.crs does not exist, or the map is too wide for
        32 bits.

    """
    laspy = needed('laspy', 'a LAS file')
    if str(path).lower().endswith('.laz'):
        needed('lazrs', 'a LAZ file')
    place = place_of(source)
    crs = projected(place.crs) if place.crs else None
    found = source.summary_of_something(choice)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    extent = place.placed(source.centres(np.array(np.where(corners, found.high, found.low))))
    header = laspy.LasHeader(point_format=7, version='1.4')
    header.scales = np.full(3, _scale(source.voxel_size))
    header.offsets = np.floor(extent.min(axis=0))
    if (np.ptp(extent, axis=0) / header.scales >= 2 ** 31 - 1).any():
        raise PersemError(f'{source.path}: the map is too wide for a LAS file '
                          f'({np.ptp(extent, axis=0).max():.0f} m in steps of '
                          f'{header.scales[0]:g} m); choose a part with --crop')
    header.system_identifier, header.generating_software = 'persem_ros', 'persem map export'
    for name, kind, text in EXTRA:
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind, text))
    if crs is not None:
        header.add_crs(crs)
    else:
        header.global_encoding.wkt = True       # LAS 1.4 asks for it with formats 6 and above
    code = _codes(source.legend)
    _name_codes(laspy, header, source.legend)
    with replacing(path) as work:
        with open(work, 'wb') as file, \
                laspy.open(file, mode='w', header=header, closefd=False,
                           do_compress=str(path).lower().endswith('.laz')) as writer, \
                source.shown(choice, 'las') as chunks:
            for columns in chunks:
                if len(columns['voxel']):
                    writer.write_points(_points(laspy, header, source, columns, code))
    known = source.legend.numbers('las')
    return found.voxels, [c for c in sorted(found.labels) if c not in known]


def _points(laspy: Any, header: Any, source: MapSource, columns: Columns,
            code: NDArray[np.uint8]) -> Any:
    """Return some voxels as a laspy record."""
    points = laspy.ScaleAwarePointRecord.zeros(len(columns['voxel']), header=header)
    points.x, points.y, points.z = place_of(source).placed(source.centres(columns['voxel'])).T
    points.classification = code[columns['label']]
    points.return_number[:] = points.number_of_returns[:] = 1
    points.intensity = np.round(65535 * columns['confidence']).astype(np.uint16)
    points.gps_time = columns['last_stamp'] / 1e9
    rgb = source.legend.colors(columns['label']).astype(np.uint16) * 257
    points.red, points.green, points.blue = rgb.T
    for name, _, _ in EXTRA:
        points[name] = columns[name]
    return points


def _scale(voxel_size: float) -> float:
    """Return the step of coordinates: a millimetre, less where half a voxel needs it."""
    return min(1e-3, 10.0 ** (math.floor(math.log10(voxel_size / 2)) - 1))


def _codes(legend: Legend) -> NDArray[np.uint8]:
    """Return each id's code, shape (65536,)."""
    codes = np.full(65536, UNCLASSIFIED, np.uint8)
    for label, code in legend.numbers('las').items():
        codes[label] = code
    return codes


def _name_codes(laspy: Any, header: Any, legend: Legend) -> None:
    """Name the file's own codes, 15 bytes each."""
    lookup = laspy.vlrs.known.ClassificationLookupVlr()
    for label, code in legend.numbers('las').items():
        if code >= OWN_CODES:
            lookup[code] = legend.name(label).encode('ascii', 'replace')[:15].decode()
    if len(lookup.lookups):
        header.vlrs.append(lookup)
