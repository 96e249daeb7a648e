"""persem evaluate: from recordings with truth to tables, figures and intervals."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_evaluation, methods_of
from persem_ros.settings.config import IMAGE_METHODS, METHODS

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'evaluate', help='compare all methods on recordings with truth',
        description='Reads each recording twice, labels its map by every method and measures '
                    'all of them on the same pixels: accuracy, mean IoU and flicker, in '
                    'difficult regions too, with intervals. What is finished is not computed '
                    'again.',
        epilog='example: persem evaluate flight1 flight2 --out result --labels town')
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='rosbag2 recordings; A+B is one input in two of them')
    parser.add_argument('--out', metavar='DIR', help='folder of the results (default: only the '
                                                     'tables, on standard output)')
    parser.add_argument('--methods', metavar='A,B', default='all',
                        help='methods to be compared (default: all '
                             f'{len(IMAGE_METHODS + METHODS)})')
    add_evaluation(parser)
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Evaluate the recordings; print the tables."""
    from contextlib import nullcontext
    from tempfile import TemporaryDirectory

    from persem_ros.commands.options import excerpt_of
    from persem_ros.evaluate.run import evaluate
    from persem_ros.evaluate.show.paper_tables import tables
    from persem_ros.evaluate.show.table import console
    from persem_ros.settings import config_file
    config = config_file.from_args(args.config, args.set_items)
    with nullcontext(args.out) if args.out else TemporaryDirectory(prefix='persem-') as out:
        evaluation = evaluate(
            args.bags, out, config, methods_of(args.methods), args.labels, args.grouped,
            not args.no_dynamic, args.predictions, args.workers, args.scheduler, args.force,
            bool(args.out) and not args.no_figures, excerpt_of(args))
    print('\n\n'.join(map(console, tables(evaluation))))
    if args.out:
        print(f'\nresults in {args.out}')
