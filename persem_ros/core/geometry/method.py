"""The method geometry on a snapshot: votes, shapes, parameters, labels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Optional, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import cells_at
from persem_ros.core.geometry.dense import Dense
from persem_ros.core.geometry.ground import Ground, ground_of, lower, NONE, TILE, tiles_of
from persem_ros.core.geometry.groups import Cells, Groups, groups_of
from persem_ros.core.geometry.labelling import label_rows
from persem_ros.core.geometry.parameters import Parameters, Sums
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.geometry.schedule import fit
from persem_ros.core.geometry.shape import occupy, shapes_of
from persem_ros.core.geometry.sparse import Sparse
from persem_ros.core.geometry.sparse_parameters import SparseParameters, SparseSums
from persem_ros.core.geometry.upright import up_of, upright
from persem_ros.core.geometry.votes import take_votes, Votes
from persem_ros.core.memory.pools import ROWS
from persem_ros.errors import PersemError

MOST_PAIRS = 1 << 26        # of classes that are kept: 2 GB; K * K up to 8192 classes
MOST_WORK, WORK_A_VOTE = 1e9, 64        # pairs that are counted: seconds, and so many a vote
GEOMETRY = 4        # source of a label that is not the majority's, spec section 8


class Labelled(NamedTuple):
    """Labels (uint16), sources (uint8) and posteriors (float32) of rows, and their parameters."""

    labels: NDArray[np.uint16]
    sources: NDArray[np.uint8]
    posterior: NDArray[np.float32]
    parameters: Optional[Union[Parameters, SparseParameters]]
    sums: Optional[Union[Sums, SparseSums]] = None      # of the rows that a sweep had reached


@dataclass(frozen=True, eq=False)
class Places:
    """
    Where the voxels of a snapshot lie, by rows.

    Attributes
    ----------
    index : ndarray, shape (n, 3), int32
        Upright indices.
    tile : ndarray, shape (n,), int64
        The tile of *ground* in which each lies.
    shape : ndarray, shape (n,), uint8
        tilt * 3 + roughness.
    ground : Ground

    """

    index: NDArray[np.int32]
    tile: NDArray[np.int64]
    shape: NDArray[np.uint8]
    ground: Ground


def relabel(memory: Any, taken: Any, settings: Any,
            parameters: Optional[Union[Parameters, SparseParameters]] = None) -> Labelled:
    """
    Label the refined rows of a snapshot.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map; histories are read. Nothing is written but what is kept for the next time, and
        that only where the snapshot was taken with a relief.
    taken : core.refine.snapshot.Snapshot
        The whole map, or with *parameters* a part with two rings around what is to be refined.
    settings : persem_ros.settings.config.Refine
        up and geometry.
    parameters : Parameters, optional
        What to go by; None: the schedule is run from its start.

    """
    constants = settings.geometry
    if not len(taken.number):
        return Labelled(np.zeros(0, np.uint16), np.zeros(0, np.uint8), np.zeros(0, np.float32),
                        parameters)
    votes = take_votes(memory, taken, constants.directions, taken.relief is not None,
                       None if parameters is None else parameters.classes)
    places = places_of(memory, taken, settings)
    cells = cells_at(places.ground, constants.cell) if parameters is None else parameters.cells
    # Any: it is of the kind of its parameters, dense or sparse.
    model: Any = model_of(memory.m.blocks, taken, votes,
                          groups_in(places, cells, constants.cell), cells, constants, parameters)
    if parameters is None:
        parameters = fit(model, constants.rounds)
    sums = model.round(parameters, taken.swept) if taken.swept else None
    best, posterior = label_rows(model, parameters)
    labels = votes.classes[best]
    sources = np.where(labels != taken.majority[:taken.refined], GEOMETRY, 0).astype(np.uint8)
    return Labelled(labels, sources, posterior, parameters, sums)


def check_pairs(pairs: float, votes: float, most: int, K: int) -> None:
    """Refuse (PersemError) pairs of classes that would fill the memory or take for ever."""
    if min(float(K) ** 2, pairs) > MOST_PAIRS or pairs > MOST_WORK + WORK_A_VOTE * votes:
        raise PersemError(
            'the method geometry counts pairs of the classes of each voxel, and this map has '
            f'{pairs:.2g}, of {K} classes, up to {most} in a voxel: more '
            f'than {MOST_PAIRS:.3g} different ones, or {WORK_A_VOTE} a vote; choose another '
            'refine.method')


def model_of(blocks: Any, taken: Any, votes: Votes, groups: Groups, cells: tuple[Cells, Cells],
             constants: Any, parameters: Optional[Union[Parameters, SparseParameters]] = None,
             ) -> Union[Dense, Sparse]:
    """Return the form of the model that fits the parameters, or the number of classes."""
    form = Dense if (isinstance(parameters, Parameters) if parameters is not None else
                     len(votes.classes) <= MOST_DENSE) else Sparse
    if form is Sparse:
        count = votes.count.astype(float)
        check_pairs(float((count ** 2).sum()), float(count.sum()),
                    int(count.max(initial=0)), len(votes.classes))
    return form(blocks, taken, votes, groups, cells, constants)


def places_of(memory: Any, taken: Any, settings: Any) -> Places:
    """Return where the voxels of a snapshot lie: of the whole map, or of one with a relief."""
    up, blocks, relief = up_of(settings.up), memory.m.blocks, taken.relief
    index = upright(taken.index, up)
    if relief is not None:
        rows, kept = taken.reshaped, memory.store.beliefs['shape']
        if len(rows):
            kept[taken.number[rows]] = shapes_of(blocks, relief.bits, taken.block[rows],
                                                 taken.cell[rows], up.k)
        tile = relief.tile[taken.block].astype(np.int64)
        return Places(index, tile, kept[taken.number], relief.ground)
    first = np.flatnonzero(np.diff(taken.block, prepend=-1))        # voxels come block by block
    tiles, tile = tiles_of(upright(blocks['index'][taken.block[first]], up))
    tile = np.repeat(tile, np.diff(np.append(first, len(taken.block))))
    lowest = np.full((len(tiles), TILE), NONE, np.int32)
    lower(index, tile, lowest)
    ground = ground_of(tiles, lowest, settings.geometry.window)
    occupied = np.zeros((int(taken.block.max()) + 1, ROWS), np.uint8)
    occupy(taken.block, taken.cell, occupied)
    shape = shapes_of(blocks, occupied, taken.block, taken.cell, up.k)
    return Places(index, tile, shape, ground)


def groups_in(places: Places, cells: Any, cell: int) -> Groups:
    """Return the groups of places, by the numbers of cells."""
    return groups_of(places.index, places.tile, places.shape, places.ground, cells, cell)
