"""Refined tiles become one map file, row by row: what is left to one process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
import heapq
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.kept import fitted_by
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.frame_table import FrameTable
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.guard.database import checked, held_by
from persem_ros.mosaic.join import Part
from persem_ros.mosaic.plan import Plan, Tile
from persem_ros.outputs.map import store
from persem_ros.outputs.map.rows import frame_rows, whole_rows
from persem_ros.outputs.map.tables import KINDS, ORDER
from persem_ros.settings import config_file


class Frames:
    """
    The frame table of all parts, row by row, as often as it is asked for.

    Parameters
    ----------
    parts : sequence of Part
        In the order of the sessions.

    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = parts

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        before = 0
        for number, part in enumerate(self._parts):
            stamps = 0
            for row, t, _, *more in frame_rows(store.head(part.path).stored.saved.frames):
                yield row + part.first, t + before, number, *more
                stamps = max(stamps, t + 1)
            before += stamps


def frames_and_seen(parts: Sequence[Part]) -> tuple[
        NDArray[np.int32], NDArray[np.float64], NDArray[np.uint8]]:
    """Return t and the sensor's place (3,) of every frame, and which ids were seen, (65536,)."""
    t, placed, seen, before = [], [], np.zeros(65536, np.uint8), 0
    for part in parts:
        saved = store.head(part.path).stored.saved
        t.append(saved.frames.t + np.int32(before))
        placed.append(saved.frames.placed[:, :3, 3])
        before += int(saved.frames.t.max()) + 1
        seen |= saved.seen_ids
    return np.concatenate(t), np.concatenate(placed), seen


def volatility(tiles: Sequence[dict[str, Any]],
               ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the class counters of all tiles, starts and changes, and rho; (65536,) each."""
    memory = VoxelMemory(1.0)
    for tile in tiles:
        for c, starts, changes in tile['pairs']:
            memory.m.starts[c] += starts
            memory.m.changes[c] += changes
    return memory.m.starts, memory.m.changes, memory.volatility()


def assemble(path: Path, plan: Plan, parts: Sequence[Part], tiles: dict[Tile, Path],
             counts: Sequence[dict[str, Any]], seen: NDArray[np.uint8],
             habits: dict[str, NDArray[Any]]) -> None:
    """
    Write the map file of a build.

    Parameters
    ----------
    path : Path
        The file.
    plan : Plan
        Of the build.
    parts : sequence of Part
        The recordings' maps, for their frames and sessions.
    tiles : dict of Tile to Path
        Refined.
    counts : sequence of dict
        What join.join() gave for each tile.
    seen : ndarray, shape (65536,), uint8
        The ids that were seen.
    habits : dict of str to ndarray
        As of core.memory.dump.MemoryDump: of the method geometry, {} by others.

    """
    config = plan.config
    starts, changes, rho = volatility(counts)
    table = FrameTable()
    for number, part in enumerate(parts):
        table.sessions[number] = store.head(part.path).stored.saved.frames.sessions[0]
    saved = replace(
        dump(VoxelMemory(config.memory.voxel_size, config.map.origin,
                         config.memory.max_history)),
        starts=starts, changes=changes, rho=rho, seen_ids=seen, frames=table, habits=habits,
        fitted_by=fitted_by(config.refine) if habits else None)
    about = {'settings': config_file.to_yaml(config), 'map_frame': config.frames.map,
             'legend': plan.legend.to_yaml(), 'session': len(parts) - 1,
             **{name: sum(tile[name] for tile in counts)
                for name in ('blocks', 'voxels', 'observations')}}
    store.write(path, whole_rows(saved, about, Frames(parts), _blocks(tiles)))


def _blocks(tiles: dict[Tile, Path]) -> Iterator[Sequence[Any]]:
    """Yield the rows of all blocks in ascending index: band after band of tiles along y."""
    for _, band in groupby(sorted(tiles), key=lambda tile: tile.i):
        with ExitStack() as stack:
            yield from heapq.merge(*[_rows(stack, tiles[tile]) for tile in band],
                                   key=_index)


def _index(row: Sequence[Any]) -> tuple[int, ...]:
    """Return the index of the block in a row."""
    return tuple(row[:3])


def _rows(stack: ExitStack, path: Path) -> Iterator[Sequence[Any]]:
    """Return the rows of the blocks of a tile, as they lie there; *stack* keeps it open."""
    db, _ = stack.enter_context(store.reading(path))
    kinds: Any = KINDS['blocks']
    return checked(db.execute(f'SELECT * FROM blocks ORDER BY {ORDER["blocks"]}'), kinds,
                   held_by(path))
