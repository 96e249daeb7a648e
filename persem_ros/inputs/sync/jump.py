"""A localisation that corrects itself in one step, as /tf shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from persem_ros.inputs.sync.track import seconds

if TYPE_CHECKING:
    from persem_ros.inputs.sync.poses import PoseBuffer


def jumped(poses: PoseBuffer, least: float) -> str:
    """
    Return the sentence that says how a localisation has just corrected itself, '' if not.

    It has where what ties the map to the frame that the poses are in, or to one that moves on,
    goes *least* metres, or turns as far at 10 m, from one sample to the next.

    """
    moving = poses.tree.moving
    carried = {track.parent for track in moving.values()}
    carried |= {poses.poses.parent} if poses.poses else set()
    for child, track in moving.items():
        if track.parent != poses.map_frame or child not in carried or len(track.stamps) < 2:
            continue
        before, after = track.transforms[-2:]
        way = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
        turn = float(np.abs(after[:3, :3] - before[:3, :3]).max())
        if max(way, 10 * turn) >= least:
            return (f'{poses.map_frame} -> {child} on /tf jumped by {way:.3g} m and '
                    f'{np.degrees(turn):.2g} degrees at {seconds(track.stamps[-1])}, as '
                    'after a loop closure: what was mapped before stays where it was')
    return ''
