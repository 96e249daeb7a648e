"""tileset.json: where tiles lie, how coarse they are, and what they are divided into."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.core.memory.pools import SIDE
from persem_ros.outputs.tiles.octree import WITHIN

if TYPE_CHECKING:
    from persem_ros.outputs.tiles.octree import Tile
    from persem_ros.outputs.tiles.pyramid import Pyramid

DEEP = 4                # levels of one file; what lies below has files of its own


def tileset(pyramid: Pyramid, tile: Tile, name: Callable[[Tile, str], str | None],
            **root: Any) -> dict[str, Any]:
    """
    Return the JSON of a tile and of DEEP levels below it (OGC 3D Tiles 1.1).

    Parameters
    ----------
    pyramid : Pyramid
        Of the map.
    tile : Tile
        Where the tileset begins.
    name : callable
        name(tile, 'glb') and name(tile, 'json') give the URI of its content, or of a tileset of
        its own; None: it shows nothing.
    root
        What the root has besides, such as transform.

    """
    whole = {**_entry(pyramid, tile, name, DEEP), **root}
    return {'asset': {'version': '1.1', 'generator': 'persem_ros'},
            'geometricError': 2 * pyramid.size(tile), 'root': whole}


def _entry(pyramid: Pyramid, tile: Tile, name: Callable[[Tile, str], str | None],
           deep: int) -> dict[str, Any]:
    """Return the JSON of a tile; below *deep* levels it names another tileset."""
    low, high = pyramid.octree.reach(tile)
    cell, corner = max(1, 1 << tile.level >> WITHIN), np.array(tile.corner)
    low, high = (corner + (at - corner) // cell * cell for at in (low, high))
    high = high + cell - 1      # what is shown of a block fills its cell
    half = (high - low + 1) * SIDE * pyramid.source.voxel_size / 2
    middle = (low * SIDE - pyramid.anchor) * pyramid.source.voxel_size + half
    result: dict[str, Any] = {
        'boundingVolume': {'box': [*middle.tolist(), *np.diag(half).reshape(-1).tolist()]},
        'geometricError': pyramid.size(tile) if tile.level else 0, 'refine': 'REPLACE'}
    children = list(pyramid.octree.children(tile))
    apart = deep == 0 and bool(children)
    uri = name(tile, 'json' if apart else 'glb')
    if uri is not None:
        result['content'] = {'uri': uri}
    if children and not apart:
        result['children'] = [_entry(pyramid, child, name, deep - 1) for child in children]
    return result
