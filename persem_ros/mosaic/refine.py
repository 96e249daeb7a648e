"""A tile is refined: with the ring of blocks around it and the class volatility of the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.dump import Blocks, load, MemoryDump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.paging import block_numbers
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.job import finish, Job, number_of_ids
from persem_ros.core.warmup import warm_up
from persem_ros.mosaic.blocks import side_by_side
from persem_ros.mosaic.folder import load_array
from persem_ros.mosaic.plan import Tile
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config, Refine


@dataclass(frozen=True)
class Refining:
    """
    A tile to be refined.

    Attributes
    ----------
    tile : Tile
    path : str
        Its map file, which is replaced.
    around : tuple of str
        Those of the tiles that touch it.
    config : Config
        Of the map.
    stamps, seen, rho : str
        Files of arrays: t of every frame, int32; the ids that were seen, uint8 (65536,); the
        class volatility, float64 (65536,).

    """

    tile: Tile
    path: str
    around: tuple[str, ...]
    config: Config
    stamps: str
    seen: str
    rho: str

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.tile.name


def refine(task: Refining, tick: Callable[..., Any] | None = None) -> dict[str, Any]:
    """
    Write a tile anew with refined labels; return what it took.

    What is read of the tiles around, their evidence, is the same whether they are refined.

    """
    warm_up(False)
    began = time.perf_counter()
    tile = task.tile
    low = tile.low[0] - 1, tile.low[1] - 1, tile.low[2]
    high = tile.high[0] + 1, tile.high[1] + 1, tile.high[2]
    own = store.load_blocks(task.path, tile.low, tile.high)
    ring = [store.load_blocks(path, low, high) for path in task.around]
    memory = _memory([own, *ring], task)
    _refine(memory, block_numbers(memory, own.block_index), task.config.refine)
    done = dump(memory)
    here = np.repeat(tile.holds(done.block_index), np.diff(done.block_start))
    store.save(task.path, replace(
        _empty(task.config), rho=memory.rho, **{
            **{field.name: getattr(own, field.name) for field in fields(Blocks)},
            'label': done.label[here], 'source': done.source[here],
            'dirty': np.zeros(len(own.cell), np.uint8)}), task.config)
    if tick is not None:
        tick()
    return {'tile': [tile.i, tile.j], 'seconds': round(time.perf_counter() - began, 3)}


def _memory(parts: list[Blocks], task: Refining) -> VoxelMemory:
    """Return a memory of some blocks, with the frames that their histories name."""
    columns = side_by_side(parts)
    f, columns['history_frame'] = np.unique(columns['history_frame'], return_inverse=True)
    columns['history_frame'] = columns['history_frame'].astype(np.int32)
    columns['dirty'] = np.zeros(len(columns['cell']), np.uint8)
    memory = load(replace(
        _empty(task.config), **columns, seen_ids=np.array(load_array(task.seen)),
        rho=np.array(load_array(task.rho)), frames=_frames(load_array(task.stamps)[f])))
    return memory


def _refine(memory: VoxelMemory, blocks: NDArray[np.int64], settings: Refine) -> None:
    """Refine blocks of the given numbers by the volatility that memory has."""
    taken = snapshot.take(memory, settings.neighbours, blocks)
    memory.refinements += 1
    rho: Any = memory.rho
    done: Any = Job(memory, settings, taken, rho, number_of_ids(memory), None)
    finish(done, *done.compute())


def _frames(t: NDArray[np.int32]) -> FrameTable:
    """Return a frame table of which only t matters."""
    table, n = FrameTable(), len(t)
    table.extend(t, np.zeros(n, np.int64), [''] * n, np.zeros(n, np.int64),
                 np.broadcast_to(np.eye(4), (n, 4, 4)), None)
    return table


def _empty(config: Config) -> MemoryDump:
    """Return the dump of a map without anything."""
    return dump(VoxelMemory(config.memory.voxel_size, config.map.origin,
                            config.memory.max_history))
