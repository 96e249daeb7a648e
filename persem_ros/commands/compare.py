"""persem compare: what differs between two results."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'compare', help='say what differs between two results',
        description='Prints the settings, versions and measures in which two results of persem '
                    'evaluate (or of persem replay) differ, with intervals where both looked at '
                    'the same frames.',
        epilog='example: persem compare before after --out comparison')
    parser.add_argument('a', metavar='A', help='folder of a result')
    parser.add_argument('b', metavar='B', help='folder of another')
    parser.add_argument('--out', metavar='DIR', help='draw both and write the tables there')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Print what differs."""
    from persem_ros.evaluate.compare import compare
    from persem_ros.evaluate.show.table import console
    lines, tables = compare(args.a, args.b, args.out)
    print(f'A: {args.a}\nB: {args.b}\n')
    print('\n'.join(f'  {line}' for line in lines) or
          '  made with the same settings and versions')
    for table in tables:
        print(f'\n{console(table)}')
    if args.out:
        print(f'\nfigures and tables in {args.out}')
