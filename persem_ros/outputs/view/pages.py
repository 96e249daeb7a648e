"""What the viewer's page can ask for, by name: itself, tiles, what the map is, why a voxel is."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
import json
import re
from typing import Any, NamedTuple
from urllib.parse import parse_qs

import numpy as np
from persem_ros.core.memory.pools import SIDE
from persem_ros.errors import PersemError
from persem_ros.outputs.map.cloud import SOURCES
from persem_ros.outputs.map.explanation import names
from persem_ros.outputs.map.part import explained, surroundings
from persem_ros.outputs.report.colors import ramp, SOURCE_COLORS, SOURCE_TEXTS
from persem_ros.outputs.view.living import LivingView

TILE = re.compile(r'tiles/(\d{1,2})_(-?\d{1,10})_(-?\d{1,10})_(-?\d{1,10})_\d{1,18}\.(glb|json)',
                  re.ASCII)
NUMBER = re.compile(r'-?\d{1,12}(\.\d{1,12})?', re.ASCII)
ASSETS = {'': ('index.html', 'text/html; charset=utf-8'),
          'view.css': ('view.css', 'text/css; charset=utf-8'),
          'view.js': ('view.js', 'text/javascript; charset=utf-8'),
          'shaders.js': ('shaders.js', 'text/javascript; charset=utf-8'),
          'tiles.min.js': ('tiles.min.js', 'text/javascript; charset=utf-8')}
ON_A_LINE = 2000            # points of a camera's path that are shown
RAYS = 200                  # the newest observations of a voxel that are drawn
FARTHEST = 64               # voxels from a click


class Answer(NamedTuple):
    """What a request is answered with; kept: the browser may keep it for as long as it likes."""

    kind: str
    data: bytes
    kept: bool = False


class Pages:
    """Answers requests for names; anything else has no answer (None)."""

    def __init__(self, view: LivingView) -> None:
        self.view = view
        self._pages: dict[str, Callable[[dict[str, list[str]]], Any]] = {
            'info.json': self._info, 'changes.json': self._changes, 'tracks.json': self._tracks,
            'explain.json': self._explain}

    def answer(self, name: str, query: str) -> Answer | None:
        """
        Return the Answer to a request, None for a name that means nothing.

        Raises
        ------
        PersemError
            For numbers that are none, and where the map cannot be read.

        """
        if name in ASSETS:
            file, kind = ASSETS[name]
            folder = resources.files('persem_ros.outputs.view') / 'assets'
            return Answer(kind, (folder / file).read_bytes())
        if name == 'tileset.json':
            return _json(self.view.tileset())
        if name in self._pages:
            return _json(self._pages[name](parse_qs(query, max_num_fields=10)))
        found = TILE.fullmatch(name)
        return self._tile(found) if found else None

    def _tile(self, found: re.Match[str]) -> Answer | None:
        """Return a tile's points, or the tileset below it."""
        level, x, y, z = (int(word) for word in found.groups()[:4])
        if found[5] == 'json':
            below = self.view.tileset(level, (x, y, z))
            return None if below is None else _json(below, True)
        data = self.view.content(level, (x, y, z))
        return None if data is None else Answer('model/gltf-binary', data, True)

    def _info(self, _: dict[str, list[str]]) -> dict[str, Any]:
        """Return what the page shows around the map."""
        generation = self.view.look()
        source, pyramid = self.view.source, self.view.pyramid
        name, stamps = names(source.legend), source.stamps
        low, high = pyramid.octree.reach(pyramid.octree.root)
        return {
            'generation': generation, 'name': source.path.name, 'voxels': source.n_voxels,
            'frames': len(stamps), 'mapFrame': source.map_frame,
            'voxelSize': source.voxel_size, 'anchor': pyramid.anchor.tolist(),
            'offset': (pyramid.anchor * source.voxel_size + source.origin).tolist(),
            'low': ((low * SIDE - pyramid.anchor) * source.voxel_size).tolist(),
            'high': (((high + 1) * SIDE - pyramid.anchor) * source.voxel_size).tolist(),
            'seconds': float(stamps.max() - pyramid.start) / 1e9 if len(stamps) else 0.0,
            'start': pyramid.start // 10 ** 6,
            'classes': [{'id': c, 'name': name(c), 'color': source.legend.color(c)}
                        for c in source.seen],
            'sources': [{'name': word, 'text': SOURCE_TEXTS[word], 'color': color}
                        for word, color in zip(SOURCES, SOURCE_COLORS)],
            'ramp': ramp()[::5].tolist()}

    def _changes(self, _: dict[str, list[str]]) -> dict[str, int]:
        """Return which state of the map there is now."""
        return {'generation': self.view.look()}

    def _tracks(self, _: dict[str, list[str]]) -> list[list[list[float]]]:
        """Return the paths of all cameras, a line for each session and camera."""
        source, pyramid = self.view.source, self.view.pyramid
        lines: dict[Any, list[int]] = {}
        for row, key in enumerate(source.lines[:len(source.positions)]):
            lines.setdefault(key, []).append(row)
        away = source.positions - source.origin - pyramid.anchor * source.voxel_size
        return [np.round(away[rows[::-(-len(rows) // ON_A_LINE)] + rows[-1:]], 3).tolist()
                for rows in lines.values()]

    def _explain(self, query: dict[str, list[str]]) -> dict[str, Any]:
        """Return why the voxel at a point has its label, and from where it was seen."""
        point = np.array([_number(query, axis) for axis in 'xyz'])
        source = self.view.source
        place = point / source.voxel_size + self.view.pyramid.anchor
        within = min(max(_number(query, 'within'), 2.0), FARTHEST)
        voxel = self.view.nearest(place, within)
        if voxel is None:
            raise PersemError(f'nothing was observed within {within:.0f} voxels of this place')
        corner = (voxel - self.view.pyramid.anchor) * source.voxel_size
        stored, memory, voxel = surroundings(source.path, source.centres(voxel))
        text, trace = explained(stored, memory, voxel)
        labels, _, frames, _ = memory.sightings(voxel)
        eyes = memory.frames.placed[frames[-RAYS:], :3, 3] - source.origin - \
            self.view.pyramid.anchor * source.voxel_size
        legend = stored.legend
        return {'text': text, 'corner': corner.tolist(),
                'name': names(legend)(trace['stored_label']),
                'color': legend.color(trace['stored_label']),
                'eyes': np.round(eyes, 3).tolist(),
                'colors': legend.colors(labels[-RAYS:]).tolist()}


def _json(value: Any, kept: bool = False) -> Answer:
    return Answer('application/json', json.dumps(
        value, separators=(',', ':'), allow_nan=False).encode(), kept)


def _number(query: dict[str, list[str]], name: str) -> float:
    """Return a number of a query."""
    words = query.get(name, [])
    if len(words) != 1 or not NUMBER.fullmatch(words[0]):
        raise PersemError(f'{name}: expected one number with up to 12 digits')
    return float(words[0])
