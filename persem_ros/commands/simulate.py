"""persem simulate: a recording of a flight over a made-up town and forest."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import _SubParsersAction, Namespace

    from persem_ros.simulate.flight import Shot
    from persem_ros.simulate.plan import Plan

# Option, field of simulate.plan.Plan or of one of its parts, type, unit, help.
NUMBERS = (
    ('--seed', 'seed', int, 'N', 'another world, path and noise; the same seed gives the same '
                                 'bytes'),
    ('--frames', 'frames', int, 'N', 'images'),
    ('--rate', 'rate', float, 'HZ', 'images per second'),
    ('--height', 'altitude', float, 'M', 'height of flight'),
    ('--speed', 'speed', float, 'M/S', 'speed of flight'),
    ('--fov', 'field_of_view', float, 'DEG', 'horizontal field of view'),
    ('--tilt', 'tilt', float, 'DEG', 'how far the camera looks below the horizon; 90: straight '
                                     'down'),
    ('--voxel-scale', 'voxel_scale', float, 'X', 'factor on the voxels that a frame touches, '
                                                 'through the height of flight'),
    ('--difficulty', 'mistakes.difficulty', float, 'X', "factor on the segmenter's mistakes; "
                                                        '0: none'),
    ('--depth-noise', 'depth_errors.scale', float, 'X', 'factor on noise and holes of the depth; '
                                                        '0: exact'),
    ('--pose-noise', 'pose_errors.noise', float, 'M', 'white noise of the recorded positions'),
    ('--attitude-noise', 'pose_errors.attitude', float, 'DEG', 'white noise of the recorded '
                                                               'attitude'),
    ('--pose-drift', 'pose_errors.drift', float, 'M', 'wander of the recorded positions after '
                                                      '100 m of flight'),
    ('--loop-closure', 'pose_errors.odometry', float, 'X', 'poses drift as those of a dead '
     'reckoning, X times (1 degree after 100 m); the path that closing the loop gives comes at '
     'the end on /corrected_path, true poses are on /true_pose'),
)


class DefaultsFormatter(argparse.HelpFormatter):
    """Adds the defaults of the plan to the help of its options, loaded only to be shown."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        """Return an option's help with its default."""
        name = {option: name for option, name, *_ in NUMBERS}.get(action.option_strings[-1]
                                                                  if action.option_strings else '')
        if name is None and action.dest != 'size':
            return action.help
        from persem_ros.simulate.plan import Plan
        plan = Plan()
        value = f'{plan.width}x{plan.height}' if name is None else f'{attrgetter(name)(plan):g}'
        return f'{action.help} (default: {value})'


def add_parser(subparsers: _SubParsersAction[Any]) -> None:
    """Add the sub-command and its options."""
    parser = subparsers.add_parser(
        'simulate', help='record a simulated flight over a made-up town and forest',
        description='Writes a rosbag2 recording of an aircraft over a made-up town and forest: '
                    'noisy labels and depth, truth, colour, camera info, poses of the body at '
                    '100 Hz, /tf and the legend. persem replay reads it without further options.',
        formatter_class=DefaultsFormatter,
        epilog='example: persem simulate flight --frames 300 --seed 7')
    parser.add_argument('out', metavar='OUT', help='folder of the recording')
    for option, _, kind, unit, text in NUMBERS:
        optional = {'nargs': '?', 'const': 1.0} if option == '--loop-closure' else {}
        parser.add_argument(option, type=kind, metavar=unit, help=text, **optional)
    parser.add_argument('--size', type=_size, metavar='WxH', help='of the images, in pixels')
    parser.add_argument('--no-noise', action='store_true',
                        help='exact labels, depth and poses, whatever the other options say')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                        help='storage of the recording (default: mcap)')
    parser.add_argument('--compress', action='store_true', help='compress it (Zstandard)')
    parser.add_argument('--force', action='store_true', help='replace an earlier recording')
    parser.set_defaults(run=run)


def run(args: Namespace) -> None:
    """Simulate the flight and write the recording."""
    from pathlib import Path
    import sys
    import time

    from persem_ros.errors import PersemError
    from persem_ros.outputs.recording.target import check_target
    from persem_ros.outputs.recording.writer import RecordingWriter
    from tqdm import tqdm
    try:
        from persem_ros.simulate.flight import Flight
    except ImportError as error:
        raise PersemError(f'the simulator needs trimesh and embreex ({error}); install them '
                          'with: pip install trimesh embreex') from error
    check_target(Path(args.out), args.force)        # before the world is built
    begin = time.perf_counter()
    flight = Flight(plan_of(args))

    def progress(shots: Iterator[Shot]) -> Iterable[Shot]:
        return tqdm(shots, 'simulating', flight.plan.frames, unit=' frames',
                    disable=not sys.stderr.isatty())

    with RecordingWriter(args.out, args.storage, args.compress, args.force) as writer:
        flight.record(writer, progress)
    plan = flight.plan
    print(f'{plan.frames} frames of {plan.width}x{plan.height}, '
          f'{plan.frames * plan.speed / plan.rate:.0f} m of flight, in '
          f'{time.perf_counter() - begin:.1f} s: {args.out}')


def plan_of(args: Namespace) -> Plan:
    """Return the simulate.flight.Plan of the options; those not given keep their defaults."""
    from dataclasses import replace

    from persem_ros.simulate.plan import Plan
    plan = Plan()
    if args.size:
        plan = replace(plan, width=args.size[0], height=args.size[1])
    for option, name, _, _, _ in NUMBERS:
        value = getattr(args, option[2:].replace('-', '_'))
        if value is None:
            continue
        part, _, field = name.rpartition('.')
        if part:
            plan = replace(plan, **{part: replace(getattr(plan, part), **{field: value})})
        else:
            plan = replace(plan, **{name: value})
    return plan.without_errors() if args.no_noise else plan


def _size(text: str) -> tuple[int, int]:
    """Return (width, height) of a text like 640x480."""
    width, cross, height = text.lower().partition('x')
    if not (cross and width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f'expected WIDTHxHEIGHT, as in 640x480, got {text!r}')
    return int(width), int(height)
