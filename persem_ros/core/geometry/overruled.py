"""How much of a map's votes the heights of the classes overrule: what a wrong height shows in."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import ground_of, lower, NONE, TILE, tiles_of
from persem_ros.core.geometry.groups import HEIGHTS
from persem_ros.core.geometry.hints import steps_out
from persem_ros.core.geometry.upright import up_of, upright
from persem_ros.core.memory.pools import SIDE
from persem_ros.settings.heights import parsed

FEW, SOME = 100, 0.05       # voxels, and share of a class's, out of its heights: fewer say nothing
MOST = 2 / 3                # of a class's voxels


class Overruled(NamedTuple):
    """
    What the heights of one class do to its votes.

    Attributes
    ----------
    label : int
        The class.
    low, high : float
        Its heights, voxels above the ground.
    voxels : int
        Voxels that most votes call so.
    out : int
        Of these, at heights where it is held down.
    kept : int
        Of these, labelled so all the same.

    """

    label: int
    low: float
    high: float
    voxels: int
    out: int
    kept: int

    @property
    def doubtful(self) -> bool:
        """
        Return whether the map speaks against the heights, and not against the votes.

        Where heights are right and the network wrong, up to 0.54 of a class's voxels lie out of
        them and at most 0.31 of these keep the name; wrong heights leave two thirds out, or half
        of these with their name (docs/results.md, "Heights that somebody knows").

        """
        share = self.out / self.voxels
        return self.out >= FEW and (share > MOST or share >= SOME and self.kept >= self.out / 2)


def overruled(columns: dict[str, NDArray[Any]], settings: Any) -> list[Overruled]:
    """
    Return the Overruled of each class that was voted for and has heights, by id.

    Parameters
    ----------
    columns : dict
        VoxelMemory.columns() of a whole map that the method geometry has labelled.
    settings : persem_ros.settings.config.Refine
        up and geometry.

    """
    spans = parsed(settings.geometry.heights)
    if not spans or not len(columns['voxel']):
        return []
    step = steps_of(upright(columns['voxel'], up_of(settings.up)), settings.geometry.window)
    found = []
    for c, low, high in spans:
        mine = np.flatnonzero(columns['majority'] == c)
        out = mine[steps_out(low, high)[step[mine]]]
        if len(mine):
            kept = int(np.count_nonzero(columns['label'][out] == c))
            found.append(Overruled(c, low, high, len(mine), len(out), kept))
    return found


def steps_of(index: NDArray[np.int32], window: int) -> NDArray[np.int64]:
    """Return in which step of heights above the ground upright voxels (n, 3) lie, below 8."""
    tiles, tile = tiles_of(index // SIDE)
    lowest = np.full((len(tiles), TILE), NONE, np.int32)
    lower(index, tile, lowest)
    level = ground_of(tiles, lowest, window).level
    column = (index[:, 0] & SIDE - 1) * SIDE + (index[:, 1] & SIDE - 1)
    return np.searchsorted(HEIGHTS, index[:, 2] - level[tile, column], side='right')
