"""Whether the voxels suit the recording: neither coarse for its pixels nor too fine for it."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import TYPE_CHECKING

import numpy as np
from persem_ros.core.frame.stride import stride_of

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Frame
    from persem_ros.settings.config import Memory

EVERY = 8           # pixels between those whose depth is looked at
PIXELS = 60.0       # across a voxel: more is coarse
GOOD = 10.0         # pixels across the voxel proposed in place of a coarse one
ENOUGH = 4.0        # pixels across the voxel proposed in place of a fine one, at least
SEEN = 1.5          # observations per voxel: fewer is too fine …
FRAMES = 10         # … where there are at least that many frames


class VoxelFit:
    """
    What a voxel spans in the images, and how often it is seen again.

    Parameters
    ----------
    settings : Memory

    """

    def __init__(self, settings: Memory) -> None:
        self._settings = settings
        self._depths: list[float] = []          # by frame, metres
        self._footprints: list[float] = []

    def frame(self, frame: Frame) -> None:
        """Look at a frame that was integrated."""
        if frame.points is not None:
            return      # of a cloud, whose points are no pixels of any size
        settings, depth = self._settings, frame.depth[::EVERY, ::EVERY]
        depth = depth[(depth > 0.0) & (settings.min_depth <= depth)
                      & (depth <= settings.max_depth)]
        if len(depth):
            middle = float(np.median(depth))
            self._depths.append(middle)
            self._footprints.append(
                stride_of(frame, settings) * middle / float(frame.camera.K[0, 0]))

    def sentences(self, memory: VoxelMemory, voxels: int | None = None) -> Iterator[str]:
        """Yield what there is to say of a map of so many *voxels*; None: all are in memory."""
        voxels = memory.n_voxels if voxels is None else voxels
        if not self._depths or not voxels:
            return
        depth, footprint = np.median(self._depths), float(np.median(self._footprints))
        size = memory.voxel_size
        if size > PIXELS * footprint:
            yield (f'a voxel of {size:g} m spans about {size / footprint:.0f} pixels at the '
                   f'median depth of {depth:.2g} m, so small things vanish in it: try '
                   f'--set memory.voxel_size={_rounded(GOOD * footprint)}')
        seen = memory.n_observations / voxels
        if seen < SEEN and len(self._depths) >= FRAMES:
            proposal = _rounded(max(ENOUGH * footprint, 2 * size))
            yield (f'hardly any voxel was seen twice: {seen:.1f} observations per voxel in '
                   f'{len(self._depths)} frames, so there is nothing to refine; are poses '
                   '(pose.child_frame), camera info (topics.camera_info) and depth (depth.scale, '
                   'depth.kind) right? If so, larger voxels are seen more often, for example '
                   f'--set memory.voxel_size={proposal}')


def _rounded(metres: float) -> str:
    """Return a length rounded to one digit, at least the smallest voxel, as text."""
    step = 10.0 ** math.floor(math.log10(metres))
    return f'{max(round(metres / step) * step, 1e-3):.6g}'
