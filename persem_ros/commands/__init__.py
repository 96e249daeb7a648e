"""One file per sub-command of persem: add_parser(subparsers) and run(args)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from persem_ros.inputs.recording.excerpt import Excerpt


def add_settings(parser: ArgumentParser) -> None:
    """Give an argparse parser the options --config and --set, for config_file.from_args."""
    parser.add_argument('--config', metavar='FILE',
                        help="settings as YAML in ROS form; 'persem config' prints one")
    parser.add_argument('--set', metavar='NAME=VALUE', action='append', default=[],
                        dest='set_items', help='one setting, for example memory.voxel_size=0.2; '
                                               'may be given again, wins over --config')


def add_excerpt(parser: ArgumentParser) -> None:
    """Give an argparse parser the options --start, --end and --every, for excerpt_of."""
    parser.add_argument('--start', metavar='S', default='',
                        help='use frames from here on: below 1e9 seconds after the first frame, '
                             'else a stamp in seconds or nanoseconds; poses before it count')
    parser.add_argument('--end', metavar='S', default='', help='use frames until here')
    parser.add_argument('--every', metavar='N', type=int, default=1,
                        help='use one of N complete frames of each camera')


def excerpt_of(args: Namespace) -> Excerpt:
    """Return the Excerpt of the options that add_excerpt adds."""
    from persem_ros.inputs.recording.excerpt import Excerpt
    return Excerpt(args.start, args.end, args.every)
