"""Depth images and their camera infos: whether they can be read, and as what."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
import re
from typing import Any

import numpy as np
from persem_ros.inputs.assemble import Assembler, is_cloud
from persem_ros.inputs.decode import image_messages
from persem_ros.inputs.decode.camera import check as check_info
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.preflight import axes_fit
from persem_ros.preflight.depth_fit import about_depth, Seen
from persem_ros.preflight.emptiness import Emptiness
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, Remedy, WARN
from persem_ros.preflight.sample import Sample, Shot, Stamps, View

FULL = 65535            # of 16UC1
SOME = 0.005            # share of the depths that are one number …
BEYOND = 1.5            # … and so many times farther than (almost) all others
MANY = 100              # depth images among which one in range is looked for
ANCHORS = 4             # places of a recording
STEPS = (0, 1, 3, 8)    # frames from there
DISPARITIES = re.compile(r'(^|[/_])disparit(y|ies)($|[/_]image|/)', re.IGNORECASE)


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what is wrong with the first depth images and camera infos."""
    for view in sample.views:
        if 'camera_info' not in view.topics:
            continue            # of a labelled cloud
        if not is_cloud_of(view):
            yield from _unreadable(view, 'depth', 'depth images', Assembler(sample.config).depth)
            yield from _disparity(view, sample)
        yield from _unreadable(view, 'camera_info', 'camera infos',
                               lambda msg: check_info(msg, sample.config.camera.rectified))
        if not is_cloud_of(view):
            yield from _unfitting(view, sample)


def check_fit(sample: Sample) -> Iterator[Finding]:
    """Yield what looks wrong with the depth where frames with poses see one place."""
    for view in sample.views:
        if 'depth' not in view.topics or is_cloud_of(view):
            continue
        stamps = _spread(np.unique(view.stamps['depth']))
        placed = {}
        for stamp in stamps:
            T = view.poses.lookup(stamp, view.image_frame).T
            if T is not None:
                placed[stamp] = T
        shots = view.shots(placed, sample.config)
        seen = [Seen(*shots[stamp], T) for stamp, T in placed.items() if stamp in shots]
        yield from _nothing(view, shots, stamps, sample)
        yield from _no_measurements(shots, _unit(view, sample.config.depth.scale), sample)
        axes = list(axes_fit.check(view, sample, seen))
        yield from axes
        if axes or _of_stereo(view):
            continue
        for sentence in about_depth(seen, sample.config, _unit(view, sample.config.depth.scale)):
            yield Finding(WARN, sentence)


def _nothing(view: View, shots: Mapping[int, Shot], stamps: list[int],
             sample: Sample) -> Iterator[Finding]:
    """Yield that no depth is in range, in a few images and then in many."""
    emptiness = Emptiness(sample.config.memory)
    images = [shot.depth for shot in shots.values()]
    for image in images:
        emptiness.depth(image)
    if not images or not emptiness.of_depth():
        return
    every = np.unique(view.stamps['depth'])
    every = every[np.linspace(0, len(every) - 1, min(len(every), MANY)).astype(int)]
    for shot in view.shots(set(every.tolist()) - set(stamps), sample.config).values():
        emptiness.depth(shot.depth)
    if emptiness.of_depth():
        yield Finding(WARN if sample.live else REFUSE,
                      f'{view.topics["depth"]}: {emptiness.of_depth()}')


