"""The map of a replay, whole in memory: where it begins, its files, what pages show of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from persem_ros.core.geometry.overruled import Overruled, overruled
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.cloud import map_points, SOURCES
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.ply import map_comments, write_ply
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend


@dataclass(frozen=True, eq=False)
class Overview:
    """
    What pages and figures show of a map.

    Attributes
    ----------
    columns : dict
        As of VoxelMemory.voxels(), without its number and switches where the map is coarser.
    voxel_size : float
        Metres, of these columns.
    labels : dict of int to int
        Voxels of the map by label.
    sources : ndarray, int64
        Voxels of the map by what decided their label.

    """

    columns: dict[str, Any]
    voxel_size: float
    labels: dict[int, int]
    sources: NDArray[np.int64]


class Mapped:
    """
    A map in memory.

    Parameters
    ----------
    memory : VoxelMemory or None
        None: an empty one.
    config : Config
    legend : Legend

    """

    paged = False

    def __init__(self, memory: VoxelMemory | None, config: Config, legend: Legend) -> None:
        self.config, self.legend = config, legend
        self.memory = memory or VoxelMemory(
            config.memory.voxel_size, config.map.origin, config.memory.max_history)

    @property
    def n_voxels(self) -> int:
        """Return the number of voxels of the whole map."""
        return self.memory.n_voxels

    def make_room(self, position: ArrayLike) -> None:
        """Keep to the bounds of memory, between two frames; *position* (3,) is the camera's."""

    def settle(self) -> None:
        """Be ready to be counted: all was observed."""

    def write(self, folder: Path) -> None:
        """Write map.ply and map.persem of the refined map."""
        self._points = map_points(self.memory.voxels(), self.memory.voxel_size, self.legend)
        write_ply(folder / 'map.ply', self._points, self.comments())
        store.save(folder / 'map.persem', self.memory, self.config, self.legend)

    def points(self) -> NDArray[np.void]:
        """Return the points of the topic ~/map, persem_ros.outputs.map.cloud.POINT."""
        return self._points

    def overview(self) -> Overview:
        """Return what pages show."""
        columns = self.memory.voxels()
        labels = np.unique(columns['label'], return_counts=True)
        return Overview(columns, self.memory.voxel_size,
                        dict(zip(*(a.tolist() for a in labels))),
                        np.bincount(columns['source'], minlength=len(SOURCES)))

    def overruled(self, labels: NDArray[np.uint16] | None = None) -> list[Overruled]:
        """
        Return what heights of classes do to their votes, where a map in memory goes by any.

        labels, by voxel number, are those of geometry where the map's own are of another method.

        """
        refine = self.config.refine
        if not refine.geometry.heights or refine.method != 'geometry' and labels is None:
            return []
        columns = self.memory.columns()
        if labels is not None:
            columns['label'] = labels[columns['number']]
        return overruled(columns, refine)

    def comments(self) -> list[str]:
        """Return the lines in the header of map.ply."""
        x, y, z = self.memory.origin
        return map_comments(self.config.frames.map, (x, y, z), self.memory.voxel_size)

    def close(self) -> None:
        """Let go of what is open."""


def start_map(config: Config, legend: Legend) -> Mapped:
    """Return the map of map.path, in a new session, or an empty one."""
    if not config.map.path or config.map.attached and not Path(config.map.path).exists():
        memory = None
    else:
        memory = store.load(config.map.path).memory(config)
        memory.new_session()
    mapped = Mapped(memory, config, legend)
    mapped.memory.keeps_all = config.map.attached
    return mapped


@contextmanager
def attached(config: Config) -> Iterator[None]:
    """Hold the right to write map.path where map.attached asks for it."""
    if not config.map.attached:
        yield
        return
    if not config.map.path:
        raise PersemError('map.attached needs a file: --set map.path=map.persem')
    path = Path(config.map.path)
    lock = WriterLock(path)
    try:
        store.fold_log(path, locked=True)
        yield
    finally:
        lock.close()
