"""persem map merge: several maps become one."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    import numpy as np
    from numpy.typing import NDArray


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'merge', help='several maps become one',
        description='Writes the map that one run over all recordings would have given, in the '
                    'order of the files; classes are matched by name. It is refined anew, with '
                    'the settings of the first.')
    parser.add_argument('files', metavar='FILE', nargs='+', help='map files (.persem)')
    parser.add_argument('--out', metavar='FILE', required=True, help='the new map file')
    parser.add_argument('--force', action='store_true', help='replace FILE where it exists')
    parser.add_argument('--transform', metavar='X', type=float, nargs=7,
                        help='x y z qx qy qz qw: move the second of two maps first, from its '
                             'frame to that of the first')
    names = parser.add_mutually_exclusive_group()
    names.add_argument('--by-id', action='store_true',
                       help='ids mean the same in all files, whatever their legends say')
    names.add_argument('--legend', metavar='LEGEND',
                       help='a legend (a shipped name or a YAML file) for the ids of all files')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Merge, refine, write; print what it is equal to."""
    from pathlib import Path

    from persem_ros.core.refine.whole import refine
    from persem_ros.outputs.map import store
    from persem_ros.outputs.map.merge import merge
    from persem_ros.outputs.map.move import transformed
    from persem_ros.settings.legend_files import load_legend
    out = Path(args.out)
    if len(args.files) < 2:
        raise PersemError(f'expected two files or more, got {args.files[0]} alone: persem map '
                          f'merge {args.files[0]} OTHER --out {out}')
    if out.resolve() in [Path(file).resolve() for file in args.files]:
        raise PersemError(f'{out} is one of the maps to be merged; give another name with --out')
    if out.exists() and not args.force:
        raise PersemError(f'{out} exists; give another name with --out, or --force to replace it')
    if args.transform and len(args.files) != 2:
        raise PersemError(f'--transform moves the second of two maps, got {len(args.files)}; '
                          'merge them two by two')
    T = _matrix(args.transform) if args.transform else None
    maps = [store.load(file) for file in args.files]
    if T is not None:
        maps[1] = transformed(maps[1], T)
    done = merge(maps, args.by_id, load_legend(args.legend) if args.legend else None)
    if T is not None:
        done.exact = False
    config = maps[0].config()
    refine(done.memory, config.refine)
    store.save(out, done.memory, config, done.legend)
    for note in done.notes:
        print(note)
    sessions = len(done.memory.frames.sessions)
    print(f'{done.memory.n_voxels} voxels, {done.memory.n_observations} observations, '
          f'{sessions} session{"s" if sessions > 1 else ""} in {out}: '
          + ('not what one run over all recordings gives, but all that was kept'
             if not done.exact else 'equal to one run over all recordings' if done.known else
             'equal to one run over all recordings, as far as their settings are known'))


def _matrix(numbers: list[float]) -> NDArray[np.float64]:
    """Return the 4x4 matrix of --transform."""
    from persem_ros.inputs.trajectory import pose_of_numbers
    return pose_of_numbers(numbers, '--transform')
