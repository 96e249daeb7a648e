"""Files: which part of a recording is used, and that there is something in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
import sys

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.inputs.recording.topics import Choice
from persem_ros.preflight.findings import Finding, NOTE, REFUSE
from persem_ros.preflight.sample import Sample, Stamps, View
from persem_ros.preflight.stamps import paired
from persem_ros.settings.config import Config

BESIDE = 5_000_000_000      # ns beside the labels of a part, in which their depth is looked for
ALL = slice(None)
EMPTY = np.zeros(0, np.int64)
LOOKED_AT = 2000            # label images among which the first frame is looked for


def cut(sample: Sample, excerpt: Excerpt) -> None:
    """Leave of the images in *sample* those that the excerpt uses, if there are any."""
    first = None
    if excerpt.needs_first:
        stamps = (_first(view, sample) for view in sample.views)
        first = min((stamp for stamp in stamps if stamp is not None), default=None)
    start, end = excerpt.bounds(first)
    low = -sys.maxsize if start is None else start
    high = sys.maxsize if end is None else end
    offset = round(sample.config.sync.offset_labels * 1e9)
    for view in sample.views:
        labels = view.stamps['labels'] + offset
        inside = (labels >= low) & (labels <= high)
        if not inside.any():        # the reading says so
            continue
        kept = {'labels': inside}
        if 'depth' in view.stamps:
            depth, used = view.stamps['depth'], labels[inside]
            kept['depth'] = (depth >= used.min() - BESIDE) & (depth <= used.max() + BESIDE)
        near = _near(view.stamps, labels[inside], round(sample.config.sync.tolerance * 1e9))
        near['labels'] = inside
        view.firsts = {role: view.within(role, near[role]) or firsts if role in near else firsts
                       for role, firsts in view.firsts.items()}
        view.stamps = {role: stamps[kept.get(role, ALL)] for role, stamps in view.stamps.items()}
        view.times = {role: times[kept.get(role, ALL)] for role, times in view.times.items()}


def _near(stamps: Mapping[str, Stamps], used: Stamps,
          tolerance: int) -> dict[str, NDArray[np.bool_]]:
    """Return which depth images and camera infos are of the time of *used* label images."""
    depth, infos = stamps.get('depth', EMPTY), stamps.get('camera_info', EMPTY)
    before = infos[infos <= used.min()]     # the last of them holds for the first images
    return {'depth': (depth >= used.min() - tolerance) & (depth <= used.max() + tolerance),
            'camera_info': infos >= (before.max() if len(before) else used.min())}


def _first(view: View, sample: Sample) -> int | None:
    """Return the stamp of a camera's first label image with depth and pose."""
    for stamp in paired(view, sample)[:LOOKED_AT].tolist():
        if view.poses.lookup(stamp, view.image_frame).T is not None:
            return int(stamp)
    return None


def as_one(paths: Sequence[str | Path], config: Config) -> str:
    """Return a sentence where several recordings have together what one input needs, else ''."""
    whole = '+'.join(map(str, paths))
    try:
        with Source(whole) as source:
            complete = not Choice(source, config).problems
    except PersemError:
        return ''
    if not complete:
        return ''
    return (f'together they have all that an input needs: {quote(whole)} is one input, with a '
            'space between they are one after the other')


def part(source: Source, config: Config, excerpt: Excerpt) -> Finding:
    """Return how --start, --end and --every were understood, refused where nothing is left."""
    try:
        recording = Recording(source.path, config, source, excerpt)
        sentence, count = excerpt.sentence(recording.bounds), recording.expected
    except PersemError as error:
        return Finding(REFUSE, str(error))
    if not count:
        return Finding(REFUSE, recording.nothing())
    return Finding(NOTE, f'{sentence}: {count} label images')
