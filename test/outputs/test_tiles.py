"""Tiles of a map: every voxel is in the smallest ones, coarse ones stand for what is below."""

import json

import core_worlds as cw
import numpy as np
from persem_ros.cli import main
from persem_ros.core.memory.pools import SIDE
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.outputs.tiles.cells import EDGE, GONE, open_sides, POINT, points_of, seen_most
from persem_ros.outputs.tiles.octree import LEAF, morton, Octree
from persem_ros.outputs.tiles.pyramid import Pyramid
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend
import pytest

LEGEND = Legend.from_yaml("""
classes:
- {id: 1, name: ground, color: [128, 128, 128]}
- {id: 2, name: "<script>alert(1)</script>", color: [255, 0, 0]}
""")


@pytest.fixture(scope='module')
def hills(tmp_path_factory):
    """Return the path of a map of a hilly ground, 150 voxels wide, a solid cube, and a stray."""
    seen = {(i - 40, j - 70, (i * j) % 11 - 5): (1, 1.0)
            for i in range(150) for j in range(150) if (i + j) % 3}
    seen |= {(i, j, k): (2, 1.0) for i in range(4) for j in range(4) for k in range(20, 24)}
    seen[1500, -900, 30] = (2, 1.0)
    memory = cw.core_of([])
    for t in range(2):
        memory.add(cw.observations(10 ** 9 * t + 5, seen))
        seen.pop(next(iter(seen)))
    refine(memory, Config().refine)
    path = tmp_path_factory.mktemp('hills') / 'map.persem'
    store.save(path, memory, Config(), LEGEND)
    return path


@pytest.fixture(scope='module')
def pyramid(hills):
    """Return the map's Pyramid."""
    source = MapSource(hills)
    return Pyramid(source, Octree(source.index()[0]))


def all_tiles(octree):
    """Return every tile, from the root on."""
    found = [octree.root]
    for tile in found:
        found += octree.children(tile)
    return found


def test_the_smallest_tiles_divide_the_map(pyramid):
    tiles = [tile for tile in all_tiles(pyramid.octree) if tile.level == 0]
    stretches = sorted((tile.first, tile.last) for tile in tiles)
    assert [first for first, _ in stretches] == [0, *(last for _, last in stretches[:-1])]
    assert stretches[-1][1] == len(pyramid.octree.index)
    for tile in tiles:
        blocks = pyramid.octree.index[tile.first:tile.last]
        assert ((blocks >= tile.corner) & (blocks < np.array(tile.corner) + tile.side)).all()


def test_smallest_tiles_show_each_visible_voxel_once(pyramid):
    shown = set()
    for tile in all_tiles(pyramid.octree):
        if tile.level == 0:
            at = pyramid.points(tile)['at'][:, :3] + np.array(tile.corner) * SIDE
            assert not shown & set(map(tuple, at.tolist()))
            shown |= set(map(tuple, at.tolist()))
    every = {tuple(v) for part in pyramid.source.chunks() for v in part['voxel'].tolist()}
    hidden = every - shown
    assert shown <= every
    steps = np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    assert hidden == {v for v in every if all(tuple(np.add(v, s).tolist()) in every
                                              for s in steps)} and len(hidden) == 8


@pytest.mark.parametrize('level', range(1, 6))
def test_coarse_tiles_cover_what_is_below(pyramid, level):
    """A cell of a coarse tile has voxels, and cells up to a block's size leave out none."""
    every = np.concatenate([part['voxel'] for part in pyramid.source.chunks()])
    for tile in all_tiles(pyramid.octree):
        if tile.level == level:
            points = pyramid.points(tile)
            at = {tuple(cell) for cell in points['at'][:, :3].tolist()}
            low = np.array(tile.corner) * SIDE
            mine = every[((every >= low) & (every < low + tile.side * SIDE)).all(axis=1)]
            cells = {tuple(cell) for cell in ((mine - low) >> level).tolist()}
            assert len(points) == len(at) and at <= cells
            assert (points['at'][:, :3] < EDGE).all() and (points['label'] > 0).all()
            around = {tuple(cell) for cell in ((every - low) >> level).tolist()}
            covered = {c for c in cells if all(
                tuple(np.add(c, s).tolist()) in around
                for s in np.concatenate([np.eye(3, dtype=int), -np.eye(3, dtype=int)]))}
            assert cells - covered <= at


def test_a_cell_shows_what_was_seen_most_of_what_is_there():
    columns = {'observations': np.array([3, 9, 5, 5, 1], np.uint32),
               'gone': np.array([0, 1, 0, 0, 1], np.uint8)}
    assert seen_most(columns, np.array([7, 7, 2, 2, 9])).tolist() == [2, 0, 4]


