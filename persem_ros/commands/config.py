"""persem config: print the settings as YAML or as a table."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_settings

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'config', help='print the settings as YAML, to be used with --config',
        description='Prints every setting in force with its meaning, unit and range, as YAML in '
                    'ROS form that the node and the command line read.')
    add_settings(parser)
    parser.add_argument('--defaults-node', action='store_true',
                        help="start from the node's defaults")
    parser.add_argument('--markdown', action='store_true',
                        help='print the table of all settings and their defaults instead')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Print the settings on standard output."""
    from persem_ros.settings import config_file
    config = config_file.from_args(args.config, args.set_items, node=args.defaults_node)
    if args.markdown:
        print(config_file.to_markdown(), end='')
        return
    given = config_file.given_names(args.config, args.set_items)
    left_out = set() if args.defaults_node else set(config_file.NODE_DEFAULTS) - given
    print(config_file.to_yaml(config, left_out), end='')
