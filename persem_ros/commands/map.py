"""persem map: what is in a map file, why a voxel has its label, and files for others."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands import (
    map_export, map_forget, map_georeference, map_merge, map_move, map_restore, map_view)
from persem_ros.commands.options import add_map
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    import numpy as np
    from numpy.typing import NDArray
    from persem_ros.core.memory.dump import MemoryDump
    from persem_ros.outputs.map.stored import StoredMap


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its own sub-commands."""
    parser = subparsers.add_parser(
        'map', help='look into a map file, hand it on: info, query, view, export, georeference, '
                    'merge, move, forget, restore',
        description='Looks into a map file (.persem) as a replay or ~/save_map leaves it.')
    actions = parser.add_subparsers(metavar='ACTION', required=True)

    info_parser = actions.add_parser('info', help='size, extent, classes, frames, settings')
    add_map(info_parser)
    info_parser.set_defaults(run=info)

    map_view.add_parser(actions)
    map_export.add_parser(actions)
    map_georeference.add_parser(actions)
    map_merge.add_parser(actions)
    map_move.add_parser(actions)
    map_forget.add_parser(actions)
    map_restore.add_parser(actions)

    query_parser = actions.add_parser(
        'query', help='the history of one voxel, its evidence, its label and why',
        description='Shows what was seen in the voxel at a point, and each step from there to '
                    'its label.')
    add_map(query_parser)
    for axis in 'xyz':
        query_parser.add_argument(axis, metavar=axis.upper(), type=float,
                                  help=f'{axis} in metres in the map frame')
    query_parser.set_defaults(run=query)


def info(args: Namespace) -> None:
    """Print what the map file holds."""
    import numpy as np
    from persem_ros.outputs.map.loading import load
    from persem_ros.settings.config import settings
    from persem_ros.settings.parameter_file import scalar
    stored = load(args.file)
    saved, origin = stored.saved, np.array(stored.saved.origin)
    print(f'{args.file}: {stored.path.stat().st_size / 1e6:.1f} MB, whole')
    print(f'frame {stored.map_frame}, voxels of {saved.voxel_size:g} m, '
          f'origin {_point(origin)} m')
    print(f'{len(saved.cell)} voxels in {len(saved.block_index)} blocks, '
          f'{int(saved.observations.sum(dtype=np.int64))} observations'
          + (f', the newest {saved.max_history} of each voxel kept' if saved.max_history else ''))
    gone = int(saved.gone.sum())
    if gone:
        print(f'{gone} of the voxels are gone (memory.clear_after); persem map restore brings '
              'them back')
    if len(saved.cell):
        low, high = stored.bounds()
        print(f'extent from {_point(low)} to {_point(high)} m')
    print(_frames_line(saved))
    if len(saved.cell):
        print('\n' + _class_table(stored))
    default = {name: value for name, value, _ in settings()}
    # As --set takes them: a text stands there without quotes.
    others = [f'{name}={value if isinstance(value, str) else scalar(value)}'
              for name, value, _ in settings(stored.config()) if default.get(name) != value]
    print('\nsettings other than the defaults: ' + (', '.join(others) or 'none'))


def query(args: Namespace) -> None:
    """Print the history, evidence and label of the voxel at a point."""
    import numpy as np
    from persem_ros.outputs.map.part import explained, surroundings
    point = np.array([args.x, args.y, args.z])
    stored, memory, voxel = surroundings(args.file, point)
    if memory.find(voxel)[0] < 0:
        raise PersemError(f'{args.file}: nothing was observed at {_point(point)} m'
                          + _nearest(args.file, point))
    print(explained(stored, memory, voxel)[0])


def _nearest(path: str, point: NDArray[np.float64]) -> str:
    """Return words that name the observed voxel nearest to a point."""
    import numpy as np
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.source import MapSource
    source, best = MapSource(path), (np.inf, point)
    for columns in source.chunks(Choice(gone=True)):
        centres = source.centres(columns['voxel'])
        distance = np.linalg.norm(centres - point, axis=1)
        nearest = int(np.argmin(distance))
        best = min(best, (float(distance[nearest]), centres[nearest]), key=lambda item: item[0])
    if not source.n_voxels:
        return '; the map is empty'
    return f'; the nearest voxel is {best[0]:.2f} m away at {_point(best[1])}'


def _frames_line(saved: MemoryDump) -> str:
    """Return when and by what the map was made."""
    from datetime import datetime, timezone

    import numpy as np
    if not len(saved.frames):
        return 'no frames'
    stamps = saved.frames.stamp.tolist()
    first, last = (datetime.fromtimestamp(stamp / 1e9, timezone.utc).isoformat(
        ' ', 'seconds').replace('+00:00', ' UTC') for stamp in (min(stamps), max(stamps)))
    sensors = sorted(name for name in saved.frames.sensors if name)
    sessions = len(np.unique(saved.frames.session))
    return (f'{len(stamps)} frames from {first} to {last}, {sessions} '
            f'session{"s" if sessions > 1 else ""}'
            + (f', cameras {", ".join(sensors)}' if sensors else ''))


def _class_table(stored: StoredMap) -> str:
    """Return the classes by number of voxels, with their sources."""
    import numpy as np
    from persem_ros.outputs.map.cloud import SOURCES
    from persem_ros.outputs.map.explanation import names
    saved, name = stored.saved, names(stored.legend)
    ids, counts = np.unique(saved.label, return_counts=True)
    lines = [f'{"id":>5}  {"class":<24}{"voxels":>10}{"share":>8}  '
             + ''.join(f'{source:>10}' for source in SOURCES)]
    for k in np.argsort(-counts, kind='stable'):
        by_source = np.bincount(saved.source[saved.label == ids[k]], minlength=len(SOURCES))
        lines.append(f'{ids[k]:>5}  {name(ids[k])[:23]:<24}{counts[k]:>10}'
                     f'{counts[k] / len(saved.label):>8.1%}  '
                     + ''.join(f'{n:>10}' for n in by_source))
    return '\n'.join(lines)


def _point(xyz: NDArray[np.float64]) -> str:
    """Return three numbers as text."""
    return ' '.join(f'{x:.6g}' if abs(x) < 1e5 else f'{x:.2f}' for x in xyz)
