"""persem build: many recordings become one map, on many cores or a cluster."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_settings, add_workers

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'build', help='many recordings become one map, on many cores or a cluster',
        description='Writes the map that persem replay of the same recordings leaves, bit for '
                    'bit: recordings are observed side by side, the map is put together and '
                    'refined tile by tile. A build that was stopped goes on where it was: type '
                    'the same again.',
        epilog='example: persem build flight1 flight2 flight3 --out map')
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='a rosbag2 recording: folder, .mcap or .db3; A+B is one input in '
                             'two recordings, A B are sessions of one map in that order')
    parser.add_argument('--out', metavar='DIR', required=True,
                        help='folder of map.persem, config.yaml and build.json')
    parser.add_argument('--tile', metavar='M', type=float, default=64.0,
                        help='metres along the edge of a tile (default: 64), rounded up to whole '
                             'blocks of 8 voxels')
    add_workers(parser)
    parser.add_argument('--force', action='store_true',
                        help='give up what another build left in DIR')
    add_settings(parser)
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Build the map; print what it came to."""
    from pathlib import Path

    from persem_ros.commands import frames_text
    from persem_ros.mosaic.run import build
    from persem_ros.settings import config_file
    config = config_file.from_args(args.config, args.set_items)
    result = build(args.bags, args.out, config, args.tile, args.workers, args.scheduler,
                   args.force)
    print('\n'.join(frames_text.lines(
        result['frames'], ', '.join(
            f'{result[what]} {what if result[what] != 1 else what[:-1]}'
            for what in ('sessions', 'tiles', 'voxels', 'observations')))))
    print(f'the map is {Path(args.out) / "map.persem"}')
