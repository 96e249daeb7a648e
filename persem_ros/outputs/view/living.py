"""The map that is looked at: its tiles by version, and what changed in the file meanwhile."""

from __future__ import annotations

from collections import OrderedDict
import os
from pathlib import Path
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError
from persem_ros.outputs.export.columns import Columns
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.tiles.glb import glb
from persem_ros.outputs.tiles.octree import Octree, Tile
from persem_ros.outputs.tiles.pyramid import Pyramid
from persem_ros.outputs.tiles.tileset import tileset

KEPT = 256 << 20            # bytes of tiles that are kept
NEAREST = 256               # blocks that are searched for a voxel beside a point
Key = tuple[int, tuple[int, int, int], int]


class LivingView:
    """
    A map file, looked at while it may be written.

    Any thread may call; one at a time reads.

    Parameters
    ----------
    path : Path
        The file; one without voxels is refused.

    Attributes
    ----------
    generation : int
        Counts how often the file was found changed.
    source : MapSource
    pyramid : Pyramid

    """

    def __init__(self, path: Path) -> None:
        self.path, self.generation = path, 0
        self._lock = threading.RLock()
        self._made: OrderedDict[Key, bytes] = OrderedDict()
        self._bytes = 0
        self._signature: tuple[Any, ...]
        self._version: NDArray[np.int64]
        self.pyramid: Pyramid
        self._open()

    def look(self) -> int:
        """Take in what changed in the file; return the generation."""
        with self._lock:
            now = _signature(self.path)
            if now == self._signature:
                return self.generation
            index, mark = self._changes(now)
            if index is None:
                self._open()
            elif len(index):
                self._take(index)
            self._signature, self._mark = now, mark
            self.generation += 1
            self._version[self.pyramid.octree.find(index) if index is not None else slice(None)] \
                = self.generation
            return self.generation

    def tileset(self, level: int | None = None, corner: tuple[int, int, int] = (0, 0, 0),
                ) -> dict[str, Any] | None:
        """Return the JSON of a tile, of the root by default; None for one that is not there."""
        with self._lock:
            octree = self.pyramid.octree
            tile = octree.root if level is None else octree.tile(level, corner)
            up = '' if level is None else '../'
            return None if tile is None else tileset(self.pyramid, tile, lambda tile, suffix:
                                                     f'{up}tiles/{self._name(tile)}.{suffix}')

    def content(self, level: int, corner: tuple[int, int, int]) -> bytes | None:
        """Return the .glb of a tile, as it is now; None for one that is not there."""
        with self._lock:
            tile = self.pyramid.octree.tile(level, corner)
            if tile is None:
                return None
            key = level, corner, self._newest(tile)
            if key not in self._made:
                points = self.pyramid.points(tile)
                self._made[key] = glb(points, self.pyramid.size(tile), self.pyramid.corner(tile))
                self._bytes += len(self._made[key])
                while self._bytes > KEPT and len(self._made) > 1:
                    self._bytes -= len(self._made.popitem(last=False)[1])
            self._made.move_to_end(key)
            return self._made[key]

    def nearest(self, place: NDArray[np.float64], within: float) -> NDArray[np.int32] | None:
        """Return the voxel at a place (voxels from the map's origin), or the nearest around it."""
        low, high = (np.floor((place + sign * within) / SIDE).astype(np.int64)
                     for sign in (-1, 1))
        spans = [np.arange(a, b + 1) for a, b in zip(low, high)]
        blocks = np.stack(np.meshgrid(*spans, indexing='ij'), axis=-1).reshape(-1, 3)
        with self._lock:
            blocks = blocks[self.pyramid.octree.find(blocks) >= 0]
            away = np.linalg.norm((blocks + 0.5) * SIDE - place, axis=1)
            blocks = blocks[np.argsort(away, kind='stable')[:NEAREST]]
            if not len(blocks):
                return None
            columns: Columns = self.source.blocks(blocks.astype(np.int32), self.pyramid.choice)
        voxel = columns['voxel']
        if not len(voxel):
            return None
        inside = (voxel == np.floor(place)).all(axis=1)
        away = np.where(inside, -1, np.linalg.norm(voxel + 0.5 - place, axis=1))
        best = int(np.argmin(away))
        return voxel[best] if away[best] <= within + 1 else None

    def _open(self) -> None:
        """Open the file from its beginning."""
        self._signature = _signature(self.path)
        self.source = MapSource(self.path)
        index, self._mark = self.source.index()
        if not len(index):
            raise PersemError(f'{self.path}: there is nothing to look at, the map is empty; of a '
                              'map that is being made, look again after its first checkpoint')
        self.pyramid = Pyramid(self.source, Octree(index))
        self._version = np.full(len(index), self.generation, np.int64)

    def _changes(self, now: Any) -> tuple[NDArray[np.int32] | None, int]:
        """Return the blocks that were written since the last look; None: it is another file."""
        if now[0] != self._signature[0]:
            return None, self._mark
        index, mark = self.source.index(self._mark)
        return (None if mark < self._mark else index), mark

    def _take(self, index: NDArray[np.int32]) -> None:
        """Take in blocks that were written."""
        old, self.source = self.pyramid.octree, MapSource(self.path)
        self.pyramid.source = self.source
        new = index[old.find(index) < 0]
        octree = old if not len(new) else Octree(np.concatenate([old.index, new]))
        version = np.full(len(octree.index), self.generation, np.int64)
        version[octree.find(old.index)] = self._version
        self.pyramid.changed(octree, index)
        self._version = version

    def _newest(self, tile: Tile) -> int:
        """Return the generation in which a tile changed last."""
        return int(self._version[tile.first:tile.last].max())

    def _name(self, tile: Tile) -> str:
        """Return the name of what a tile is now."""
        return f'{tile.level}_{"_".join(map(str, tile.corner))}_{self._newest(tile)}'


def _signature(path: Path) -> tuple[Any, ...]:
    """Return what differs when a file, or the log beside it, was written."""
    found: list[tuple[int, ...]] = []
    for name in (os.fspath(path), f'{path}-wal'):
        try:
            status = os.stat(name)
            found.append((status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns))
        except OSError:
            found.append(())
    return found[0][:2], *found
