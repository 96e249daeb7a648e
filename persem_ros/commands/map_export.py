"""persem map export: a map file as points, tables, rasters, meshes and grids."""

from __future__ import annotations

import logging
from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.source import MapSource
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)
# Option, metavar, help; in the order in which they are written.
FORMATS = (
    ('ply', 'OUT', 'points as in map.ply of a replay'),
    ('laz', 'OUT', 'LAS 1.4 points, compressed unless the name ends in .las (needs laspy, lazrs)'),
    ('geotiff', 'OUT', 'the top-most classes from above, and OUT.values.tif with height, '
                       'confidence and observations (needs rasterio)'),
    ('mesh', 'OUT', 'the outer faces of the voxels, coloured: .glb or .ply'),
    ('npz', 'OUT', 'a NumPy archive with all class probabilities'),
    ('parquet', 'OUT', 'a table with all class probabilities (needs pyarrow)'),
    ('grid', 'DIR', 'costs for a vehicle on the ground as Nav2 loads them: map.yaml, map.pgm, and '
                    'classes beside'),
    ('tiles', 'DIR', '3D Tiles 1.1: point clouds by level of detail, tileset.json and tiles/'))
# Of a format, by the end of its name: what it is and the package it needs.
NEEDS = {('laz', ''): ('a LAS file', 'laspy'), ('laz', '.laz'): ('a LAZ file', 'lazrs'),
         ('geotiff', ''): ('a GeoTIFF', 'rasterio'),
         ('parquet', ''): ('a Parquet file', 'pyarrow'),
         ('mesh', '.glb'): ('a .glb', 'trimesh')}
INSIDE = {'grid': ('map.yaml',), 'tiles': ('tileset.json',)}       # of a folder: its chief file
CHANGEABLE = ('grid.', 'map.crs', 'map.georeference')


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'export', help='points, tables, rasters, meshes, grids for other programs',
        description='Writes the voxels of a map file for other programs; several formats at once '
                    'if you like. Maps may be larger than memory.')
    add_map(parser)
    for name, metavar, text in FORMATS:
        parser.add_argument(f'--{name}', metavar=metavar, help=text)
    parser.add_argument(
        '--crop', type=float, nargs=6, metavar=('X0', 'Y0', 'Z0', 'X1', 'Y1', 'Z1'),
        help='only voxels whose centres lie in this box, metres in the map frame')
    parser.add_argument(
        '--min-observations', type=int, default=1, metavar='N',
        help='only voxels that were observed N times or more often')
    parser.add_argument('--classes', metavar='A,B',
                        help='only these classes: names or ids, separated by commas')
    parser.add_argument('--legend', metavar='FILE',
                        help="names, colours, costs and LAS codes in place of the map's own: a "
                             'shipped legend or a YAML file')
    parser.add_argument('--set', metavar='NAME=VALUE', action='append', default=[],
                        dest='set_items', help='a setting grid.*, map.crs or map.georeference; '
                                               'may be given again')
    parser.add_argument('--force', action='store_true', help='replace what exists')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Write the chosen voxels in each format that was asked for; say what was written."""
    from persem_ros.outputs.export.source import MapSource
    from persem_ros.settings.legend_files import load_legend
    wanted = [(name, getattr(args, name)) for name, _, _ in FORMATS if getattr(args, name)]
    if not wanted:
        raise PersemError('nothing to write: give at least one of '
                          + ', '.join(f'--{name}' for name, _, _ in FORMATS))
    source = MapSource(args.file, load_legend(args.legend) if args.legend else None)
    source.config = _changed(source, args.set_items)
    choice = _choice(args, source.legend)
    for name, out in wanted:
        _check_free(args, name, out)
        _check_able(name, out, source)      # before the first is written, which may take long
    _compare_names(source, args.legend)
    for name, out in wanted:
        print(WRITERS[name](out, source, choice))


def _ply(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.map.cloud import map_points
    from persem_ros.outputs.map.ply import map_comments, write_ply_parts
    found = source.summary_of_something(choice)
    with source.shown(choice, 'ply') as chunks:
        write_ply_parts(out, found.voxels, (
            map_points(columns, source.voxel_size, source.legend) for columns in chunks),
            map_comments(source.map_frame, tuple(source.origin), source.voxel_size))
    return f'{found.voxels} of {source.n_voxels} voxels written to {out}'


def _laz(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.las import write_las
    n, without = write_las(out, source, choice)
    told = ''
    if without:
        names = ', '.join(source.legend.name(c) for c in without[:5])
        told = (f'; without a key las in the legend, and so class 1 (unclassified): {names}'
                + (' …' if len(without) > 5 else ''))
    return f'{n} of {source.n_voxels} voxels written to {out}{_where(source)}{told}'


def _geotiff(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.raster import write_geotiff
    width, height = write_geotiff(out, source, choice)
    turn = source.config.map.georeference[3]
    turned = f', turned by {turn:g} degrees against north (gdalwarp makes it north up)' \
        if source.config.map.crs and turn else ''
    return f'{width} x {height} pixels written to {out}{_where(source)}{turned}'


def _mesh(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.mesh import write_mesh
    return f'{write_mesh(out, source, choice)} faces written to {out}'


def _npz(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.tables import write_npz
    source.summary_of_something(choice)
    return f'{write_npz(out, source, choice)} of {source.n_voxels} voxels written to {out}'


def _parquet(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.tables import write_parquet
    source.summary_of_something(choice)
    return f'{write_parquet(out, source, choice)} of {source.n_voxels} voxels written to {out}'


def _grid(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.nav2 import write_nav2
    cells = write_nav2(out, source, choice)
    known = cells.cost[cells.cost >= 0]
    return (f'{cells.cost.shape[1]} x {cells.cost.shape[0]} cells of {cells.size:g} m written to '
            f'{out}/map.yaml: {(known < 100).sum()} passable, {(known == 100).sum()} lethal, '
            f'{(cells.cost < 0).sum()} unknown (nothing was seen there, or no ground)')


def _tiles(out: str, source: MapSource, choice: Choice) -> str:
    from persem_ros.outputs.export.tiles import write_tiles
    tiles, points = write_tiles(out, source, choice)
    return f'{points} points in {tiles} tiles of 3D Tiles 1.1 written to {out}/tileset.json'


WRITERS = {'ply': _ply, 'laz': _laz, 'geotiff': _geotiff, 'mesh': _mesh, 'npz': _npz,
           'parquet': _parquet, 'grid': _grid, 'tiles': _tiles}


def _where(source: MapSource) -> str:
    """Return words about the coordinates of what was written."""
    crs = source.config.map.crs
    return f' in {crs}' if crs else (f' in the frame {source.map_frame}, without georeference '
                                     '(persem map georeference gives one)')


def _changed(source: MapSource, items: list[str]) -> Config:
    """Return the map's settings with those of --set."""
    from persem_ros.settings import config_file
    values = dict(map(config_file.parse_item, items))
    for name in values:
        if not name.startswith(CHANGEABLE):
            raise PersemError(f'--set {name}: the map was made with what it has; expected one of '
                              'grid.*, map.crs, map.georeference')
    return config_file.from_values(values, source.config, '--set ')


