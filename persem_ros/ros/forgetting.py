"""What a node lets go of: blocks too far away, or too many, between two refinements."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.evict import keep_near

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Memory

TRIM = 0.5              # s between two looks at what is too far away
AT_ONCE = 20_000        # voxels that are forgotten between two frames


def last_position(memory: VoxelMemory) -> NDArray[np.float64]:
    """Return where the camera was last, shape (3,), metres in the map frame."""
    frames = memory.frames
    return frames[-1].T_map_sensor[:3, 3] if frames else np.array(memory.origin)


class Forgetting:
    """Keeps a map within memory.keep_radius and memory.max_voxels, a little at a time."""

    def __init__(self) -> None:
        """Look after `TRIM` seconds at first."""
        self._trimmed = time.monotonic()

    def step(self, memory: VoxelMemory, settings: Memory) -> int:
        """
        Let go of what is farthest, where it is time; return how many voxels the map has lost.

        An attached map loses none: they are in its file.

        """
        if not memory.frames or not (settings.max_voxels or settings.keep_radius) or \
                time.monotonic() - self._trimmed < TRIM:
            return 0
        if memory.pager is not None:
            self._trimmed = time.monotonic() - TRIM * (0 < memory.pager.let_go(
                last_position(memory), settings.max_voxels, settings.keep_radius, AT_ONCE))
            return 0
        x, y, z = last_position(memory).tolist()
        gone = keep_near(memory, (x, y, z), settings.keep_radius, settings.max_voxels, AT_ONCE)
        if not gone:
            self._trimmed = time.monotonic()
        return gone
