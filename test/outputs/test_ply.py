"""Map points and their PLY file: layout, exactness, readers, whole or not at all."""

from pathlib import Path

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.outputs import files
from persem_ros.outputs.map.cloud import colors_of, map_points, POINT
from persem_ros.outputs.map.ply import map_comments, write_ply
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend
import pytest

KINDS = {'float': '<f4', 'uchar': 'u1', 'int': '<i4'}


def columns(n=50):
    """Return made-up columns of a map as the memory gives them."""
    rng = np.random.default_rng(n)
    voxel = np.unique(rng.integers(-40, 40, (n, 3)).astype(np.int32), axis=0)
    n = len(voxel)
    return {'voxel': voxel, 'label': rng.integers(0, 8, n).astype(np.uint16),
            'majority': rng.choice([0, 3, 65534], n).astype(np.uint16),
            'confidence': rng.random(n).astype(np.float32),
            'observations': rng.integers(1, 2 ** 32, n).astype(np.uint32),
            'source': rng.integers(0, 4, n).astype(np.uint8)}


def parsed(path):
    """Return (header lines, vertices) of a PLY file, read by its own header."""
    head, _, body = Path(path).read_bytes().partition(b'end_header\n')
    lines = head.decode('ascii').splitlines()
    dtype = np.dtype([(words[2], KINDS[words[1]]) for words in map(str.split, lines)
                      if words[0] == 'property'])
    return lines, np.frombuffer(body, dtype)


def test_point_layout():
    assert POINT.itemsize == 32
    assert [(n, POINT.fields[n][1]) for n in POINT.names] == [
        ('x', 0), ('y', 4), ('z', 8), ('rgb', 12), ('label', 16), ('majority', 18),
        ('confidence', 20), ('observations', 24), ('source', 28)]


def test_points_are_the_voxels():
    given, legend = columns(), load_legend('town')
    points = map_points(given, 0.25, legend)
    assert points.dtype == POINT
    xyz = np.stack([points[a] for a in 'xyz'], axis=1)
    assert (np.floor(xyz / 0.25) == given['voxel']).all()
    assert (xyz == ((given['voxel'] + 0.5) * 0.25).astype(np.float32)).all()
    assert (colors_of(points) == legend.colors(given['label'])).all()
    for name in ('label', 'majority', 'confidence', 'observations', 'source'):
        assert (points[name] == given[name]).all()


def test_ply_holds_the_points(tmp_path):
    given = columns()
    points = map_points(given, 0.5, Legend())
    write_ply(tmp_path / 'a' / 'map.ply', points, map_comments('map', (5e5, 0, 1), 0.5))
    lines, vertices = parsed(tmp_path / 'a' / 'map.ply')
    assert lines[:2] == ['ply', 'format binary_little_endian 1.0']
    assert 'comment origin 500000.0 0.0 1.0 (to be added to x y z)' in lines
    assert lines[-12:] == [
        f'element vertex {len(points)}', 'property float x', 'property float y',
        'property float z', 'property uchar red', 'property uchar green', 'property uchar blue',
        'property int label', 'property int majority', 'property float confidence',
        'property int observations', 'property uchar source']
    assert len(vertices) == len(points)
    for name in ('x', 'y', 'z', 'label', 'majority', 'confidence', 'source'):
        assert (vertices[name] == points[name]).all()
    most = np.iinfo(np.int32).max       # a voxel seen more often than that counts as seen so often
    assert (vertices['observations'] == np.minimum(points['observations'], most)).all()
    rgb = np.stack([vertices[c] for c in ('red', 'green', 'blue')], axis=1)
    assert (rgb == colors_of(points)).all()


def test_other_programs_read_it(tmp_path):
    trimesh = pytest.importorskip('trimesh')
    points = map_points(columns(), 0.5, Legend())
    write_ply(tmp_path / 'map.ply', points, map_comments('map', (0, 0, 0), 0.5))
    cloud = trimesh.load(tmp_path / 'map.ply')
    assert (cloud.vertices[:, 0] == points['x']).all()
    assert (cloud.visual.vertex_colors[:, :3] == colors_of(points)).all()


def test_empty_map(tmp_path):
    points = map_points({name: a[:0] for name, a in columns().items()}, 0.5, Legend())
    write_ply(tmp_path / 'map.ply', points)
    lines, vertices = parsed(tmp_path / 'map.ply')
    assert 'element vertex 0' in lines and len(vertices) == 0


def test_same_points_same_bytes(tmp_path):
    points = map_points(columns(), 0.5, Legend())
    for name in ('a.ply', 'b.ply'):
        write_ply(tmp_path / name, points, map_comments('map', (0, 0, 0), 0.5))
    assert (tmp_path / 'a.ply').read_bytes() == (tmp_path / 'b.ply').read_bytes()


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / 'file'
    files.write_text(path, 'old')
    with pytest.raises(PersemError, match='cannot write .*file: No space left'):
        with files.replacing(path) as work:
            work.write_text('ne')
            raise OSError(28, 'No space left on device')
    with pytest.raises(KeyboardInterrupt):
        with files.replacing(path) as work:
            work.write_text('ne')
            raise KeyboardInterrupt
    assert path.read_text() == 'old'
    assert [p.name for p in tmp_path.iterdir()] == ['file']


def test_what_killed_writers_left_is_removed(tmp_path):
    (tmp_path / '.a[b].999999999.partial').write_text('half')
    (tmp_path / '.a[b].1.partial').write_text('of a live process')
    files.write_text(tmp_path / 'a[b]', 'new')
    assert sorted(p.name for p in tmp_path.iterdir()) == ['.a[b].1.partial', 'a[b]']


def test_refusals_name_the_file(tmp_path):
    (tmp_path / 'folder').mkdir()
    with pytest.raises(PersemError, match='folder: it is a folder'):
        files.write_text(tmp_path / 'folder', 'x')
    (tmp_path / 'file').write_text('')
    with pytest.raises(PersemError, match='cannot write .*below: (File exists|Not a directory)'):
        files.write_text(tmp_path / 'file' / 'below', 'x')


def test_json_has_null_and_no_nan(tmp_path):
    files.write_json(tmp_path / 'a.json', {'miou': None, 'n': 1})
    assert '"miou": null' in (tmp_path / 'a.json').read_text()
    with pytest.raises(ValueError):
        files.write_json(tmp_path / 'b.json', {'miou': float('nan')})
    assert not (tmp_path / 'b.json').exists()
