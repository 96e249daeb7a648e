"""How much of a map's votes the heights of the classes overrule: what a wrong height shows in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import Columns
from persem_ros.core.geometry.ground import lower, NONE, TILE, tiles_of
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
    return summed(counts_of(columns, settings), settings)


def counts_of(columns: dict[str, NDArray[Any]], settings: Any,
              whole: Optional[Columns] = None) -> list[tuple[int, int, int, int]]:
    """
    Return (label, voxels, out, kept) of each class of an Overruled, in a part of a map.

    Parameters
    ----------
    columns, settings
        As of overruled().
    whole : core.geometry.columns.Columns, optional
        Of the map; None: the part is all of it.

    """
    spans = parsed(settings.geometry.heights)
    if not spans or not len(columns['voxel']):
        return []
    step = steps_of(upright(columns['voxel'], up_of(settings.up)), settings.geometry.window, whole)
    found = []
    for c, low, high in spans:
        mine = np.flatnonzero(columns['majority'] == c)
        out = mine[steps_out(low, high)[step[mine]]]
        if len(mine):
            kept = int(np.count_nonzero(columns['label'][out] == c))
            found.append((c, len(mine), len(out), kept))
    return found


def summed(counts: Iterable[Sequence[int]], settings: Any) -> list[Overruled]:
    """Return the Overruled of a map by what counts_of() found in its parts."""
    sums: dict[int, list[int]] = {}
    for c, *numbers in counts:
        sums[c] = [a + b for a, b in zip(sums.get(c, (0, 0, 0)), numbers)]
    return [Overruled(c, low, high, *sums[c])
            for c, low, high in parsed(settings.geometry.heights) if c in sums]


def steps_of(index: NDArray[np.int32], window: int,
             whole: Optional[Columns] = None) -> NDArray[np.int64]:
    """Return in which step of heights above the ground upright voxels (n, 3) lie, below 8."""
    tiles, tile = tiles_of(index // SIDE)
    lowest = np.full((len(tiles), TILE), NONE, np.int32)
    lower(index, tile, lowest)
    own = Columns(tiles, lowest)
    around = own if whole is None else whole.around(own, window)
    level = around.ground(window).level[around.places(tiles)]
    column = (index[:, 0] & SIDE - 1) * SIDE + (index[:, 1] & SIDE - 1)
    return np.searchsorted(HEIGHTS, index[:, 2] - level[tile, column], side='right')
