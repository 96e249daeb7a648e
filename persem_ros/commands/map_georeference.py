"""persem map georeference: tie a map to the Earth, by satellite fixes or by hand."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    from persem_ros.outputs.export.place import Place
    from persem_ros.outputs.export.source import MapSource


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'georeference', help='tie a map to the Earth, for the exports',
        description='Enters into the map file where its frame lies on the Earth (map.crs, '
                    'map.georeference). Without options it prints what the file has.')
    add_map(parser)
    parser.add_argument('--fix', metavar='RECORDING|CSV',
                        help='fit the flight to satellite fixes: a recording with '
                             'sensor_msgs/NavSatFix, or a table stamp,latitude,longitude,altitude')
    parser.add_argument('--topic', default='', help='where the recording has several of NavSatFix')
    parser.add_argument('--crs', default='', metavar='EPSG:CODE',
                        help='a projected system in metres; with --fix: the zone of UTM that the '
                             'fixes lie in')
    parser.add_argument('--shift', type=float, nargs=3, metavar=('EAST', 'NORTH', 'UP'),
                        help="the map frame's origin in --crs, metres")
    parser.add_argument('--yaw', type=float, default=0.0, metavar='DEGREES',
                        help="from east to the map frame's x axis, counter-clockwise")
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Fit or take the georeference, enter it, print it."""
    import math

    from persem_ros.outputs.export.georeference import enter
    from persem_ros.outputs.export.place import Place, place_of, projected
    from persem_ros.outputs.export.source import MapSource
    if args.fix and args.shift:
        raise PersemError('--fix and --shift: expected one of them')
    source = MapSource(args.file)
    if args.fix:
        place = _fitted(args, source)
    elif args.crs:
        projected(args.crs, '--crs')
        if not all(map(math.isfinite, (*(args.shift or ()), args.yaw))):
            raise PersemError('--shift and --yaw: expected finite numbers')
        east, north, up = args.shift or (0.0, 0.0, 0.0)
        place = Place(args.crs, east, north, up, args.yaw)
    elif args.shift:
        raise PersemError('--shift says where the map lies in --crs; give that as well, for '
                          'example --crs EPSG:25832')
    else:
        print(_told(place_of(source)))
        return
    enter(args.file, place)
    print(f'{args.file}: {_told(place)}')


def _fitted(args: Namespace, source: MapSource) -> Place:
    """Return the Place that the fixes give; print how well."""
    from persem_ros.inputs.recording.fixes import read_fixes
    from persem_ros.outputs.export.georeference import fitted, Fixes
    stamps, values = read_fixes(args.fix, args.topic)
    fit = fitted(source, Fixes(stamps, *values.T), args.crs)
    print(f'{fit.fixes} of {len(stamps)} fixes lie within the flight; residual {fit.rms:.2f} m '
          f'(root mean square), {fit.worst:.2f} m at most, in height {fit.rms_up:.2f} m')
    return fit.place


def _told(place: Place) -> str:
    """Return a Place in words."""
    if not place.crs:
        return 'no georeference (map.crs is empty); --fix or --crs gives one'
    return (f'{place.crs}, origin of the map frame at east {place.east:.3f}, north '
            f'{place.north:.3f}, up {place.up:.3f} m, turned by {place.yaw:.4f} degrees')
