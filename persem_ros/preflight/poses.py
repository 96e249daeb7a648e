"""What the poses place: the camera or the body that carries it, told by depth that agrees."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.agreement import misses, WORST
from persem_ros.core.transforms import inverse
from persem_ros.inputs.decode import pose_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.sync.mount import bodies, unsaid
from persem_ros.inputs.sync.no_pose import mount_sentence
from persem_ros.inputs.sync.poses import NO_MOUNT
from persem_ros.inputs.sync.track import SLACK, Track
from persem_ros.preflight.depth import is_cloud_of
from persem_ros.preflight.findings import Finding, NOTE, REFUSE, Remedy, WARN
from persem_ros.preflight.pose_rate import check_rate
from persem_ros.preflight.sample import Sample, Shot, View

TURNED = 10.0, 60.0     # degrees between two views that tell readings apart and still overlap
PAIRS, FEW = 10, 5      # compared where nothing says what poses place, and where something does
WITHIN = 60             # frames between two of a pair
LOOKED_AT = 300         # frames among which pairs are searched
DECIDES = 2.0           # times that the worse reading misses by more than the better one
VISIBLE = 0.01          # relative depth error below which what was said is not doubted
LEAST = 50              # pixels that have to be compared
JUMPED = 20.0           # times the usual speed, that are called a jump …
BY = 1.0                # m … of this at least
ALONE = 3.0             # times the usual speed there and back, that a single pose is off by
ASIDE, TOGETHER = 20.0, 10.0    # degrees there and back, between neighbours that go together
Move = tuple[int, int]


def check(sample: Sample) -> Iterator[Finding]:
    """Yield what the poses place, where they do not say so, and where they jump."""
    for view in sample.views:
        if 'pose' not in view.topics:
            yield from check_rate(view, sample)
            continue
        faults = list(_unreadable(view))
        yield from faults
        if not faults:
            yield from _mount(view, sample)
            yield from _jumps(view, sample)
            yield from check_rate(view, sample)


def _unreadable(view: View) -> Iterator[Finding]:
    """Yield why no pose can be used, if none of the first can."""
    fault = None
    for msg in view.firsts.get('pose', ()):
        try:
            pose_messages.pose(msg)
            return
        except BadMessage as error:
            fault = fault or error
    if view.poses.poses is None:
        yield Finding(REFUSE, f'poses on {view.topics["pose"]}: {fault}' if fault else
                      f'{view.topics["pose"]} has no message that can be read')


def _mount(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield what the poses place, and what is missing on the way to the camera."""
    poses, frame = view.poses, view.image_frame
    if unsaid(poses, frame):
        yield _reading(view, sample)
        return
    track = poses.poses
    if track is None:
        return
    middle = track.stamps[len(track.stamps) // 2]
    if poses.lookup(middle, frame).reason != NO_MOUNT:
        return
    tree, target = poses.tree, sample.config.frames.map
    if tree.connected(target, frame):
        yield Finding(REFUSE, mount_sentence(poses, frame, view.frame_setting), (Remedy(
            {'pose.source': 'tf'}, f'takes all from /tf, which leads from {target!r} to '
                                   f'{frame!r}'),))
    else:
        yield Finding(REFUSE, mount_sentence(poses, frame, view.frame_setting))


def _reading(view: View, sample: Sample) -> Finding:
    """Return which of two readings of unsaid poses the depth speaks for."""
    frame = view.image_frame
    body = bodies(view.poses, frame)[0]
    said = (f'the poses on {view.topics["pose"]} do not say what they place, the camera '
            f'{frame!r} or {body!r}, on which it is mounted')
    both = (Remedy({'pose.child_frame': body}, 'if they place the body'),
            Remedy({'pose.child_frame': frame}, 'if they place the camera'))
    if sample.live:
        return Finding(REFUSE, said, both)
    errors = _residuals(view, sample, (body, frame))
    counts = min(n for _, n in errors.values())
    a, b = errors[body][0], errors[frame][0]
    if counts < LEAST or max(a, b) < DECIDES * min(a, b) or min(a, b) > 0.7 * WORST:
        view.poses.configure(sample.config.pose)
        why = 'no two frames with depth differ by 10 degrees and overlap' if counts < LEAST else \
            f'depth of one frame misses that of another by {100 * a:.1f} % and {100 * b:.1f} %'
        return Finding(REFUSE, f'{said}, and the images do not tell ({why})', both)
    taken, left = (body, frame) if a < b else (frame, body)
    return Finding(NOTE, f'{said}: {taken!r}, because depth of one frame then misses that of '
                         f'another by {100 * min(a, b):.1f} % and not by {100 * max(a, b):.1f} %',
                   (Remedy({'pose.child_frame': left}, 'says otherwise'),),
                   takes={'pose.child_frame': taken})


def check_reading(sample: Sample) -> Iterator[Finding]:
    """Yield that depth speaks against what settings or messages say the poses place."""
    for view in sample.views:
        track, frame = view.poses.poses, view.image_frame
        if track is None or 'depth' not in view.topics or is_cloud_of(view):
            continue
        given = view.poses.child or frame
        others = [frame] if given != frame else bodies(view.poses, frame)[:1]
        if not others or any(sample.config.pose.extrinsic) or \
                view.poses.tree.chain(given, others[0], None).T is None:
            continue
        errors = _residuals(view, sample, (given, others[0]), FEW)
        view.poses.configure(sample.config.pose)
        a, b = errors[given][0], errors[others[0]][0]
        if min(n for _, n in errors.values()) >= LEAST and a >= DECIDES * b and \
                a - b > VISIBLE and b <= 0.7 * WORST:
            said = 'pose.child_frame says' if sample.config.pose.child_frame else \
                f'{view.topics["pose"]} says'
            yield Finding(WARN, f'{said} that the poses place {given!r}: depth of one frame then '
                                f'misses that of another by {100 * a:.1f} %, but by '
                                f'{100 * b:.1f} % if they place {others[0]!r}',
                          (Remedy({'pose.child_frame': others[0]}),))


def doubts(finding: Finding) -> bool:
    """Return whether a finding is one of check_reading()."""
    return finding.severity == WARN and any('pose.child_frame' in remedy.settings
                                            for remedy in finding.remedies)


def _residuals(view: View, sample: Sample, children: tuple[str, str],
               count: int = PAIRS) -> dict[str, tuple[float, int]]:
    """
    Return how far depth misses depth if the poses place each child, and the pixels compared.

    At most *count* pairs of frames are read; the buffer of poses keeps the last child.

    """
    stamps = np.unique(view.stamps['depth'])
    stamps = stamps[np.linspace(0, len(stamps) - 1, min(len(stamps), LOOKED_AT)).astype(int)]
    known: dict[str, dict[int, NDArray[np.float64]]] = {}
    for child in children:
        view.poses.configure(replace(sample.config.pose, child_frame=child))
        placed = {int(s): view.poses.lookup(int(s), view.image_frame).T for s in stamps}
        known[child] = {s: T for s, T in placed.items() if T is not None}
    # A gimbal may turn the views under one reading alone.
    pairs = max((turned(known[child], count) for child in children), key=len)
    pairs = [pair for pair in pairs if all(set(pair) <= known[child].keys() for child in children)]
    shots = view.shots({stamp for pair in pairs for stamp in pair}, sample.config)
    return {child: _residual(known[child], pairs, shots) for child in children}


def _residual(known: Mapping[int, NDArray[np.float64]], pairs: Sequence[Move],
              shots: Mapping[int, Shot]) -> tuple[float, int]:
    """Return how far the depth of pairs of frames misses, and how many pixels were compared."""
    found = [np.zeros(0)]
    for i, j in pairs:
        if i in shots and j in shots:
            errors = misses(shots[i].depth, shots[j].depth, inverse(known[j]) @ known[i],
                            shots[i].camera.K)
            found.append(np.minimum(errors[~np.isnan(errors)], WORST))
    errors = np.concatenate(found)
    return (float(errors.mean()) if errors.size else WORST), errors.size


def turned(poses: dict[int, NDArray[np.float64]], count: int = PAIRS) -> list[Move]:
    """Return *count* pairs of stamps whose views differ by TURNED degrees, few frames apart."""
    stamps = sorted(poses)
    R = np.array([poses[stamp][:3, :3] for stamp in stamps]).reshape(-1, 3, 3)
    found: list[Move] = []
    for i in range(len(stamps)):
        near = R[i + 1:i + 1 + WITHIN]
        cosine = (np.einsum('nij,ij->n', near, R[i]) - 1.0) / 2.0
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        fitting = np.flatnonzero((angle >= TURNED[0]) & (angle <= TURNED[1]))
        if fitting.size:
            found.append((stamps[i], stamps[i + 1 + int(fitting[0])]))
    chosen = np.linspace(0, len(found) - 1, min(len(found), count)).astype(int)
    return [found[k] for k in chosen]


def _jumps(view: View, sample: Sample) -> Iterator[Finding]:
    """Yield where the poses jump, whether or not images lie in between."""
    track = view.poses.poses
    if track is None or len(track.stamps) < 3:
        return
    # hypot, which does not overflow where one pose is absurd.
    steps = np.hypot.reduce(np.diff([T[:3, 3] for T in track.transforms], axis=0), axis=1)
    seconds = np.diff(np.array(track.stamps, np.float64)) / 1e9
    speeds = steps / np.maximum(seconds, 1e-9)
    limit = sample.config.pose.max_speed
    impossible = steps - SLACK > limit * seconds        # as sync.track has it
    usual = float(np.median(speeds))
    odd = (speeds > JUMPED * max(usual, 0.1)) & (steps > BY)
    there = steps > ALONE * usual * seconds + BY
    ends = np.array([T[:3, 3] for T in track.transforms])
    alone = there[:-1] & there[1:] & (np.hypot.reduce(ends[2:] - ends[:-2], axis=1)
                                      <= ALONE * usual * (seconds[:-1] + seconds[1:]) + BY)
    odd[:-1] |= alone
    odd[1:] |= alone
    odd &= ~impossible
    for which, what in ((impossible, 'nothing is interpolated across'),
                        (odd, 'taken as they are')):
        if not which.any():
            continue
        worst = int(np.argmax(np.where(which, steps, 0.0)))
        yield Finding(WARN, f'the poses jump {int(which.sum())} times, by up to '
                            f'{steps[worst]:.3g} m in {seconds[worst]:.3g} s at '
                            f'{track.stamps[worst] / 1e9:.3f} s (relocalisation, loop closure?): '
                            f'{what}; topics.trajectory takes corrected poses', (Remedy(
                                {'pose.max_speed': f'{1.2 * speeds[worst]:.3g}'},
                                'if they are right') if which is impossible else Remedy(
                                {'pose.max_speed': f'{0.8 * speeds[odd].min():.3g}'},
                                'does not interpolate across them'),))
    yield from _turned_alone(track)


def _turned_alone(track: Track) -> Iterator[Finding]:
    """Yield where single poses look elsewhere than those before and after."""
    R = np.array([T[:3, :3] for T in track.transforms])
    one, two = (np.degrees(np.arccos(np.clip((np.einsum('nij,nij->n', R[k:], R[:-k]) - 1) / 2,
                                             -1, 1))) for k in (1, 2))
    alone = (one[:-1] > ASIDE) & (one[1:] > ASIDE) & (two < TOGETHER)
    if alone.any():
        first = int(np.argmax(alone))
        yield Finding(WARN, f'{int(alone.sum())} of {len(R)} poses look elsewhere than their '
                            f'neighbours, the first at {track.stamps[first + 1] / 1e9:.3f} s by '
                            f'{one[first]:.0f} degrees: what is seen near them lands in wrong '
                            'places')
