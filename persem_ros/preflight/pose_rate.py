"""Do poses come often enough? They tell themselves: leave one out, and see what is missed."""

from collections.abc import Iterator

import numpy as np
from persem_ros.core.transforms import quaternions, slerps
from persem_ros.inputs.sync.track import Track
from persem_ros.preflight.findings import Finding, Remedy, WARN
from persem_ros.preflight.sample import Sample, View

SLOW = 0.15         # s between poses, below which what is missed is noise rather than motion
LEAST = 3           # poses that are left out, at least
SHARE = 90          # percentile of what is missed
TURN = 2.0          # degrees that may be missed: 0.7 m at 20 m


def check_rate(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield what comes too seldom for how the camera moves: its poses, or a link of /tf."""
    track, target = view.poses.poses, sample.config.frames.map
    tracks = [(track, f'poses on {view.topics["pose"]}')] if track and 'pose' in view.topics \
        else [(link, f'the transform {link.parent} -> {child} on /tf')
              for link, child in view.poses.tree.links(target, view.image_frame)]
    for one, what in tracks:
        yield from _missed(one, what, sample.config.memory.voxel_size)


def _missed(track: Track, what: str, voxel_size: float) -> Iterator[Finding]:
    """
    Yield what samples miss that are interpolated between their neighbours.

    At an acceleration a and g seconds between samples, one that is left out is missed by
    ``a g² / 2``, and the middle between two that are there by a quarter of that.

    """
    stamps = np.array(track.stamps, np.float64) / 1e9
    if len(stamps) < LEAST + 2 or np.median(np.diff(stamps)) < SLOW:
        return
    T = np.array(track.transforms)
    q, xyz = quaternions(T[:, :3, :3]), T[:, :3, 3]
    fraction = ((stamps[1:-1] - stamps[:-2]) / (stamps[2:] - stamps[:-2]))[:, None]
    between = slerps(q[:-2], q[2:], fraction)
    turned = np.degrees(2 * np.arccos(np.minimum(np.abs((between * q[1:-1]).sum(axis=1)), 1.0)))
    moved = np.hypot.reduce(xyz[:-2] + fraction * (xyz[2:] - xyz[:-2]) - xyz[1:-1], axis=1)
    metres, degrees = (float(np.percentile(missed, SHARE)) / 4 for missed in (moved, turned))
    if metres <= voxel_size and degrees <= TURN:
        return
    gap = float(np.median(np.diff(stamps)))
    yield Finding(WARN, f'{what}: one every {gap:.2g} s; interpolated between them the camera '
                        f'is off by up to {metres:.2g} m and {degrees:.2g} degrees (told by '
                        'leaving out one at a time), and so is what it sees: 10 Hz or more are '
                        'better', (Remedy({'pose.max_gap': f'{0.9 * gap:.2g}'},
                                          'uses frames at the stamps of poses alone'),))
