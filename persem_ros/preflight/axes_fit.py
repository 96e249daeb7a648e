"""Do poses place the optical frame, z forward? Frames that see one place tell."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import inverse, matrix_to_quaternion
from persem_ros.preflight.depth_fit import AGREE, error_of, measured, moves_of, Seen
from persem_ros.preflight.findings import Finding, Remedy, WARN
from persem_ros.preflight.sample import Sample, View

CLEAR = 0.4         # of the error, that other axes must leave at most
GOOD = 0.02         # relative depth error that they must leave at most
VISIBLE = 0.01      # relative depth error below which axes are not told apart
# Points of the optical frame (x right, y down, z forward) to frames that are taken for one.
AXES = {
    'x forward, y left, z up': np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    'x forward, y right, z down': np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    'x right, y up, z back': np.diag([1.0, -1.0, -1.0])}


def check(view: View, sample: Sample, frames: Sequence[Seen]) -> Iterator[Finding]:
    """Yield that images are not in the frame that they name, where other axes fit far better."""
    frames = [f for f in frames if f.depth.shape == frames[0].depth.shape]
    if len(frames) < 2:
        return
    depths = {i: measured(frame.depth) for i, frame in enumerate(frames)}
    moves = moves_of(frames, depths)
    K = frames[0].camera.K
    now = error_of(depths, moves, K)
    if now <= AGREE:
        return
    errors = {}
    for name, R in AXES.items():
        turn = np.eye(4)
        turn[:3, :3] = R
        errors[name] = error_of(depths, [(pair, inverse(turn) @ T @ turn) for pair, T in moves], K)
    best = min(errors, key=lambda name: errors[name])
    then = errors[best]
    if then > min(CLEAR * now, GOOD) or now - then < VISIBLE:
        return
    yield Finding(WARN, f'the images are in the frame {view.image_frame!r}, which looks like one '
                        f'with {best} instead of an optical frame (x right, y down, z forward): '
                        f'depth of one frame then misses that of another by {100 * then:.1f} %, '
                        f'as it is by {100 * now:.1f} %',
                  tuple(_remedies(view, sample, AXES[best])))


def _remedies(view: View, sample: Sample, R: NDArray[np.float64]) -> Iterator[Remedy]:
    """Yield the frame of /tf_static that has the right axes, else the mounting that has."""
    frame, poses = view.image_frame, view.poses
    if any(sample.config.pose.extrinsic):
        return
    optical = [name for name in poses.tree.static if name != frame
               and (T := poses.tree.chain(frame, name, None).T) is not None
               and np.allclose(T[:3, :3], R, atol=1e-3)]
    for name in optical:
        yield Remedy({view.frame_setting: name}, 'names one that is optical')
    if optical:
        return
    if sample.config.pose.source == 'tf':       # placed in the frame of the images
        yield Remedy({'pose.extrinsic': _numbers(np.zeros(3), R)})
        return
    child = poses.child if poses.child not in ('', frame) else 'base_link'
    mount = poses.tree.chain(child, frame, None).T
    mount = np.eye(4) if mount is None else mount
    said = {} if poses.child == child else {'pose.child_frame': child}
    yield Remedy({**said, 'pose.extrinsic': _numbers(mount[:3, 3], mount[:3, :3] @ R)})


def _numbers(xyz: NDArray[np.float64], R: NDArray[np.float64]) -> str:
    """Return a place and a turn as the setting pose.extrinsic is typed."""
    values = (f'{round(x, 6) + 0.0:.6g}' for x in (*xyz, *matrix_to_quaternion(R)))
    return f'[{",".join(values)}]'