def test_open_sides():
    at = np.array([[0, 5, 5], [1, 5, 5]])
    assert open_sides(at, np.array([[0, 5, 5], [1, 5, 5], [-1, 5, 5], [0, 5, 6]])).tolist() == [
        0b011100, 0b111110]


def test_the_curve():
    places = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0], [2 ** 21 - 1] * 3])
    assert morton(places).tolist() == [0, 1, 2, 4, 2 ** 63 - 1]


def test_what_is_far_apart(tmp_path):
    octree = Octree(np.array([[0, 0, 0], [100_000, 3, -70_000]], np.int32))
    assert [tile.last - tile.first for tile in all_tiles(octree) if tile.level == 0] == [1, 1]
    assert octree.find(np.array([[0, 0, 0], [5, 5, 5], [-9, 0, 0]])).tolist()[1:] == [-1, -1]
    with pytest.raises(Exception, match='voxels wide, more than .* --crop takes a part'):
        Octree(np.array([[-2 ** 27, 0, 0], [2 ** 27, 0, 0]], np.int32))


def test_blocks_that_changed_are_read_anew(pyramid):
    other = Pyramid(pyramid.source, pyramid.octree)
    coarse = next(t for t in all_tiles(other.octree) if t.level >= LEAF)
    assert (other.points(coarse) == pyramid.points(coarse)).all()
    kept = Octree(other.octree.index[5:])
    other.changed(kept, kept.index[:3])
    root = Pyramid(pyramid.source, kept).points(kept.root)
    assert (other.points(kept.root) == root).all()


def content(path):
    """Return (JSON, points) of a .glb."""
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], 'little')
    return json.loads(data[20:20 + size]), np.frombuffer(data[28 + size:], POINT)


def test_export(hills, tmp_path, capsys):
    out = tmp_path / 'tiles'
    assert main(['map', 'export', str(hills), '--tiles', str(out)]) == 0
    said = capsys.readouterr().out
    assert f'tiles of 3D Tiles 1.1 written to {out}/tileset.json' in said
    names, waiting, shown = set(), ['tileset.json'], 0
    while waiting:
        name = waiting.pop()
        names.add(name)
        stack = [json.loads((out / name).read_text())['root']]
        while stack:
            tile = stack.pop()
            stack += tile.get('children', [])
            uri = tile['content']['uri']
            uri = uri.removeprefix('../') if '/' in name else uri
            if uri.endswith('.json'):
                waiting.append(uri)
                continue
            names.add(uri)
            head, points = content(out / uri)
            assert head['accessors'][0]['count'] == len(points) > 0
            # y up, in metres from the anchor, inside the tile's box
            scale = np.array(head['nodes'][0]['matrix']).reshape(4, 4).T
            at = scale @ np.c_[points['at'][:, :3], np.ones(len(points))].T
            box = np.array(tile['boundingVolume']['box'])
            assert (np.abs(np.stack([at[0], -at[2], at[1]]).T - box[:3]) <= box[[3, 7, 11]]).all()
            shown += tile['geometricError'] == 0 and len(points)
    assert {str(path.relative_to(out)) for path in out.rglob('*.*')} == names
    assert shown == sum(len(part['voxel']) for part in MapSource(hills).chunks()) - 8
    assert main(['map', 'export', str(hills), '--tiles', str(out)]) == 1
    assert 'exists; give another name with --tiles' in capsys.readouterr().err


def test_export_of_a_choice(hills, tmp_path, capsys):
    out = tmp_path / 'cube'
    assert main(['map', 'export', str(hills), '--tiles', str(out), '--classes', '2']) == 0
    points = [content(path)[1] for path in out.rglob('0_*.glb')]
    assert sum(map(len, points)) == 56 + 1 and all((p['label'] == 2).all() for p in points)


def test_what_moved_away_is_flagged_and_covers_nothing():
    columns = {'label': np.array([1, 2], np.uint16), 'confidence': np.array([0.5, 1], np.float32),
               'observations': np.array([1, 8], np.uint32), 'source': np.zeros(2, np.uint8),
               'gone': np.array([0, 1], np.uint8), 'last_stamp': np.array([5, 10 ** 9 + 5])}
    points = points_of(np.array([[3, 3, 3], [4, 3, 3]]), columns, np.zeros((0, 3), int), LEGEND, 5)
    assert points['sides'].tolist() == [0b111111, GONE | 0b111110]
    assert points['seen'].tolist() == [0, 48] and points['last'].tolist() == [0, 1]
    assert points['confidence'].tolist() == [128, 255]
    assert points['color'].tolist() == [[55, 55, 55, 255], [255, 0, 0, 255]]
