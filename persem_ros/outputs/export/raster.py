"""The map from above as GeoTIFFs: the top-most class, and its height, confidence, observations."""

from __future__ import annotations

from contextlib import ExitStack
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING
import warnings
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError
from persem_ros.outputs.export.libraries import needed
from persem_ros.outputs.export.place import place_of, projected
from persem_ros.outputs.files import replacing, write_text
from persem_ros.outputs.grid.cells import MOST_CELLS

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.outputs.export.place import Place
    from persem_ros.outputs.export.source import MapSource
    from persem_ros.settings.legend import Legend

TILE = 256                  # pixels along a tile's edge
BANDS = ('height (m)', 'confidence', 'observations')
MOST_OF_A_SLAB = 150_000_000    # pixels of 14 bytes: 2 GB


def write_geotiff(path: Path | str, source: MapSource, choice: Choice) -> tuple[int, int]:
    """
    Write the top-most chosen voxel of each column; return the raster's width and height.

    NAME.tif has the class with colours; names are in NAME.tif.aux.xml, as GDAL keeps them, and
    in NAME.qml, the style that QGIS takes up. NAME.values.tif has the bands of BANDS, float32,
    NaN where there is nothing.

    Raises
    ------
    PersemError
        Where rasterio is missing, map.crs does not exist, or z does not point up.

    """
    rasterio = needed('rasterio', 'a GeoTIFF')
    place = place_of(source)
    crs = projected(place.crs).to_wkt() if place.crs else None
    if source.config.refine.up != 'z':
        raise PersemError(f'{source.path}: a view from above needs z to point up, in this map '
                          f'{source.config.refine.up} does (refine.up)')
    found = source.summary_of_something(choice)
    # Blocks begin slabs: one that two slabs share would have to be read twice.
    low = np.array([found.low[0] // SIDE * SIDE, *found.low[1:]])
    width, height = (int(n) for n in (found.high - low + 1)[:2])
    if width * height > MOST_CELLS or min(TILE, width) * height > MOST_OF_A_SLAB:
        raise PersemError(f'{source.path}: a raster of {width} x {height} pixels is larger than '
                          f'{MOST_CELLS} pixels, or higher than {MOST_OF_A_SLAB // TILE}; choose '
                          'a part with --crop')
    small = max(found.labels) < 255
    nothing = 255 if small else 65535
    common = {'driver': 'GTiff', 'width': width, 'height': height, 'crs': crs,
              'transform': _transform(rasterio, source, place, low, found.high),
              'tiled': True, 'blockxsize': TILE, 'blockysize': TILE, 'compress': 'deflate',
              'bigtiff': 'if_safer'}
    path = Path(path)
    values_path = path.with_name(f'{path.stem}.values{path.suffix}')
    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        # A map without georeference is a raster without one; the command says so.
        warnings.simplefilter('ignore', rasterio.errors.NotGeoreferencedWarning)
        works = [stack.enter_context(replacing(name)) for name in (path, values_path)]
        classes = stack.enter_context(rasterio.open(
            works[0], 'w', count=1, dtype='uint8' if small else 'uint16', nodata=nothing,
            **common))
        values = stack.enter_context(rasterio.open(
            works[1], 'w', count=len(BANDS), dtype='float32', nodata=math.nan, **common))
        _describe(classes, values, source, sorted(found.labels), nothing)
        for left, tops in _slabs(source, choice, low, width, height, nothing):
            window = rasterio.windows.Window(left, 0, tops[0].shape[1], height)
            classes.write(tops[0], 1, window=window)
            for band, top in enumerate(tops[1:], 1):
                values.write(top, band, window=window)
    write_text(Path(f'{path}.aux.xml'), _names(source.legend, max(found.labels)))
    write_text(path.with_suffix('.qml'), _style(source.legend, sorted(found.labels)))
    return width, height


def _slabs(source: MapSource, choice: Choice, low: NDArray[np.int64], width: int, height: int,
           nothing: int) -> Any:
    """
    Yield (first column of pixels, [class, height, confidence, observations]) from left to right.

    Blocks come sorted by x, so no more than TILE and a block's columns are held at a time.

    """
    left, tops = 0, _empty(min(TILE, width), height, nothing)
    with source.shown(choice, 'geotiff') as chunks:
        for columns in chunks:
            x = columns['voxel'][:, 0] - low[0]
            for start in np.unique(x // TILE) * TILE:
                if start != left:
                    yield left, tops
                    left, tops = int(start), _empty(min(TILE, width - int(start)), height,
                                                    nothing)
                inside = (x >= start) & (x < start + TILE)
                _raise(tops, source, columns, inside, x - start, low, height)
    yield left, tops


def _empty(width: int, height: int, nothing: int) -> list[NDArray[Any]]:
    """Return a slab without anything."""
    return [np.full((height, width), nothing, np.uint16),
            *(np.full((height, width), np.nan, np.float32) for _ in BANDS)]


def _raise(tops: list[NDArray[Any]], source: MapSource, columns: Columns,
           inside: NDArray[np.bool_], x: NDArray[np.int64], low: NDArray[np.int64],
           height: int) -> None:
    """Enter voxels that are higher than what the slab has in their columns."""
    rows = np.flatnonzero(inside)
    rows = rows[np.argsort(columns['voxel'][rows, 2], kind='stable')]   # the last one wins
    at = height - 1 - (columns['voxel'][rows, 1] - low[1]), x[rows]     # north is up
    z = ((columns['voxel'][rows, 2] + 0.5) * source.voxel_size + source.origin[2]
         + place_of(source).up).astype(np.float32)
    higher = ~(tops[1][at] >= z)
    rows, at, z = rows[higher], (at[0][higher], at[1][higher]), z[higher]
    for top, column in zip(tops, (columns['label'][rows], z, columns['confidence'][rows],
                                  columns['observations'][rows])):
        top[at] = column


def _transform(rasterio: Any, source: MapSource, place: Place, low: NDArray[np.int64],
               high: NDArray[np.int64]) -> Any:
    """Return what takes (column, row) of the raster to (east, north)."""
    corner = np.array([[low[0], high[1] + 1, 0]]) * source.voxel_size + source.origin
    east, north, _ = place.placed(corner)[0]
    c, s = place.cos_sin
    size = source.voxel_size
    return rasterio.Affine(size * c, size * s, east, size * s, -size * c, north)


def _describe(classes: Any, values: Any, source: MapSource, labels: list[int],
              nothing: int) -> None:
    """Enter colours, names and what the bands are."""
    legend = source.legend
    classes.write_colormap(1, {**{c: (*legend.color(c), 255) for c in (*legend.ids, *labels)
                                  if c < nothing}, nothing: (0, 0, 0, 0)})
    classes.set_band_description(1, 'class')
    classes.update_tags(1, **{f'CLASS_{c}': legend.name(c) for c in labels})
    for band, name in enumerate(BANDS, 1):
        values.set_band_description(band, name)
    for out in (classes, values):
        out.update_tags(TIFFTAG_SOFTWARE='persem_ros', MAP_FRAME=source.map_frame,
                        VOXEL_SIZE=repr(source.voxel_size))


def _names(legend: Legend, most: int) -> str:
    """Return GDAL's side file with the names of ids 0 .. most."""
    known = set(legend.ids)
    lines = ''.join(f'      <Category>{escape(_plain(legend.name(c)) if c in known else "")}'
                    '</Category>\n' for c in range(most + 1))
    return ('<PAMDataset>\n  <PAMRasterBand band="1">\n    <CategoryNames>\n' + lines
            + '    </CategoryNames>\n  </PAMRasterBand>\n</PAMDataset>\n')


def _style(legend: Legend, labels: list[int]) -> str:
    """Return QGIS's style with the classes that are there; a colour table has all 256 ids."""
    rows = ''.join(
        f'        <paletteEntry value="{c}" label={quoteattr(_plain(legend.name(c)))} '
        f'color="#{bytes(legend.color(c)).hex()}" alpha="255"/>\n' for c in labels)
    return ('<qgis>\n  <pipe>\n    <rasterrenderer type="paletted" band="1" opacity="1">\n'
            f'      <colorPalette>\n{rows}      </colorPalette>\n'
            '    </rasterrenderer>\n  </pipe>\n</qgis>\n')


def _plain(text: str) -> str:
    """Return a name without what XML does not allow."""
    return ''.join(c if c.isprintable() else '?' for c in text)
