"""Confidence images of segmenter and depth camera: can they be read, do they leave anything."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import same_aspect
from persem_ros.inputs.decode import image_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.preflight.findings import Finding, REFUSE, Remedy, WARN
from persem_ros.preflight.lag import distances
from persem_ros.preflight.sample import Sample, View

LABELS, DEPTH = 'confidence', 'depth_confidence'
SOME = 0.01     # share of values above 1
READS: dict[str, Callable[[Any], NDArray[Any]]] = {
    LABELS: image_messages.confidence, DEPTH: image_messages.depth_confidence}
OF = {LABELS: 'labels', DEPTH: 'depth'}


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with confidence images, and settings that need the other."""
    least = sample.config.depth.min_confidence
    for view in sample.views:
        for role in (LABELS, DEPTH):
            if role in view.topics:
                yield from _images(view, role, sample)
        if 'depth' not in view.topics:
            continue
        setting = view.setting(DEPTH)
        if DEPTH in view.topics and not least:
            yield Finding(WARN, f'{view.topics[DEPTH]} is read and leaves nothing out', (Remedy(
                {'depth.min_confidence': 'N'}, 'leaves out what is below N, -N what is above'),))
        elif least and DEPTH not in view.topics:
            yield Finding(WARN, 'depth.min_confidence has no effect without confidence images',
                          (Remedy({setting: 'TOPIC'}, 'names them'),))


def _images(view: View, role: str, sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with one topic."""
    topic, found, fault = view.topics[role], [], None
    for msg in view.firsts.get(role, ()):
        try:
            found.append((msg, READS[role](msg)))
        except BadMessage as error:
            fault = fault or error
    if not found:
        yield Finding(REFUSE, f'confidence images on {topic}: {fault}' if fault else
                      f'{topic} has no message that can be read')
        return
    yield from _size(view, role, found[0][1].shape)
    yield from _partners(view, role, sample)
    if role == DEPTH:
        yield from _left(topic, [values for _, values in found], sample)
    elif max(_beyond(msg) for msg, _ in found) > SOME:
        yield Finding(WARN, f'confidences on {topic} are above 1 and count as 1: expected 0 to 1 '
                            'in 32FC1, 0 to 255 in mono8, 0 to 65535 in mono16')


def _size(view: View, role: str, shape: tuple[int, ...]) -> Iterator[Finding]:
    """Yield that the images are of another size than those that they are about."""
    h, w = shape
    H, W = next((size for msg in view.firsts.get(OF[role], ()) if (size := _shape(msg))), (h, w))
    fits = (h, w) == (H, W) if role == LABELS else same_aspect((w, h), (W, H))
    if not fits:
        yield Finding(REFUSE, f'a confidence image on {view.topics[role]} has the size {w} '
                              f'x {h}, the {OF[role]} have {W} x {H}, '
                              f'expected {"the same" if role == LABELS else "one aspect ratio"}')


def _partners(view: View, role: str, sample: Sample) -> Iterator[Finding]:
    """Yield that no label image has a confidence image of its time."""
    labels = view.stamps['labels'] + round(sample.config.sync.offset_labels * 1e9)
    own = view.stamps[role]
    if sample.live or not len(labels) or not len(own):
        return
    least = int(np.abs(distances(labels, own)).min())
    if least > sample.config.sync.tolerance * 1e9:
        yield Finding(REFUSE, f'no image on {view.topics[role]} is within sync.tolerance '
                              f'({1e3 * sample.config.sync.tolerance:g} ms) of a label image, the '
                              f'nearest is {least / 1e6:.0f} ms away')


def _left(topic: str, values: list[NDArray[Any]], sample: Sample) -> Iterator[Finding]:
    """Yield that depth.min_confidence leaves out every pixel."""
    least = sample.config.depth.min_confidence
    numbers = np.concatenate([image.ravel() for image in values])
    if least and not ((numbers if least > 0 else -numbers) >= least).any():
        yield Finding(REFUSE, f'depth.min_confidence={least:g} leaves out all pixels: the values '
                              f'on {topic} are {np.nanmin(numbers):g} to {np.nanmax(numbers):g}',
                      (Remedy({'depth.min_confidence': f'{-least:g}'},
                              f'where {"large" if least > 0 else "small"} is bad'),))


def _beyond(msg: Any) -> float:
    """Return the share of a 32FC1 image's values above 1."""
    if getattr(msg, 'encoding', '') != '32FC1':
        return 0.0
    return float(np.mean(np.frombuffer(msg.data, '>f4' if msg.is_bigendian else '<f4') > 1.0))


def _shape(msg: Any) -> tuple[int, int] | None:
    """Return (H, W) of an image, None where it has none or is compressed."""
    return (msg.height, msg.width) if hasattr(msg, 'encoding') else None
