"""What the frames themselves say about the flags: the depth's unit, the cameras' axes, up."""

from __future__ import annotations

from collections.abc import Callable
import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert import axes
from persem_ros.convert.units import check_unit
from persem_ros.core.agreement import pairs_to_check

LOG = logging.getLogger(__name__)
LEVEL = 0.5         # of the cameras' up along z, below which the world is not z-up
STEEP = 0.7         # of the view along -z, above which the cameras look down


def sampled(
        count: int, depth_of: Callable[[int], NDArray[Any]],
        pose_of: Callable[[int], NDArray[np.float64] | None]
) -> tuple[dict[int, NDArray[np.float64]], dict[int, NDArray[np.float64]]]:
    """
    Return the depth and the poses of frames near enough to overlap.

    Parameters
    ----------
    count : int
        Number of frames.
    depth_of, pose_of : function
        Of frame i: depth, (H, W), metres, 0 is no measurement; and the pose, or None.

    Returns
    -------
    dict of int to ndarray, shape (H, W)
        Metres; of those frames that have a pose and images of one size.
    dict of int to ndarray, shape (4, 4)
        The poses of the same.

    """
    need = sorted({i for pair in pairs_to_check(count) for i in pair})
    poses = {i: pose for i in need if (pose := pose_of(i)) is not None}
    depths = {i: depth_of(i).astype(np.float64) for i in poses}
    # An image of another size is refused when its turn comes; here it only cannot be compared.
    alike = [i for i in depths if depths[i].shape == next(iter(depths.values())).shape]
    return {i: depths[i] for i in alike}, {i: poses[i] for i in alike}


def check_conventions(depths: dict[int, NDArray[np.float64]],
                      poses: dict[int, NDArray[np.float64]], K: NDArray[np.float64],
                      conventions: tuple[str, str, str], per_metre: float) -> None:
    """
    Reproject depth images under other units and other axes, and warn about what fits better.

    Parameters
    ----------
    depths, poses : dict
        Of sampled(), the poses as their files have them.
    K : ndarray, shape (3, 3)
        Pinhole matrix of the depth images.
    conventions : tuple of str
        direction, axes and world of axes.optical_pose(), as they are set.
    per_metre : float
        Stored units of depth per metre; 0 where no flag sets them.

    """
    direction, camera, _ = conventions
    optical = {i: axes.optical_pose(T, *conventions) for i, T in poses.items()}
    if per_metre and check_unit(depths, optical, K, per_metre)[0] != 1.0:
        verdict = 'agrees'      # a unit is told by the motion under these axes
    else:
        verdict = axes.judge(axes.compare_conventions(depths, poses, K), direction, camera)
    if optical and verdict not in ('wrong', 'none'):
        check_up(list(optical.values()), conventions[2])


def check_up(poses: list[NDArray[np.float64]], world: str = 'enu') -> bool:
    """
    Warn when the cameras' mean up is not the map's.

    Parameters
    ----------
    poses : list of ndarray, shape (4, 4)
        T_map_camera.
    world : str
        Key of axes.WORLD_AXES that they were turned with.

    Returns
    -------
    bool
        Whether a warning was given; never for cameras that look down, whose up is their heading.

    """
    rotation = np.mean([T[:3, :3] for T in poses], axis=0)
    up, view = -rotation[:, 1], rotation[:, 2]
    if view[2] < -STEEP or up[2] >= LEVEL or np.abs(up).max() < LEVEL:
        return False
    turn = axes.WORLD_AXES[world]
    own = turn.T @ up       # in the world of the files
    better = [name for name, other in axes.WORLD_AXES.items() if (other @ own).argmax() == 2
              and (other @ own)[2] >= LEVEL]
    LOG.warning("the cameras' up is %s of the world, not %s: the map from above would look "
                'sideways; %s', axis_of(own), axis_of(turn[2]), f'--world {better[0]} turns it'
                if better else 'turn the poses so that z is up')
    return True


def axis_of(direction: NDArray[np.float64]) -> str:
    """Return the name of the axis, x to -z, that is nearest to a direction."""
    k = int(np.abs(direction).argmax())
    return ('-' if direction[k] < 0 else '') + 'xyz'[k]
