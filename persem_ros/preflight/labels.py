"""Label images: whether they can be read as ids, and whether they fit the depth."""

from collections.abc import Iterator

import numpy as np
from persem_ros.inputs import fit
from persem_ros.inputs.assemble import is_cloud, other_camera_sentence
from persem_ros.inputs.decode import clouds, messages
from persem_ros.inputs.decode.labels import LabelReader, LEGEND
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.intake import SAME
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, WARN
from persem_ros.preflight.sample import Sample, View
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

ODD = 0.5       # share of pixels in colours that are none of the legend's: no labels at all


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with the first label images."""
    for view in sample.views:
        yield from _view(view, sample.config, sample.legend)


def _view(view: View, config: Config, legend: Legend | None) -> Iterator[Finding]:
    faults, sizes = [], []
    reader = LabelReader(config.labels)
    for msg in view.firsts.get('labels', ()):
        try:
            sizes.append(clouds.labels(clouds.structured(msg), config.points.label_field).shape
                         if is_cloud(msg) else reader(msg, legend)[0].shape)
        except BadMessage as fault:
            faults.append(fault)
    if not sizes:
        what = f'label images on {view.topics["labels"]}: {faults[0]}' if faults else \
            f'{view.topics["labels"]} has no message that can be read'
        yield Finding(REFUSE, what)
        return
    if reader.channel == LEGEND and reader.off > ODD * reader.pixels:
        yield Finding(REFUSE, f'{100 * reader.off / reader.pixels:.0f} % of the pixels on '
                              f"{view.topics['labels']} have a colour that is none of the "
                              "legend's: another topic, or another legend (labels.legend)?")
    elif reader.off:
        yield Finding(WARN, reader.note)
    other = _other_camera(view)
    if other:
        yield from other
        return
    for msg in view.firsts.get('depth', ()):
        if is_cloud(msg):
            return
        try:
            size = messages.depth(msg).shape
        except BadMessage:      # check_depth says so
            continue
        try:
            fit.matching(sizes[0], size, config.labels.fit)
        except BadMessage as fault:
            yield Finding(REFUSE, str(fault))
        return


def _other_camera(view: View) -> list[Finding]:
    """Return what labels of another camera than the depth need, [] where they are of the same."""
    labels, depth = view.frame('labels'), view.frame('depth')
    stamps = view.stamps.get('labels', ())
    if not labels or not depth or labels == depth or not len(stamps):
        return []
    tie = view.poses.tie(labels, depth, int(stamps[len(stamps) // 2])).T
    if is_cloud(view.firsts['depth'][0]):
        return [] if tie is not None else [Finding(
            REFUSE, f'the clouds on {view.topics["depth"]} are in the frame {depth!r}, the '
                    f'labels in {labels!r}, and /tf_static does not connect them')]
    if tie is None:     # frames.py says so
        return []
    if np.abs(tie - np.eye(4)).max() <= SAME:
        return []
    if 'labels_info' in view.topics:
        return [Finding(NOTE, f'the labels are in the frame {labels!r}, the depth is in '
                              f'{depth!r}: '
                              'each depth pixel takes the label where it lies in the label image '
                              f'(intrinsics on {view.topics["labels_info"]})')]
    return [Finding(REFUSE, other_camera_sentence(labels, depth, tie))]