def _disparity(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield disparities in place of depth, and that they are of rectified images."""
    settings, topic = sample.config.depth, view.topics['depth']
    of_stereo = _of_stereo(view)
    if settings.kind == 'z' and not settings.scale and not of_stereo and \
            DISPARITIES.search(topic):
        products = sorted(sample.stereo.items())
        value = f'{products[0][1]:.6g}' if products else 'F*B'
        known = f', {value} by {products[0][0]}' if products else ''
        yield Finding(REFUSE, f'{topic} holds disparities by its name; as depth they need focal '
                              f'length (pixels) x baseline (m){known}',
                      (Remedy({'depth.kind': 'disparity', 'depth.scale': value}),
                       Remedy({'depth.scale': '1'}, 'if they are metres')))
    elif (of_stereo or settings.kind == 'disparity') and not sample.config.camera.rectified and \
            any(np.any(info.d) for info in view.firsts.get('camera_info', ())):
        yield Finding(NOTE, f'disparities are of rectified images, so P of '
                            f'{view.topics["camera_info"]} is used and D is not',
                      takes={'camera.rectified': 'true'})


def _of_stereo(view: View) -> bool:
    """Return whether a camera's depth comes as stereo_msgs/DisparityImage."""
    return any(map(image_messages.is_disparity, view.firsts.get('depth', ())))


def is_cloud_of(view: View) -> bool:
    """Return whether a camera's depth comes from a LiDAR."""
    return any(map(is_cloud, view.firsts.get('depth', ())))


def _spread(stamps: Stamps) -> list[int]:
    """Return stamps of frames that are near each other, from several places of a recording."""
    anchors = np.linspace(0, max(len(stamps) - 1, 0), ANCHORS + 2)[1:-1].astype(int)
    numbers = np.unique([a + step for a in anchors for step in STEPS])
    return stamps[numbers[(numbers >= 0) & (numbers < len(stamps))]].tolist()


def _unit(view: View, scale: float) -> float:
    """Return the metres per unit with which a camera's depth images are read."""
    if _of_stereo(view):
        return 1.0
    encoding = getattr(view.firsts['depth'][0], 'encoding', '') or '16UC1'
    return image_messages.unit_of(np.dtype(image_messages.DEPTH.get(encoding, 'u2')), scale)


def _unfitting(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield why no first depth image goes with its camera info, where both can be read."""
    assembler, fault, some, camera = Assembler(sample.config), None, False, None
    for info in view.firsts.get('camera_info', ()):
        with suppress(BadMessage):
            assembler.add_info(info)
    if assembler.frame_id is None:
        return
    for msg in view.firsts.get('depth', ()):
        try:
            assembler.depth(msg)
        except BadMessage:      # said already
            continue
        try:
            _, camera = assembler.seen(msg)
            some = True
        except BadMessage as error:
            fault = fault or error
    if camera is not None and not (0.0 <= camera.K[0, 2] <= camera.width
                                   and 0.0 <= camera.K[1, 2] <= camera.height):
        yield Finding(WARN, f'{view.topics["camera_info"]}: the optical axis meets the image at '
                            f'({camera.K[0, 2]:.4g}, {camera.K[1, 2]:.4g}), outside of the '
                            f'{camera.width} x {camera.height} pixels of the depth: is K that of '
                            'another resolution?',
                      (Remedy({view.setting('camera_info'): 'TOPIC'}, 'names another topic'),))
    if fault and some:
        yield Finding(WARN, f'some images on {view.topics["depth"]} cannot be used with '
                            f'{view.topics["camera_info"]}: {fault}')
    elif fault:
        yield Finding(REFUSE, f'{view.topics["depth"]} with {view.topics["camera_info"]}: {fault}',
                      (Remedy({view.setting('camera_info'): 'TOPIC'}, 'names another topic'),))


def _no_measurements(shots: Mapping[int, Shot], unit: float, sample: Sample) -> Iterator[Finding]:
    """Yield a largest depth that stands for "nothing": a full number, or a far plane."""
    images = [shot.depth for shot in shots.values()]
    top = max((image.max(initial=0.0) for image in images), default=0.0)
    if not 0.0 < top <= sample.config.memory.max_depth:
        return
    count = sum(np.count_nonzero(image) for image in images)
    share = sum(np.count_nonzero(image == top) for image in images) / count
    if share < SOME:
        return
    rest = np.concatenate([image[(image > 0.0) & (image < top)] for image in images])
    full = np.isclose(top, FULL * unit)
    if not rest.size or not (full or top > BEYOND * np.percentile(rest, 99)):
        return
    what = f'{FULL}, the largest number that there is' if full else \
        'the same largest number, as if there were nothing (sky, a far plane)'
    yield Finding(WARN, f'{100 * share:.1f} % of the depths are {top:.4g} m, {what}',
                  (Remedy({'memory.max_depth': f'{0.99 * top:.3g}'}, 'leaves them out'),))


def _unreadable(view: View, role: str, what: str,
                read: Callable[[Any], Any]) -> Iterator[Finding]:
    """Yield why no first message of a role can be used."""
    fault = None
    for msg in view.firsts.get(role, ()):
        try:
            read(msg)
            return
        except BadMessage as error:
            fault = fault or error
    yield Finding(REFUSE, f'{what} on {view.topics[role]}: {fault}' if fault else
                  f'{view.topics[role]} has no message that can be read')