def _choice(args: Namespace, legend: Legend) -> Choice:
    """Return the Choice that the options make."""
    from persem_ros.outputs.export.choice import Choice, labels_of
    words = [part.strip() for part in (args.classes or '').split(',') if part.strip()]
    if args.classes is not None and not words:
        raise PersemError('--classes names no class; leave it out for all of them')
    return Choice(args.min_observations, tuple(args.crop) if args.crop else None,
                  labels_of(words, legend))


def _check_free(args: Namespace, name: str, out: str) -> None:
    """Refuse an output that exists or is the map."""
    from pathlib import Path
    path = Path(out, *INSIDE.get(name, ()))
    if path.resolve() == Path(args.file).resolve():
        raise PersemError(f'{out} is the map itself; give another name with --{name}')
    if path.is_file() and not args.force:
        raise PersemError(f'{path} exists; give another name with --{name}, or --force to '
                          'replace it')


def _check_able(name: str, out: str, source: MapSource) -> None:
    """Refuse a format whose library or coordinate system is not there."""
    from persem_ros.outputs.export.libraries import needed
    from persem_ros.outputs.export.place import projected
    for (option, end), (what, library) in NEEDS.items():
        if option == name and out.endswith(end):
            needed(library, what)
    if name in ('laz', 'geotiff') and source.config.map.crs:
        projected(source.config.map.crs)


def _compare_names(source: MapSource, given: str | None) -> None:
    """Warn where a legend calls what the map holds otherwise than the map does."""
    own, seen = source.own_legend, set(source.seen)
    if given is None or own is None:
        return
    other = [f'{own.name(c)} ({c}) is {source.legend.name(c)}' for c in own.ids
             if c in seen and c in source.legend.ids and own.name(c) != source.legend.name(c)]
    if other:
        log.warning('--legend %s calls classes otherwise than the map: %s; if it is of another '
                    'data set, colours, costs and codes are wrong', given,
                    ', '.join(other[:4]) + (' …' if len(other) > 4 else ''))
