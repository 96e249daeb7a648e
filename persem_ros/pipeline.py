"""
The story in one page: observe, add, refine, render.

A pipeline is a map in the making. The node feeds it live, a replay feeds it a recording; both get
the same map from the same frames.

"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame import images
from persem_ros.core.frame.clear import clear
from persem_ros.core.frame.observe import gather
from persem_ros.core.frame.place import place
from persem_ros.core.frame.render import filled, render_map, voxel_image, voxel_image_of
from persem_ros.core.frame.stride import stride_of, thinned
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.frames import UNKNOWN

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.frames import Frame
    from persem_ros.settings.config import Config


class Pipeline:
    """
    One map and how it is made.

    Parameters
    ----------
    config : Config
    memory : VoxelMemory, optional
        A map to go on with; its voxel size, origin and history bound hold.

    Attributes
    ----------
    strides : Counter
        How many frames were observed by which stride.

    """

    def __init__(self, config: Config, memory: VoxelMemory | None = None) -> None:
        self.config = config
        self.memory = memory or VoxelMemory(
            config.memory.voxel_size, config.map.origin, config.memory.max_history)
        self.strides: Counter[int] = Counter()

    def observe(self, frame: Frame) -> Observations:
        """Return what a frame says about each voxel it sees."""
        stride = stride_of(frame, self.config.memory)
        self.strides[stride] += 1
        return self.sighted(thinned(frame, self.config.memory, stride))

    def add(self, frame: Frame) -> Observations:
        """Integrate a frame, clear what it looks through; return its observations."""
        observations = self.observe(frame)
        if self.memory.pager is not None:
            self.memory.pager.need_voxels(observations.voxels)
        self.memory.add(observations)
        clear(self.memory, frame, self.config.memory)
        return observations

    def refine(self, full: bool = True) -> int:
        """Refine the map; return the number of voxels visited."""
        return refine(self.memory, self.config.refine, full, self.config.memory.max_voxels)

    def refine_next(self) -> int:
        """Refine what is next in turn, as a node does; return the number of voxels visited."""
        job = begin_next(self.memory, self.config.refine, waits=False)
        return finish(job, *job.compute())

    def render(
            self, frame: Frame, observations: Observations | None = None) -> NDArray[np.int32]:
        """
        Return the refined label image of a frame, int32 on the labels' grid.

        observations, where add() has just returned them, save placing the pixels again (where
        no stride left pixels out).

        """
        voxels = self.voxel_image(frame, observations)
        image = render_map(self.memory, voxels)
        return filled(images.on_labels(frame, image, UNKNOWN), frame.labels, self.config.memory,
                      self.config.render.fill, self.unknown)

    def voxel_image(
            self, frame: Frame, observations: Observations | None = None) -> NDArray[np.int32]:
        """Return the voxel number of each depth pixel, int32; -1: no depth or unknown."""
        shape = frame.depth.shape
        if observations is not None and observations.where.size != frame.depth.size:
            observations = None         # a stride left pixels out
        if observations is None and self.memory.pager is not None:
            observations = self.sighted(frame)
            self.memory.pager.need_voxels(observations.voxels)
        if observations is not None:
            return voxel_image(self.memory, observations, shape)
        keys = place(images.measured(frame, self.config.memory), frame.T_map_camera,
                     self.memory.voxel_size, self.memory.origin)
        return voxel_image_of(self.memory, *keys, shape)

    def sighted(self, frame: Frame) -> Observations:
        """Return what all pixels of a frame say, whatever the stride."""
        settings = self.config.memory
        return gather(
            images.measured(frame, settings), images.on_depth(frame, frame.labels),
            images.counting(settings), frame.T_map_camera, self.memory.voxel_size,
            settings.min_pixels, self.memory.origin, frame.stamp, frame.sensor,
            frame.T_body_camera, images.weights(frame))

    @property
    def unknown(self) -> int:
        """Return the ignored id that stands for "unknown" in an image."""
        ignored = [c for c in self.config.memory.ignore_labels if c >= 0]
        return ignored[0] if ignored else 65535
