"""The outer faces of voxels: what a mesh of the map shows, a slab of blocks at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.columns import Columns
    from persem_ros.outputs.export.source import MapSource

# Sides -x +x -y +y -z +z and the corners of each, counter-clockwise as seen from outside.
STEPS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
CORNERS = np.array([
    [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
    [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
    [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]], [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]])


def outer_faces(source: MapSource, choice: Choice, what: str
                ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint16]]]:
    """
    Yield the faces between chosen voxels and what is no chosen voxel.

    Yields
    ------
    corners : ndarray, shape (m, 4, 3), int64
        Of each face, counter-clockwise as seen from outside, in voxel edges from the map's
        origin.
    labels : ndarray, shape (m,), uint16

    """
    before, here = _nothing(), _nothing()
    for after in _slabs(source, choice, what):
        if len(here[0]):
            yield _exposed(before, here, after)
        before, here = here, after
    if len(here[0]):
        yield _exposed(before, here, _nothing())


def _nothing() -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Return no voxels."""
    return np.empty((0, 3), np.int64), np.empty(0, np.uint16)


def _slabs(source: MapSource, choice: Choice, what: str
           ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint16]]]:
    """Yield (voxels, labels) of all blocks of one x together, x ascending."""
    waiting: list[Any] = []
    last = None
    with source.shown(choice, what) as chunks:
        for columns in chunks:
            slab = columns['voxel'][:, 0] // SIDE
            for x in np.unique(slab):
                if last is not None and x != last:
                    yield _together(waiting)
                    waiting = []
                waiting.append(_part(columns, slab == x))
                last = x
    if waiting:
        yield _together(waiting)


def _part(columns: Columns, rows: NDArray[np.bool_]) -> Any:
    return columns['voxel'][rows].astype(np.int64), columns['label'][rows]


def _together(parts: list[Any]) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    return tuple(np.concatenate(column) for column in zip(*parts))      # type: ignore


def _exposed(before: Any, here: Any, after: Any
             ) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Return the outer faces of the voxels *here*, whose neighbours may be in all three."""
    voxels, labels = here
    known = np.concatenate([part[0] for part in (before, here, after)])
    low = voxels.min(axis=0) - 1
    span = voxels.max(axis=0) + 2 - low
    known = known[((known >= low) & (known < low + span)).all(axis=1)]
    steps = np.array([span[1] * span[2], span[2], 1])
    keys = np.sort((known - low) @ steps)
    own = (voxels - low) @ steps
    corners, faces = [], []
    for side, step in enumerate(STEPS):
        wanted = own + step @ steps
        open_ = keys[np.searchsorted(keys, wanted).clip(max=len(keys) - 1)] != wanted
        corners.append(voxels[open_][:, None] + CORNERS[side])
        faces.append(labels[open_])
    return np.concatenate(corners), np.concatenate(faces)
