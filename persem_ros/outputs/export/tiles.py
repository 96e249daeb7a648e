"""The map as 3D Tiles 1.1: a folder that CesiumJS, QGIS and three.js stream by level of detail."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
from typing import TYPE_CHECKING

from persem_ros.outputs.files import write_bytes
from persem_ros.outputs.progress import progress
from persem_ros.outputs.tiles.glb import glb
from persem_ros.outputs.tiles.octree import Octree, Tile
from persem_ros.outputs.tiles.pyramid import Pyramid
from persem_ros.outputs.tiles.tileset import DEEP, tileset

if TYPE_CHECKING:
    from persem_ros.outputs.export.choice import Choice
    from persem_ros.outputs.export.source import MapSource


def write_tiles(folder: Path | str, source: MapSource, choice: Choice) -> tuple[int, int]:
    """
    Write tileset.json, and what it names in the folder tiles beside it.

    Coordinates are metres in the map frame. tileset.json is written last.

    Returns
    -------
    tiles, points : int

    """
    source.summary_of_something(choice)
    pyramid = Pyramid(source, Octree(source.index()[0]), choice)
    folder, empty = Path(folder), set()
    n = points = 0
    every = list(_every(pyramid.octree, pyramid.octree.root))
    with progress((tile for tile in every), 'tiles', len(every), 'tiles') as tiles:
        for tile in tiles:
            found = pyramid.points(tile)
            if not len(found):
                empty.add(tile)
                continue
            write_bytes(folder / 'tiles' / f'{_name(tile)}.glb',
                        glb(found, pyramid.size(tile), pyramid.corner(tile)))
            n, points = n + 1, points + len(found)

    def below(up: str, tile: Tile, suffix: str) -> str | None:
        return None if suffix == 'glb' and tile in empty else \
            f'{up}tiles/{_name(tile)}.{suffix}'

    root = pyramid.octree.root
    for tile in every:
        if tile.level and tile.level < root.level and (root.level - tile.level) % DEEP == 0:
            write_bytes(folder / 'tiles' / f'{_name(tile)}.json', _text(tileset(
                pyramid, tile, lambda tile, suffix: below('../', tile, suffix))))
    offset = (pyramid.anchor * source.voxel_size + source.origin).tolist()
    write_bytes(folder / 'tileset.json', _text(tileset(
        pyramid, root, lambda tile, suffix: below('', tile, suffix),
        transform=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, *offset, 1])))
    return n, points


def _every(octree: Octree, tile: Tile) -> Iterator[Tile]:
    """Yield a tile and all below it."""
    yield tile
    for child in octree.children(tile):
        yield from _every(octree, child)


def _name(tile: Tile) -> str:
    return f'{tile.level}_{"_".join(map(str, tile.corner))}'


def _text(value: object) -> bytes:
    return json.dumps(value, separators=(',', ':'), allow_nan=False).encode()
