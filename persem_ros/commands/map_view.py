"""persem map view: a map file in the browser."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map
from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

PORT = 8420


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'view', help='look at a map in the browser, however large, also while it is made',
        description='Shows a map file in a page on 127.0.0.1 until Ctrl-C. Coarse from afar and '
                    'every voxel close by; a click says why a voxel has its label. A map that is '
                    'being written (map.attached) is followed.')
    add_map(parser)
    parser.add_argument('--port', type=int, default=PORT, metavar='N',
                        help='of this machine, %(default)s by default; 0: any that is free')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Serve the page until the process is interrupted."""
    from pathlib import Path

    from persem_ros.outputs.view.living import LivingView
    from persem_ros.outputs.view.server import Server
    from persem_ros.outputs.view.pages import Pages
    if not 0 <= args.port < 1 << 16:
        raise PersemError(f'--port {args.port}: expected a number from 1 to 65535, or 0 for any '
                          'port that is free')
    view = LivingView(Path(args.file))
    with Server(Pages(view), args.port) as server:
        print(f'{args.file}: {view.source.n_voxels} voxels. Open {server.address} (Ctrl-C ends)',
              flush=True)
        server.serve_forever()
