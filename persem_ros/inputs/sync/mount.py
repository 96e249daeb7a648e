"""What carries a camera: whether the poses say so, and what leads from there to the images."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.inputs.decode.pose_messages import unit_quaternion

if TYPE_CHECKING:
    from persem_ros.inputs.sync.poses import PoseBuffer
    from persem_ros.inputs.sync.tree import Tree

BODIES = re.compile(r'(.*[/_])?(base_link|base|body|fcu|base_footprint)$')


def bodies(poses: PoseBuffer, frame: str) -> list[str]:
    """
    Return the frames that unsaid poses may place in place of *frame*, the likeliest first.

    These are the frames that carry the camera, below the frame that the poses are in; none
    where the camera is mounted on nothing, or without any distance.

    """
    tree, parent = poses.tree, poses.poses.parent if poses.poses else ''
    path = tree.path(frame)[1:]
    for top in (parent, poses.map_frame):
        path = path[:path.index(top)] if top in path else path
    fixed_to = [name for name in path if tree.connected(name, frame, moving=False)]
    if not path or path == fixed_to and all(_same_place(tree, name, frame) for name in fixed_to):
        return []
    named = [name for name in path if BODIES.match(name)]
    return list(dict.fromkeys([*named, *reversed(fixed_to), *path]))


def unsaid(poses: PoseBuffer, frame: str) -> bool:
    """Return whether nobody says if the poses place the camera or what it is mounted on."""
    return not poses.child and poses.extrinsic is None and bool(bodies(poses, frame))


def unheard(poses: PoseBuffer, frame: str) -> bool:
    """Return whether *frame* seems to be mounted on nothing only as its mount was not heard."""
    return bool(poses.unheard) and not poses.child and poses.extrinsic is None \
        and len(poses.tree.path(frame)) == 1


def fixed(poses: PoseBuffer, frame: str) -> bool:
    """Return whether settings and static transforms lead from the poses to *frame*."""
    return not unsaid(poses, frame) and not unheard(poses, frame) and (
        poses.child in ('', frame) or poses.extrinsic is not None
        or poses.tree.connected(poses.child, frame, moving=False))


def extrinsic_of(values: tuple[float, ...]) -> NDArray[np.float64] | None:
    """Return the 4x4 matrix of the setting pose.extrinsic, None where it is all 0."""
    if not any(values):
        return None
    try:
        return transform(values[:3], unit_quaternion(values[3:]))
    except PersemError:
        raise PersemError(f'pose.extrinsic: expected x y z and a quaternion qx qy qz qw of '
                          f'length 1, got {list(values)}') from None


def _same_place(tree: Tree, one: str, other: str) -> bool:
    """Return whether static transforms give two frames one position and rotation."""
    T = tree.chain(one, other, None).T
    return T is not None and np.allclose(T, np.eye(4), atol=1e-6)
