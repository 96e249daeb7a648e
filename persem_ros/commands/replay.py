"""persem replay: from a recording to a refined map, refined images and metrics."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_excerpt, add_settings
from persem_ros.settings.config import IMAGE_METHODS, METHODS

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace
    from collections.abc import Mapping

    from persem_ros.frames import Frame
    from persem_ros.passes import Replay, Watcher
    from persem_ros.rendering import Rendering


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'replay', help='turn a recording into a refined map, refined images and metrics',
        description='Reads a rosbag2 recording of label images, depth and poses, builds and '
                    'refines the map, renders every frame from it and measures accuracy and '
                    'flicker.',
        epilog='example: persem replay flight --out result --set memory.voxel_size=0.25')
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='a rosbag2 recording: folder, .mcap or .db3; A+B is one input in '
                             'two recordings (drive and labels), A B are sessions of one map in '
                             'that order')
    parser.add_argument('--out', metavar='DIR', required=True, help='folder of the results')
    parser.add_argument('--methods', metavar='A,B',
                        help=f'methods to be measured, or all: {", ".join(IMAGE_METHODS)} (images '
                             f'alone, no map) and {", ".join(METHODS)} (default: raw2d,majority '
                             'and refine.method)')
    parser.add_argument('--causal', action='store_true',
                        help='render each frame from the map as it stood then, as a node does')
    parser.add_argument('--force', action='store_true',
                        help='replace the files of an earlier run in DIR, when the new ones are '
                             'whole; and FILE of --figure and --rerun')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                        help='storage of the recording refined/ (default: mcap); every ROS 2 '
                             'opens sqlite3 without a plugin')
    parser.add_argument('--rerun', metavar='FILE.rrd',
                        help='log camera, images and the growing map for the Rerun viewer as well '
                             "(pip install '.[viewer]')")
    parser.add_argument('--figure', metavar='FILE.png',
                        help='write a picture of one frame and the map as well')
    parser.add_argument('--trajectory', metavar='FILE',
                        help='corrected poses of what the pose topic places, in the frame of the '
                             'map: lines of "stamp x y z qx qy qz qw" (TUM), or a recording with '
                             'a nav_msgs/Path')
    add_excerpt(parser)
    add_settings(parser)
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Replay the recording; print the table of results."""
    from contextlib import ExitStack
    from pathlib import Path

    from persem_ros.commands.options import excerpt_of
    from persem_ros.inputs.recording.corrected import load
    from persem_ros.inputs.recording.finding import split
    from persem_ros.outputs.results.rundir import check_extra, FILES
    from persem_ros.replay import replay
    from persem_ros.settings import config_file
    config = config_file.from_args(args.config, args.set_items)
    trajectory = load(args.trajectory, config.frames.map) if args.trajectory else None
    methods = [name.strip() for name in (args.methods or '').split(',') if name.strip()]
    used: list[Path | str] = [*(part for bag in args.bags for part in split(bag)),
                              config.map.path, *(Path(args.out, name) for name in FILES)]
    for option, path in (('--figure', args.figure), ('--rerun', args.rerun)):
        if path:
            check_extra(path, option, args.force, used)
    with ExitStack() as stack:
        truth = _Truth()
        watchers: list[Watcher] = [truth]
        if args.rerun:
            from persem_ros.outputs.results.rerun_log import RerunLog
            watchers.append(stack.enter_context(RerunLog(args.rerun)))
        if args.figure:
            from persem_ros.outputs.report.figure import FigureWatcher
            watchers.append(FigureWatcher(args.figure))
        result = replay(args.bags, args.out, config, methods, args.causal, args.force, watchers,
                        excerpt=excerpt_of(args), trajectory=trajectory, storage=args.storage)
    print(summary(result, truth.missing, truth.reasons))
    print(f'\nresults in {args.out}, to be looked at: {Path(args.out) / "report.html"}')


class _Truth:
    """A watcher of the replay that asks in the end why accuracy is unknown and frames dropped."""

    def __init__(self) -> None:
        self.missing = ''
        self.reasons: dict[str, str] = {}

    def frame(self, replay: Replay, frame: Frame, rendering: Rendering) -> None:
        """Pass over a frame."""

    def finish(self, replay: Replay, result: dict[str, Any]) -> None:
        """Keep the reason, '' where accuracy is known, and why frames were dropped."""
        self.missing = replay.without_truth()
        self.reasons = dict(replay.recording.examples)


def summary(result: dict[str, Any], without_truth: str = '',
            reasons: Mapping[str, str] | None = None) -> str:
    """
    Return what metrics.json holds as a small table for people.

    Parameters
    ----------
    result : dict
        The content of metrics.json.
    without_truth : str
        Why accuracy is unknown, '' where it is known.
    reasons : dict, optional
        A sentence for each reason why something was dropped.

    """
    from persem_ros.commands import frames_text
    lines = frames_text.lines(result['frames'], f'{result["voxels"]} voxels, '
                              f'{result["observations"]} observations', reasons)
    lines += ['', f'{"method":<16}{"PA %":>8}{"mIoU %":>8}{"flicker %":>11}']
    for name, row in result['methods'].items():
        lines.append(f'{name:<16}{_cell(row["pixel_accuracy"], 8)}{_cell(row["miou"], 8)}'
                     f'{_cell(row["flicker"], 11)}')
    if result['truth_flicker'] is not None:
        lines.append(f'{"(truth)":<16}{"":>8}{"":>8}{_cell(result["truth_flicker"], 11)}')
    if without_truth:
        lines.append(f'{without_truth}: accuracy unknown, flicker only')
    return '\n'.join(lines)


def _cell(value: float | None, width: int) -> str:
    """Return a number with two decimals, a dash where there is none."""
    return f'{"-" if value is None else format(value, ".2f"):>{width}}'
