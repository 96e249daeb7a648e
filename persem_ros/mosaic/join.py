"""A tile of the map: what all recordings saw of it, in their order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.mosaic.blocks import joined
from persem_ros.mosaic.folder import load_array
from persem_ros.mosaic.plan import Tile
from persem_ros.mosaic.task import timed
from persem_ros.outputs.map import store
from persem_ros.outputs.map.checks import check_blocks
from persem_ros.settings.config import Config


@dataclass(frozen=True)
class Part:
    """A recording's map file, and which rows of the frame table its frames have."""

    path: str
    first: int
    frames: int


@dataclass(frozen=True)
class Joining:
    """
    A tile to be put together.

    Attributes
    ----------
    tile : Tile
    parts : tuple of Part
        Those that saw something of it, in the order of their sessions.
    config : Config
        Of the map.
    stamps, seen : str
        Files of arrays: t of every frame, int32; the ids that were seen, uint8 (65536,).
    path : str
        Of the map file to write.

    """

    tile: Tile
    parts: tuple[Part, ...]
    config: Config
    stamps: str
    seen: str
    path: str

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.tile.name


@timed
def join(task: Joining) -> dict[str, Any]:
    """
    Write a tile, not refined and without frames, as a map file; return what it came to.

    Raises
    ------
    PersemError
        When a part is damaged, or the file cannot be written.

    """
    t, seen = load_array(task.stamps), np.array(load_array(task.seen))
    blocks = []
    for part in task.parts:
        found = store.load_blocks(part.path, task.tile.low, task.tile.high)
        try:
            check_blocks(found, np.array(t[part.first:part.first + part.frames]), seen)
        except ValueError as error:
            raise PersemError(f'{part.path}: damaged ({error}); give --force to build anew') \
                from None
        blocks.append(found)
    whole = joined(blocks, [part.first for part in task.parts], task.config.memory.voxel_size,
                   task.config.map.origin, task.config.memory.max_history)
    store.save(task.path, whole, task.config)
    ids = np.flatnonzero(whole.starts)
    return {'tile': [task.tile.i, task.tile.j], 'blocks': len(whole.block_index),
            'voxels': len(whole.cell), 'observations': int(whole.observations.sum(dtype=int)),
            'pairs': [[int(c), int(whole.starts[c]), int(whole.changes[c])] for c in ids]}
