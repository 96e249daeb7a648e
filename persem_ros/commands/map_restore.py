"""persem map restore: a map in which nothing counts as moved away."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_map

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(actions: _SubParsersAction[Any]) -> None:
    """Add the action to persem map."""
    parser = actions.add_parser(
        'restore', help='bring back the voxels that memory.clear_after took away',
        description='Makes every voxel present again that is gone because later frames looked '
                    'through it; looks are counted anew, and the map is refined anew with its own '
                    'settings.')
    add_map(parser, '; it is replaced')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Restore the voxels, write the map, say how many."""
    from dataclasses import replace

    import numpy as np
    from persem_ros.core.memory.loading import load
    from persem_ros.outputs.map.rewrite import held, put_back
    with held(args.file) as stored:
        saved = stored.saved
        gone = int(np.count_nonzero(saved.gone))
        if gone or saved.passed.any():
            put_back(stored, load(replace(saved, gone=np.zeros_like(saved.gone),
                                          passed=np.zeros_like(saved.passed),
                                          passed_at=np.zeros_like(saved.passed_at))))
    print(f'{args.file}: {gone} voxels are back' if gone else
          f'{args.file}: no voxel was gone; the file stays as it is' if not saved.passed.any() else
          f'{args.file}: no voxel was gone; looks through voxels are counted anew')
