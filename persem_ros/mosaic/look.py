"""A tile is looked at: the votes and shapes of its voxels, for the rounds of method geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from persem_ros.core.geometry.columns import columns_of
from persem_ros.core.geometry.looks import look as look_at, pairs_of
from persem_ros.core.geometry.posteriors import MOST as MOST_DENSE
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.refine.labelled import number_of_ids
from persem_ros.core.refine.reach import surrounded
from persem_ros.mosaic.folder import save_arrays
from persem_ros.mosaic.surroundings import Surrounded
from persem_ros.mosaic.task import timed


@dataclass(frozen=True)
class Looking:
    """A tile to be looked at, and the file of arrays to write."""

    of: Surrounded
    path: str

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.of.name


@timed
def look(task: Looking) -> dict[str, Any]:
    """Write the core.geometry.looks.Looks and Columns of a tile; return what it came to."""
    own, memory = task.of.read()
    settings = task.of.config.refine
    beside = number_of_ids(memory) > MOST_DENSE
    taken = surrounded(memory, settings, block_numbers(memory, own.block_index), int(beside))
    looks = look_at(memory, taken, settings, beside)
    save_arrays(task.path, {**looks.arrays(), **columns_of(looks.index)._asdict()})
    return {'classes': np.unique(looks.votes.classes).tolist(), 'voxels': len(looks.shape),
            'pairs': list(pairs_of(looks.votes))}
