"""What decides on one voxel, of a map file that may be larger than memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.kept import fitted_by
from persem_ros.core.memory.pools import SIDE
from persem_ros.core.refine.explain import explain
from persem_ros.outputs.map.explanation import explanation, of_file
from persem_ros.outputs.map.loading import head, load, load_part

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.outputs.map.stored import StoredMap
    from persem_ros.settings.config import Refine

RINGS = 6           # voxels around that count, besides the columns that the ground is found in
ALL = 1 << 28       # farther than any block
FARTHEST = 2 ** 31 - 2 * SIDE       # beyond all voxels


def surroundings(path: Path | str, point: NDArray[np.float64],
                 ) -> tuple[StoredMap, VoxelMemory, NDArray[np.int32]]:
    """
    Return the part of a map that says why the voxel at a point has its label.

    By the paper's methods that is the voxel's ring of neighbours; by the method geometry, whose
    parameters the file has, the columns in which the ground is found. Where it has none, they
    are fitted to the whole map.

    Parameters
    ----------
    path : str or Path
        A map file.
    point : ndarray, shape (3,), float64
        Metres in the map frame.

    Returns
    -------
    stored : StoredMap
        With these blocks.
    memory : VoxelMemory
        Of them; the voxel need not be among them.
    voxel : ndarray, shape (3,), int32
        The index at the point.

    Raises
    ------
    PersemError
        For a file that load() refuses.

    """
    whole = head(path).stored
    place = np.floor((point - np.array(whole.saved.origin)) / whole.saved.voxel_size)
    voxel = np.nan_to_num(place, nan=FARTHEST).clip(-FARTHEST, FARTHEST).astype(np.int32)
    settings = whole.config().refine
    if settings.method == 'geometry' and whole.saved.fitted_by != fitted_by(settings):
        stored = load(path)
    else:
        reach, up = _reach(settings)
        low, high = (voxel.astype(np.int64) - reach) // SIDE, (voxel.astype(np.int64) + reach) \
            // SIDE
        if up is not None:
            low[up], high[up] = -ALL, ALL
        stored = load_part(path, low.tolist(), high.tolist())
    return stored, stored.memory(), voxel


def explained(stored: StoredMap, memory: VoxelMemory, voxel: NDArray[np.int32],
              ) -> tuple[str, dict[str, Any]]:
    """Return the text of persem map query of an observed voxel, and its trace."""
    trace = explain(memory, voxel, stored.config().refine)
    return explanation(of_file(stored), voxel, trace), trace


def _reach(settings: Refine) -> tuple[int, int | None]:
    """Return how many voxels around count, and the axis along which all of them do."""
    if settings.method != 'geometry':
        return RINGS, None
    return 2 * settings.geometry.window + RINGS, 'xyz'.index(settings.up[-1])
