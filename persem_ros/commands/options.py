"""Options that several sub-commands share, and what they mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from persem_ros.inputs.recording.excerpt import Excerpt


def add_settings(parser: ArgumentParser) -> None:
    """Give an argparse parser the options --config and --set, for config_file.from_args."""
    parser.add_argument('--config', metavar='FILE',
                        help="settings as YAML in ROS form; 'persem config' prints one")
    parser.add_argument('--set', metavar='NAME=VALUE', action='append', default=[],
                        dest='set_items', help='one setting, for example memory.voxel_size=0.2; '
                                               'may be given again, wins over --config')


def add_excerpt(parser: ArgumentParser) -> None:
    """Give an argparse parser the options --start, --end and --every, for excerpt_of."""
    parser.add_argument('--start', metavar='S', default='',
                        help='use frames from here on: below 1e9 seconds after the first frame, '
                             'else a stamp in seconds or nanoseconds; poses before it count')
    parser.add_argument('--end', metavar='S', default='', help='use frames until here')
    parser.add_argument('--every', metavar='N', type=int, default=1,
                        help='use one of N complete frames of each camera')


def excerpt_of(args: Namespace) -> Excerpt:
    """Return the Excerpt of the options that add_excerpt adds."""
    from persem_ros.inputs.recording.excerpt import Excerpt
    return Excerpt(args.start, args.end, args.every)


def add_evaluation(parser: ArgumentParser) -> None:
    """Give an argparse parser what persem evaluate and persem sweep share, settings included."""
    parser.add_argument('--labels', metavar='NAME', default='',
                        help='taxonomy: a shipped legend or a YAML file; ids that it does not '
                             'have, or calls ignored, do not count (default: all ids count)')
    parser.add_argument('--grouped', action='store_true',
                        help="count a group of the taxonomy as one class (the recording's own "
                             'legend without --labels)')
    parser.add_argument('--no-dynamic', action='store_true',
                        help='leave classes of things that move out of the measures')
    parser.add_argument('--predictions', metavar='DIR', default='',
                        help='label images that take the place of the recorded ones, named by '
                             'their stamps; with several recordings one folder each below DIR')
    add_workers(parser)
    add_excerpt(parser)
    parser.add_argument('--force', action='store_true',
                        help='give up results of other settings in DIR')
    parser.add_argument('--no-figures', action='store_true', help='tables only')
    add_settings(parser)


def add_workers(parser: ArgumentParser) -> None:
    """Give an argparse parser the options --workers and --scheduler, for persem_ros.workers."""
    parser.add_argument('--workers', metavar='N', type=int, default=0,
                        help='processes side by side (default: one per core)')
    parser.add_argument('--scheduler', metavar='ADDRESS', default='',
                        help='let a dask cluster do the work, for example tls://host:8786; '
                             "needs pip install '.[cluster]'")


def methods_of(text: str) -> tuple[str, ...]:
    """Return the methods that an option names."""
    from persem_ros.settings.config import IMAGE_METHODS, METHODS
    return IMAGE_METHODS + METHODS if text == 'all' else \
        tuple(word.strip() for word in text.split(',') if word.strip())


def add_map(parser: ArgumentParser, more: str = '') -> None:
    """Give an argparse parser the argument FILE, a map; *more* follows in its help."""
    parser.add_argument('file', metavar='FILE', help=f'a map file (.persem){more}')
