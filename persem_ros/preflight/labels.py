"""Label images: whether they can be read as ids, and whether they fit the depth."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import MAX_ID
from persem_ros.inputs import fit
from persem_ros.inputs.assemble import Assembler, is_cloud, other_camera_sentence
from persem_ros.inputs.decode import clouds, image_messages
from persem_ros.inputs.decode.labels import LabelReader, LEGEND, NEAREST
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.placing import SAME
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, Remedy, WARN
from persem_ros.preflight.sample import Sample, View
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

SOME = 0.01     # share of pixels whose id is no class
FEW, MANY = 8, 100      # different ids
SHOWN = 40      # ids in a line
ODD = 0.5       # share of pixels whose id is no class: no labels at all


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with the first label images."""
    for view in sample.views:
        yield from _view(view, sample.config, sample.legend)


def ids_in(sample: Sample) -> list[str]:
    """Return which ids the first label images of each camera have and what they are called."""
    lines = []
    for view in sample.views:
        reader, seen = LabelReader(sample.config.labels), []
        for msg in view.firsts.get('labels', ()):
            with suppress(BadMessage):
                seen.append(_read(msg, sample.config, sample.legend, reader))
        legend = sample.own_legend or Legend()
        ids = sorted({c for image in seen for c in np.unique(image).tolist()})
        words = [f'{c} {legend.name(c)}' if c in legend.ids else str(c) for c in ids]
        more = f' and {len(words) - SHOWN} more' if len(words) > SHOWN else ''
        lines.append(f'ids in {len(seen)} label images on {view.topics["labels"]}: '
                     f'{", ".join(words[:SHOWN])}{more}')
    return lines


def _read(msg: Any, config: Config, legend: Legend | None, reader: LabelReader
          ) -> NDArray[np.int32]:
    """Return the ids of a label image or a labelled cloud."""
    if is_cloud(msg):
        return clouds.labels(clouds.structured(msg), config.points.label_field)
    return reader(msg, legend)[0]


def _view(view: View, config: Config, legend: Legend | None) -> Iterator[Finding]:
    faults, sizes, seen = [], [], []
    reader = LabelReader(config.labels)
    for msg in view.firsts.get('labels', ()):
        try:
            ids = _read(msg, config, legend, reader)
            sizes.append(ids.shape)
            seen.append(ids)
        except BadMessage as fault:
            faults.append(fault)
    if not sizes:
        what = f'label images on {view.topics["labels"]}: {faults[0]}' if faults else \
            f'{view.topics["labels"]} has no message that can be read'
        yield Finding(REFUSE, what)
        return
    if reader.channel == LEGEND and reader.off > (1 - NEAREST) * reader.pixels:
        yield Finding(REFUSE, f'{100 * reader.off / reader.pixels:.0f} % of the pixels on '
                              f"{view.topics['labels']} have a colour that is none of the "
                              "legend's: another topic, or another legend (labels.legend)?")
    elif reader.note:
        yield Finding(WARN if reader.off else NOTE, reader.note)
    yield from _ids(np.concatenate([ids.ravel() for ids in seen]), view, config, legend)
    other = _other_camera(view)
    if other:
        yield from other
        return
    for msg in view.firsts.get('depth', ()):
        if is_cloud(msg):
            return
        try:
            size = Assembler(config).depth(msg).shape
        except BadMessage:      # check_depth says so
            continue
        try:
            fit.matching(sizes[0], size, config.labels.fit)
        except BadMessage as fault:
            yield Finding(REFUSE, str(fault))
        return


def _ids(ids: NDArray[np.int32], view: View, config: Config,
         legend: Legend | None) -> Iterator[Finding]:
    """Yield what the ids of some label images look like, if not like classes."""
    topic = view.topics['labels']
    large = float(np.mean(ids > MAX_ID))
    ids = ids[(ids >= 0) & ~np.isin(ids, config.memory.ignore_labels)]
    found = np.unique(ids)
    instances = (Remedy({'labels.divisor': '1000'}, 'where an id is class * 1000 + number'),)
    if large > SOME:
        yield Finding(REFUSE if large > ODD else WARN,
                      f'{100 * large:.0f} % of the ids on {topic} are above {MAX_ID}, which is '
                      'no class', instances)
    elif len(found) > FEW and found[0] >= 1000 and len(np.unique(found // 1000)) < len(found) / 2:
        surely = legend is not None and not np.isin(found, legend.ids).any() and \
            np.isin(found // 1000, legend.ids).all()
        yield Finding(REFUSE if surely else WARN,
                      f'there are {len(found)} ids on {topic}, {found[0]} to {found[-1]}, '
                      'as if they were of instances' + (
                          ', and none of them is in the legend' if surely else ''), instances)
    elif len(found) > MANY and found[-1] <= 255:
        yield Finding(WARN, f'there are {len(found)} ids in a few images on {topic}: is it a grey '
                            'image?', (Remedy({view.setting('labels'): 'TOPIC'},
                                              'names another topic'),))
    elif found.tolist() == [0] and 255 in config.memory.ignore_labels and len(ids) and \
            any(_is_mask(msg) for msg in view.firsts['labels']):
        rest = [str(c) for c in config.memory.ignore_labels if c != 255] or ['65535']
        yield Finding(WARN, f'the ids on {topic} are 0 and 255: if they are a mask, 255 is a '
                            'class and no pixel to be ignored',
                      (Remedy({'memory.ignore_labels': f'[{",".join(rest)}]'}, 'counts it'),))


def _is_mask(msg: Any) -> bool:
    """Return whether an image has the ids 0 and 255 and no others."""
    if is_cloud(msg):
        return False
    try:
        return set(np.unique(image_messages.labels(msg)[0]).tolist()) == {0, 255}
    except BadMessage:
        return False


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
