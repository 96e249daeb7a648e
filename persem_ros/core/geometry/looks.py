"""
What a round of the schedule needs of a part of a map: its votes and its shapes.

Histories and neighbours are looked at once; rounds then go over the parts one after the other, or
side by side, with nothing but parameters that travel.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Optional, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.candidates import near_classes
from persem_ros.core.geometry.columns import cells_at, Columns, columns_of
from persem_ros.core.geometry.dense import Dense
from persem_ros.core.geometry.groups import groups_of
from persem_ros.core.geometry.method import check_pairs
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.shape import shapes_of
from persem_ros.core.geometry.sparse import Sparse
from persem_ros.core.geometry.upright import up_of, upright
from persem_ros.core.geometry.votes import take_votes, Votes

VOTES = 'classes', 'start', 'count', 'place', 'share', 'total', 'agreement'


@dataclass(frozen=True, eq=False)
class Looks:
    """
    n voxels of a map.

    Attributes
    ----------
    index : ndarray, shape (n, 3), int32
        Upright indices.
    shape : ndarray, shape (n,), uint8
        tilt * 3 + roughness.
    votes : Votes
        By the classes of this part.
    near : pair of ndarray, or None
        The classes seen at each voxel or beside it (core.geometry.candidates.near_classes), where
        the map may have more than the dense form of the model is for.

    """

    index: NDArray[np.int32]
    shape: NDArray[np.uint8]
    votes: Votes
    near: Optional[tuple[NDArray[np.int64], NDArray[np.int32]]]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as plain arrays, by name; looks_from() takes them."""
        found = {'index': self.index, 'shape': self.shape,
                 **{name: getattr(self.votes, name) for name in VOTES}}
        return found if self.near is None else {
            **found, 'near_start': self.near[0], 'near': self.near[1]}

    def nbytes(self) -> int:
        """Return the bytes in use."""
        return sum(array.nbytes for array in self.arrays().values())


class Pairs(NamedTuple):
    """How many pairs of classes the votes of voxels make: pairs, votes, and most in a voxel."""

    pairs: int
    votes: int
    most: int

    def and_those(self, other: Pairs) -> Pairs:
        """Return the Pairs of both."""
        return Pairs(self.pairs + other.pairs, self.votes + other.votes,
                     max(self.most, other.most))

    def check(self, classes: int) -> None:
        """Refuse (PersemError) what would fill the memory or take for ever."""
        if classes > MOST_DENSE:
            check_pairs(float(self.pairs), float(self.votes), self.most, classes)


def look(memory: Any, taken: Any, settings: Any, beside: bool, keep: bool = False) -> Looks:
    """
    Return the Looks of the refined rows of a snapshot.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map.
    taken : core.refine.snapshot.Snapshot
        core.refine.reach.surrounded(), with a ring around the rows where *beside*.
    settings : persem_ros.settings.config.Refine
        up and geometry.
    beside : bool
        Whether to list the classes beside each voxel.
    keep : bool
        As of core.geometry.votes.take_votes.

    """
    n, up, near = taken.refined, up_of(settings.up), None
    votes = take_votes(memory, taken, settings.geometry.directions, keep)
    if beside:
        start, listed = near_classes(memory.m.blocks, taken, votes)
        near = start[:n + 1], listed[:start[n]]
    shape = shapes_of(memory.m.blocks, taken.relief.bits, taken.block[:n], taken.cell[:n], up.k)
    end = votes.start[n]
    return Looks(np.ascontiguousarray(upright(taken.index[:n], up)), shape, Votes(
        votes.classes, votes.start[:n + 1], votes.count[:n], votes.place[:end],
        votes.share[:end], votes.total[:n], votes.agreement[:n]), near)


def looks_from(arrays: Any) -> Looks:
    """Return the Looks that arrays() gave."""
    near = (arrays['near_start'], arrays['near']) if 'near' in arrays else None
    return Looks(arrays['index'], arrays['shape'], Votes(*(arrays[name] for name in VOTES)), near)


def pairs_of(votes: Votes) -> Pairs:
    """Return the Pairs of votes."""
    count = votes.count.astype(np.int64)
    return Pairs(int((count ** 2).sum()), int(count.sum()), int(count.max(initial=0)))


def model_of(looks: Looks, columns: Columns, classes: NDArray[np.uint16],
             constants: Any) -> Union[Dense, Sparse]:
    """
    Return the model of a part for rounds, by the cells of the part.

    Parameters
    ----------
    looks : Looks
        Of the part.
    columns : Columns
        Of the whole map.
    classes : ndarray, shape (K,), uint16
        Of the whole map.
    constants : persem_ros.settings.config.Geometry
        refine.geometry.

    """
    place = np.searchsorted(classes, looks.votes.classes).astype(np.int32)
    known = classes[np.minimum(place, len(classes) - 1)] == looks.votes.classes
    place[~known] = 0                   # classes that came since say nothing
    # Not a product: between the votes of two rows lies what was in the memory, maybe no number.
    votes = replace(looks.votes, classes=classes, place=place[looks.votes.place],
                    share=np.where(known[looks.votes.place], looks.votes.share, 0.0))
    near = columns.around(columns_of(looks.index), constants.window)
    ground = near.ground(constants.window)
    cells = cells_at(ground, constants.cell)
    groups = groups_of(looks.index, near.places(looks.index[:, :2] >> 3), looks.shape, ground,
                       cells, constants.cell)
    if len(classes) <= MOST_DENSE:
        return Dense(None, None, votes, groups, cells, constants)
    start, beside = looks.near or (np.zeros(len(votes.count) + 1, np.int64), np.empty(0, np.int32))
    return Sparse(None, None, votes, groups, cells, constants, (start, place[beside]))
