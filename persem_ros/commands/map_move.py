"""persem map move: a map whose poses were corrected."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'move', help='move a session of a map to where a corrected trajectory says',
        description='Moves the observations of a session with its poses, as a SLAM system has '
                    'corrected them, and refines the map anew with its own settings. persem '
                    'replay --trajectory maps the recording anew, which is exact.')
    add_map(parser, '; it is replaced')
    parser.add_argument('--trajectory', metavar='FILE', required=True,
                        help='poses of what the pose topic places, in the frame of the map: '
                             'lines of "stamp x y z qx qy qz qw" (TUM), or a recording with a '
                             'nav_msgs/Path')
    parser.add_argument('--session', type=int, metavar='N',
                        help='its number, the first is 0 (default: the only one of that time)')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Move the session, refine, write; say how far it went."""
    import numpy as np
    from persem_ros.core.memory.loading import load
    from persem_ros.inputs.recording.corrected import load as load_trajectory
    from persem_ros.outputs.map import store
    from persem_ros.outputs.map.move import move_session, session_of
    from persem_ros.outputs.map.rewrite import held, put_back
    trajectory = load_trajectory(args.trajectory, store.head(args.file).stored.map_frame)
    with held(args.file) as stored:
        before = stored.saved
        session = session_of(stored, trajectory, args.session)
        after = move_session(stored, session, trajectory)
        put_back(stored, load(after))
    own = after.frames.session == session
    went = own & (after.frames.placed != before.frames.placed).any(axis=(1, 2))
    far = np.linalg.norm(after.frames.placed[:, :3, 3] - before.frames.placed[:, :3, 3], axis=1)
    print(f'{args.file}: {np.count_nonzero(went)} of {np.count_nonzero(own)} frames of session '
          f'{session} moved, by up to {far.max():.3g} m; '
          f'{len(before.cell)} voxels became {len(after.cell)}, '
          f'{len(before.history_frame)} observations {len(after.history_frame)}')
