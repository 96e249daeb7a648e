"""Stamps: whether label images find their depth and their pose, and what is in the way."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from persem_ros.inputs.sync.no_pose import explain
from persem_ros.inputs.sync.poses import NO_MOUNT, UNSAID
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, WARN
from persem_ros.preflight.lag import distances
from persem_ros.preflight.sample import Sample, Stamps, View

NAMES = {'labels': 'label images', 'depth': 'depth images', 'pose': 'poses'}
NEEDED = 'depth', 'confidence', 'depth_confidence'
SOME = 0.1              # of the frames: fewer without a pose are said after the mapping
MOST = 500              # frames whose pose is looked up
OFF = 1.0               # s between two clocks, by that of the recorder
SAID = {NO_MOUNT, UNSAID}
STEADY = 0.2            # s that the way to the recorder may vary where clocks are compared


def check(sample: Sample) -> Iterator[Finding]:
    """Yield why label images would find no depth or no pose."""
    for view in sample.views:
        zeros = list(_zeros(view))
        apart = [] if zeros else list(_overlap(view, sample))
        yield from zeros + apart
        if not zeros and not apart:
            yield from _clocks(view)
            yield from _poses(view, sample)
        for note in () if sample.live else view.poses.notes.values():
            yield Finding(NOTE, note)


def _zeros(view: View) -> Iterator[Finding]:
    """Yield the topics without stamps."""
    for role, name in NAMES.items():
        stamps = view.stamps.get(role, np.zeros(0, np.int64))
        zero = int(np.count_nonzero(stamps == 0))
        if len(stamps) > 1 and 2 * zero > len(stamps):
            topic = view.topics.get(role, '/tf')
            yield Finding(REFUSE, f'{zero} of {len(stamps)} {name} on {topic} have the stamp 0: '
                                  'nothing says which belong together; whoever publishes them '
                                  'has to fill header.stamp (that of the image they were made of)')


def _overlap(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield the topics whose stamps are of another time than those of the label images."""
    labels = view.stamps['labels'] + round(sample.config.sync.offset_labels * 1e9)
    depth = view.stamps.get('depth', np.zeros(0, np.int64))
    # Poses are asked for when depth was measured, also where the labels' stamps are others.
    for role, name, own in (('depth', 'label images', labels), (
            'pose', *(('depth images', depth) if len(depth) else ('label images', labels)))):
        other = view.stamps.get(role, np.zeros(0, np.int64))
        if not len(own) or not len(other) or sample.live:
            continue
        gap = max(int(other.min() - own.max()), int(own.min() - other.max()))
        slack = max(sample.config.sync.tolerance, sample.config.pose.max_gap)
        if gap > slack * 1e9 and not (role == 'depth' and fits_shifted(view, sample)):
            yield Finding(REFUSE, f'the {name} are stamped {_span(own)}, the '
                                  f'{NAMES[role]} on {view.topics.get(role, "/tf")} '
                                  f'{_span(other)}, {gap / 1e9:.1f} s apart: they are of '
                                  'different clocks or times (use_sim_time everywhere, chrony, '
                                  'PTP)')


def fits_shifted(view: View, sample: Sample) -> bool:
    """Return whether one offset brings labels to depth, so that preflight.lag names it."""
    labels, depth = np.unique(view.stamps['labels']), np.unique(view.stamps['depth'])
    tolerance = round(sample.config.sync.tolerance * 1e9)
    shifted = labels - (labels[0] - depth[0])
    return bool(np.mean(np.abs(distances(shifted, depth)) <= tolerance) >= 0.9)


def _clocks(view: View) -> Iterator[Finding]:
    """Yield poses whose clock is seconds from that of the depth, as the recorder saw them."""
    late = {}
    for role in ('depth', 'pose'):
        if not len(view.stamps.get(role, ())):
            return
        ways = (view.times[role] - view.stamps[role]) / 1e9
        low, middle, high = np.percentile(ways, (10, 50, 90))
        if high - low > STEADY:
            return
        late[role] = float(middle)
    off = late['depth'] - late['pose']
    if abs(off) > OFF:
        yield Finding(WARN, f'the stamps of {view.topics.get("pose", "/tf")} are {abs(off):.1f} s '
                            f'{"ahead of" if off > 0 else "behind"} those of '
                            f'{view.topics["depth"]} by the clock of the recorder: if the clocks '
                            'differ, every frame gets the pose of another moment (chrony, PTP, '
                            'use_sim_time everywhere)')


def _poses(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield why many of the frames would have no pose."""
    stamps = paired(view, sample)
    if not len(stamps) or 'pose' in view.topics and view.poses.poses is None:
        return
    stamps = stamps[np.linspace(0, len(stamps) - 1, min(len(stamps), MOST)).astype(int)]
    reasons: Counter[str] = Counter()
    first: dict[str, int] = {}
    for stamp in stamps.tolist():
        found = view.poses.lookup(stamp, view.image_frame)
        if found.T is None:
            reasons[found.reason] += 1
            first.setdefault(found.reason, stamp)
    if reasons.keys() & SAID or unconnected(view, sample):
        return      # frames.py and poses.py say it
    if reasons.total() > SOME * len(stamps) or reasons.total() == len(stamps):
        reason = max(reasons, key=lambda name: reasons[name])
        severity = REFUSE if reasons.total() == len(stamps) and not sample.live else WARN
        yield Finding(severity, f'{reasons.total()} of {len(stamps)} frames have no pose '
                                f'({reason}): '
                                f'{explain(view.poses, first[reason], view.image_frame)}')


def unconnected(view: View, sample: Sample) -> bool:
    """Return whether transforms are all that places a camera, and do not."""
    return sample.config.pose.source == 'tf' and not sample.live and \
        not view.poses.tree.connected(sample.config.frames.map, view.image_frame)


def paired(view: View, sample: Sample) -> Stamps:
    """Return the stamps of the label images that find depth, ns, ascending."""
    labels = np.unique(view.stamps['labels']) + round(sample.config.sync.offset_labels * 1e9)
    if 'depth' not in view.topics:      # labelled clouds need none
        return labels
    if not len(labels) or not len(view.stamps['depth']):
        return labels[:0]
    tolerance = round(sample.config.sync.tolerance * 1e9)
    for role in [role for role in NEEDED if role in view.topics]:
        if not len(labels) or not len(view.stamps[role]):
            return labels[:0]
        labels = labels[np.abs(distances(labels, view.stamps[role])) <= tolerance]
    return labels


def usable(view: View, sample: Sample) -> tuple[int, int]:
    """Return how many label images a replay would use, and of how many that were looked at."""
    stamps, total = paired(view, sample), len(view.stamps['labels'])
    some = stamps[np.linspace(0, len(stamps) - 1, min(len(stamps), MOST)).astype(int)]
    placed = sum(view.poses.lookup(stamp, view.image_frame).T is not None
                 for stamp in some.tolist())
    return round(placed * len(stamps) / max(len(some), 1)), total


def _span(stamps: Stamps) -> str:
    return f'{stamps.min() / 1e9:.3f} to {stamps.max() / 1e9:.3f} s'
