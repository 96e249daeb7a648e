"""persem info: what is in a recording and what a replay would use of it."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from persem_ros.commands.options import add_excerpt, add_settings

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    from persem_ros.settings.config import Config


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'info', help='show what is in a recording and what a replay would use',
        description='Lists topics, types, counts, rates, encodings, sizes, frames and stamps of '
                    'a rosbag2 recording, which of them a replay would use, and what is missing, '
                    'as flags to paste. The exit status is 1 when something needed is missing.')
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='rosbag2 folder, .mcap or .db3 file; A+B is one input in two '
                             'recordings, A B are two')
    add_excerpt(parser)
    add_settings(parser)
    parser.set_defaults(run=run)


def run(args: Namespace) -> int:
    """Print a report of each input; return 0 where a replay can use all of them, else 1."""
    from persem_ros.preflight.files import as_one
    from persem_ros.settings import config_file

    config = config_file.from_args(args.config, args.set_items)
    lacking = [_report(bag, args, config) for bag in args.bags]
    if any(lacking) and len(args.bags) > 1 and (sentence := as_one(args.bags, config)):
        print(f'note: {sentence}')
    return 1 if any(lacking) else 0


def _report(bag: str, args: Namespace, config: Config) -> bool:
    """Print the report of an input; return whether something needed is missing."""
    import sys

    from persem_ros.commands.options import excerpt_of
    from persem_ros.guard import limits
    from persem_ros.inputs.recording.excerpt import WHOLE
    from persem_ros.inputs.recording.source import Source
    from persem_ros.inputs.recording.topics import Choice
    from persem_ros.preflight import contents, contents_text, recorded
    from persem_ros.preflight.files import cut, part
    from persem_ros.preflight.findings import of_severity, REFUSE, WARN
    from persem_ros.preflight.labels import ids_in
    from persem_ros.preflight.look import look, takes_of
    from persem_ros.preflight.stamps import usable
    from tqdm import tqdm

    limits.use(config.inputs.max_pixels)
    with Source(bag) as source:
        total = sum(topic.count for topic in source.topics)
        rows = contents.survey(source, lambda it: tqdm(
            it, total=total, unit=' messages', leave=False, dynamic_ncols=True,
            disable=not sys.stderr.isatty()))
        choice = Choice(source, config)
        found, counts, ids, excerpt = [], [], [], excerpt_of(args)
        if not choice.problems:
            sample = recorded.sample(source, choice, config)
            if excerpt != WHOLE:
                cut(sample, excerpt)
            found = look(sample)
            ids = ids_in(sample)
            counts = [usable(view, sample) for view in sample.views]
        if excerpt != WHOLE and not choice.problems and not of_severity(found, REFUSE):
            found.append(part(source, sample.config, excerpt))
        lacking = choice.problems + [f.text() for f in of_severity(found, REFUSE)]
        if not lacking and not any(used for used, _ in counts):
            lacking = ['no label image finds its depth and its pose']
        words = [word for item in args.set_items for word in ('--set', item)]
        words += ['--config', args.config] if args.config else []
        words += [word for item in takes_of(found).items() for word in ('--set', '='.join(item))]
        words = excerpt.words() + words
        proposed = {k: v for f in of_severity(found, WARN) for k, v in f.proposal.items()}
        warned = [word for item in proposed.items() for word in ('--set', '='.join(item))]
        print(contents_text.text(source, rows, choice, lacking, found, counts, words, warned,
                                 ids),
              end='')
    return bool(lacking)
