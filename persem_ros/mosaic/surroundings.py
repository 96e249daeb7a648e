"""A tile in memory, with the ring of blocks around it: what decides on its labels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.dump import Blocks, MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.mosaic.blocks import side_by_side
from persem_ros.mosaic.folder import load_array
from persem_ros.mosaic.plan import Tile
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config


@dataclass(frozen=True)
class Surrounded:
    """
    A tile and the files of what lies around it.

    Attributes
    ----------
    tile : Tile
    path : str
        Its map file.
    around : tuple of str
        Those of the tiles that touch it.
    config : Config
        Of the map.
    stamps, placed, seen : str
        Files of arrays: t of every frame, int32; where its sensor was, float64 (frames, 3); the
        ids that were seen, uint8 (65536,).

    """

    tile: Tile
    path: str
    around: tuple[str, ...]
    config: Config
    stamps: str
    placed: str
    seen: str

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.tile.name

    def read(self) -> tuple[Blocks, VoxelMemory]:
        """
        Return the tile's blocks, and a memory of these and of the ring around them.

        What is read of the tiles around, their evidence, is the same whether they are refined.

        """
        tile = self.tile
        low = tile.low[0] - 1, tile.low[1] - 1, tile.low[2]
        high = tile.high[0] + 1, tile.high[1] + 1, tile.high[2]
        own = store.load_blocks(self.path, tile.low, tile.high)
        return own, self._memory([own, *(store.load_blocks(path, low, high)
                                         for path in self.around)])

    def _memory(self, parts: list[Blocks]) -> VoxelMemory:
        """Return a memory of some blocks, with the frames that their histories name."""
        columns = side_by_side(parts)
        f, columns['history_frame'] = np.unique(columns['history_frame'], return_inverse=True)
        columns['history_frame'] = columns['history_frame'].astype(np.int32)
        columns['dirty'] = np.zeros(len(columns['cell']), np.uint8)
        return load(replace(
            empty(self.config), **columns, seen_ids=np.array(load_array(self.seen)),
            frames=_frames(load_array(self.stamps)[f], load_array(self.placed)[f])))


def empty(config: Config) -> MemoryDump:
    """Return the dump of a map without anything."""
    return dump(VoxelMemory(config.memory.voxel_size, config.map.origin,
                            config.memory.max_history))


def _frames(t: NDArray[np.int32], placed: NDArray[np.float64]) -> FrameTable:
    """Return a frame table of which t and the sensors' places matter, and nothing else."""
    table, n = FrameTable(), len(t)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3] = placed
    table.extend(t, np.zeros(n, np.int64), [''] * n, np.zeros(n, np.int64), T, None)
    return table
