"""persem map forget: a map without one of its sessions."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'forget', help='take a session out of a map',
        description='Makes the file the map that the other sessions alone would have given; they '
                    'are numbered anew, and the map is refined anew with its own settings.')
    add_map(parser, '; it is replaced')
    parser.add_argument('--session', type=int, required=True, metavar='N',
                        help='its number, the first is 0')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Make the map without the session, write it, say what is left."""
    from persem_ros.outputs.map.merge import without
    from persem_ros.outputs.map.rewrite import held, put_back
    with held(args.file) as stored:
        memory = without(stored, args.session)
        put_back(stored, memory)
    print(f'{args.file}: session {args.session} is forgotten; {memory.n_voxels} voxels, '
          f'{memory.n_observations} observations of {len(memory.frames.sessions)} '
          f'session{"s" if len(memory.frames.sessions) > 1 else ""} are left')
