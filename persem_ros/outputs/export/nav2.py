"""The grid of costs as Nav2's map server loads it: a .yaml and a .pgm, and classes beside."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.ground import ground_of, keys_of
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.files import write_bytes, write_text
from persem_ros.outputs.grid.cells import Cells, cells_of, MOST_CELLS
from persem_ros.outputs.grid.rule import costs_of, lowest_of, rule_of, UNKNOWN_CLASS
import yaml

if TYPE_CHECKING:
    from persem_ros.outputs.export.source import MapSource

UNKNOWN_PIXEL = 255         # Nav2's mode raw: 0 .. 100 are costs, all else unknown


def write_nav2(folder: Path | str, source: MapSource, choice: Choice) -> Cells:
    """
    Write FOLDER/map.yaml, map.pgm (costs) and labels.yaml, labels.pgm, labels.legend.yaml.

    labels.pgm has 16 bits a pixel where ids need them; Nav2 loads those of 8 bits.

    Raises
    ------
    PersemError
        For a legend without costs, a map whose z does not point up, a choice of nothing.

    """
    folder = Path(folder)
    cells = grid_of(source, choice)
    pixels = np.where(cells.cost < 0, UNKNOWN_PIXEL, cells.cost).astype(np.uint8)
    _write_pair(folder / 'map', pixels, cells, source)
    known = cells.label != UNKNOWN_CLASS
    if cells.label[known].max(initial=0) < UNKNOWN_PIXEL:
        _write_pair(folder / 'labels', np.where(known, cells.label, UNKNOWN_PIXEL).astype(
            np.uint8), cells, source)
    else:
        _write_pair(folder / 'labels', cells.label, cells, source)
    write_text(folder / 'labels.legend.yaml', source.legend.to_yaml())
    return cells


def grid_of(source: MapSource, choice: Choice) -> Cells:
    """Return the grid of a map; reads it twice, for the ground and for what stands on it."""
    config = source.config
    rule = rule_of(config, source.legend, source.voxel_size)
    chosen = Choice(max(choice.min_observations, rule.min_observations), choice.crop,
                    choice.labels)
    tiles, lowest = _lowest(source, chosen)
    if not len(tiles):
        source.summary_of_something(chosen)
    width, depth = (int(n) for n in (np.ptp(tiles.astype(np.int64), axis=0) + 1) * SIDE)
    if width * depth > MOST_CELLS:
        raise PersemError(f'{source.path}: a grid of {width} x {depth} columns is larger '
                          f'than {MOST_CELLS} cells; choose a part with --crop')
    ground = ground_of(tiles, lowest, rule.window)
    cost = np.full(lowest.shape, -1, np.int8)
    label = np.full(lowest.shape, UNKNOWN_CLASS, np.uint16)
    keys = keys_of(tiles)
    with source.shown(chosen, 'grid') as chunks:
        for columns in chunks:
            here, tile = _tiles(columns['voxel'])
            rows = np.searchsorted(keys, keys_of(here))
            cost[rows], label[rows] = costs_of(columns['voxel'], columns['label'], tile,
                                               ground.level[rows], rule)
    return cells_of(tiles, cost, label, source.voxel_size, config.grid.resolution,
                    config.grid.tie)


def _lowest(source: MapSource, choice: Choice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the map's tiles (T, 2), sorted, and the lowest voxels (T, 64) of their columns."""
    parts: list[Any] = []
    with source.shown(choice, 'ground') as chunks:
        for columns in chunks:
            tiles, tile = _tiles(columns['voxel'])
            parts.append((tiles, lowest_of(columns['voxel'], tile, len(tiles))))
    tiles, lowest = (np.concatenate(column) for column in zip(*parts)) if parts else \
        (np.empty((0, 2), np.int32), np.empty((0, SIDE * SIDE), np.int32))
    order = np.argsort(keys_of(tiles))
    return tiles[order], lowest[order]


def _tiles(voxel: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the tiles (T, 2) of voxels, and each voxel's row in them."""
    keys, first, tile = np.unique(keys_of(voxel[:, :2] >> 3), return_index=True,
                                  return_inverse=True)
    return voxel[first, :2] >> 3, tile.reshape(-1).astype(np.int64)


def _write_pair(stem: Path, pixels: NDArray[Any], cells: Cells, source: MapSource) -> None:
    """Write an image, its first row in the north, and the YAML that places it."""
    height, width = pixels.shape
    most = 255 if pixels.dtype == np.uint8 else 65535
    image = np.ascontiguousarray(pixels[::-1], pixels.dtype.newbyteorder('>'))
    write_bytes(stem.with_suffix('.pgm'), f'P5\n{width} {height}\n{most}\n'.encode(),
                image.tobytes())
    corner = [cells.corner[axis] * cells.size + float(source.origin[axis]) for axis in (0, 1)]
    write_text(stem.with_suffix('.yaml'), yaml.safe_dump(
        {'image': f'{stem.name}.pgm', 'mode': 'raw', 'resolution': cells.size,
         'origin': [*corner, 0.0], 'negate': 0, 'occupied_thresh': 0.65, 'free_thresh': 0.196},
        sort_keys=False))
