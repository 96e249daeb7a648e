"""persem sweep: the same recordings under many settings."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_evaluation, methods_of

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'sweep', help='measure how settings, noise and order change the results',
        description='Evaluates recordings at every combination of some values of settings: '
                    'curves for one setting, heat maps for two. Besides the settings of persem '
                    'config there are disturb.pose_noise (m), disturb.attitude_noise (degrees), '
                    'disturb.pose_drift (m after 100 frames), disturb.depth_noise (share of the '
                    'depth), disturb.order (recorded, reversed, shuffled) and disturb.seed.',
        epilog='example: persem sweep flight --out result --vary refine.eta=0,0.15,0.3,0.6')
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='rosbag2 recordings; A+B is one input in two of them')
    parser.add_argument('--vary', metavar='NAME=A,B,C', action='append', required=True,
                        help='a setting and its values; may be given again')
    parser.add_argument('--each', action='store_true',
                        help='vary one setting at a time, the others as they are, instead of '
                             'every combination; the first row has none of them changed')
    parser.add_argument('--out', metavar='DIR', required=True, help='folder of the results')
    parser.add_argument('--methods', metavar='A,B', default='raw2d,ema2d,majority,persem',
                        help='methods to be compared, or all (default: %(default)s)')
    add_evaluation(parser)
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Evaluate all points; print their table."""
    from persem_ros.commands.options import excerpt_of
    from persem_ros.evaluate.show.table import console
    from persem_ros.evaluate.sweep import parse_vary, points_table, sweep
    from persem_ros.settings import config_file
    config = config_file.from_args(args.config, args.set_items)
    result = sweep(args.bags, args.out, config, parse_vary(args.vary, config, args.each),
                   methods_of(args.methods), args.labels, args.grouped, not args.no_dynamic,
                   args.predictions, args.workers, args.scheduler, args.force,
                   not args.no_figures, excerpt_of(args), args.each)
    print(console(points_table(result)))
    print(f'\nresults in {args.out}')
