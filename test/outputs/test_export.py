"""Files for other programs: each is read back by the library that its users have."""

import sys
import tracemalloc
import warnings

import core_worlds as cw
import numpy as np
import old_maps
from persem_ros.cli import main
from persem_ros.core.memory.capture import dump
from persem_ros.errors import PersemError
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.export.faces import outer_faces
from persem_ros.outputs.export.las import write_las
from persem_ros.outputs.export.mesh import write_mesh
from persem_ros.outputs.export.nav2 import grid_of, write_nav2
from persem_ros.outputs.export.raster import write_geotiff
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.export.tables import VOXEL, write_npz, write_parquet
from persem_ros.outputs.map import store
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest
from small_maps import CROWN, FLOOR, LEGEND, ORIGIN, TALL, UNDER, written
import yaml


@pytest.fixture(scope='module')
def town(tmp_path_factory):
    """Return (MapSource, VoxelMemory) of the same small map for all tests that only read."""
    return written(tmp_path_factory.mktemp('town') / 'map.persem')


def gathered(chunks):
    """Return the columns of all chunks, sorted by voxel, those with an entry a voxel."""
    parts = list(chunks)
    whole = {name: np.concatenate([part[name] for part in parts])
             for name in parts[0] if name not in ('start', 'classes', 'probabilities')}
    order = np.lexsort(whole['voxel'].T[::-1])
    return {name: column[order] for name, column in whole.items()}


@pytest.mark.parametrize('blocks', [1, 3, 1000])
def test_chunks_are_the_memory_whatever_their_size(town, blocks):
    source, memory = town
    found, wanted = gathered(source.chunks(blocks=blocks)), memory.voxels()
    for name in ('voxel', 'label', 'majority', 'confidence', 'observations', 'switches', 'source'):
        assert np.array_equal(found[name], wanted[name]), name
    assert (found['first_stamp'] == 5).all() and (found['last_stamp'] == 2 * 10 ** 9 + 5).all()


def test_a_column_of_blocks_is_never_cut(town):
    tiles = [set(map(tuple, chunk['voxel'][:, :2] >> 3)) for chunk in town[0].chunks(blocks=1)]
    assert len(tiles) > 1
    assert not any(a & b for k, a in enumerate(tiles) for b in tiles[k + 1:])


def test_class_probabilities(town):
    source, memory = town
    for chunk in source.chunks():
        for v in np.flatnonzero((chunk['voxel'] == (3, 3, 0)).all(axis=1)):
            entries = slice(chunk['start'][v], chunk['start'][v + 1])
            assert dict(zip(chunk['classes'][entries].tolist(),
                            chunk['probabilities'][entries].tolist())) == \
                pytest.approx({1: 2 / 3, 4: 1 / 3})
            return
    raise AssertionError('the voxel is not there')


@pytest.mark.parametrize(('choice', 'n'), [
    (Choice(), len({**FLOOR, **TALL, **CROWN, **UNDER}) - 1), (Choice(min_observations=4), 0),
    (Choice(labels=frozenset({2, 4})), 9),
    (Choice(crop=(102, 202, 7, 103, 203, 20)), 4 + 8)])
def test_choices(town, choice, n):
    chosen = list(town[0].chunks(choice))
    assert sum(len(chunk['voxel']) for chunk in chosen) == n == town[0].summary(choice).voxels
    for chunk in chosen:
        assert chunk['start'][-1] == len(chunk['classes']) == len(chunk['probabilities'])
        assert np.add.reduceat(chunk['probabilities'], chunk['start'][:-1]) == pytest.approx(1) \
            if len(chunk['voxel']) else not len(chunk['classes'])


def test_a_map_of_schema_1(tmp_path):
    source, memory = written(tmp_path / 'new.persem')
    old_maps.save(tmp_path / 'old.persem', dump(memory), source.config)
    found, wanted = gathered(MapSource(tmp_path / 'old.persem').chunks()), \
        gathered(source.chunks())
    for name in ('voxel', 'label', 'confidence', 'observations', 'first_stamp', 'last_stamp'):
        assert np.array_equal(found[name], wanted[name]), name


def test_damage_is_one_sentence(town, tmp_path):
    data = bytearray(town[0].path.read_bytes())
    at = data.rfind(np.array([2, 2, 2], '<u2').tobytes())
    data[at] ^= 1
    (tmp_path / 'bad.persem').write_bytes(data)
    with pytest.raises(PersemError, match='damaged .*restore it from a copy'):
        list(MapSource(tmp_path / 'bad.persem').chunks())


@pytest.mark.parametrize('blocks', [1, 1000])
def test_npz(town, tmp_path, blocks, monkeypatch):
    monkeypatch.setattr(MapSource.chunks, '__defaults__', (None, blocks))
    source, memory = town
    assert write_npz(tmp_path / 'a.npz', source, Choice()) == memory.n_voxels
    with np.load(tmp_path / 'a.npz') as found:
        order = np.lexsort(found['voxel'].T[::-1])
        assert np.array_equal(found['voxel'][order], memory.voxels()['voxel'])
        assert found['xyz'].min(axis=0) == pytest.approx([90.25, 198.75, 7.25])
        for name in VOXEL:
            assert len(found[name]) == memory.n_voxels
        start, p = found['start'], found['probabilities']
        assert start[0] == 0 and start[-1] == len(p) == len(found['classes'])
        assert np.add.reduceat(p, start[:-1]) == pytest.approx(1)
        names = dict(zip(found['class_ids'].tolist(), found['class_names'].tolist()))
        assert names[2] == 'wall <&>'
    assert [path.name for path in tmp_path.iterdir()] == ['a.npz']


def test_parquet(town, tmp_path):
    parquet = pytest.importorskip('pyarrow.parquet', reason='needs the extra gis')
    source, memory = town
    assert write_parquet(tmp_path / 'a.parquet', source, Choice()) == memory.n_voxels
    table = parquet.read_table(tmp_path / 'a.parquet')
    rows = {(r['i'], r['j'], r['k']): r for r in table.to_pylist()}
    assert len(rows) == memory.n_voxels
    row = rows[3, 3, 0]
    assert (row['name'], row['label'], row['observations']) == ('road', 1, 3)
    assert row['classes'] == [1, 4] and row['probabilities'] == pytest.approx([2 / 3, 1 / 3])
    assert (row['x'], row['y'], row['z']) == (101.75, 201.75, 7.25)
    assert table.schema.metadata[b'persem_ros.voxel_size'] == b'0.5'


@pytest.mark.parametrize('name', ['a.laz', 'a.las'])
def test_las(town, tmp_path, name):
    laspy = pytest.importorskip('laspy', reason='needs the extra gis')
    source, memory = town
    n, without = write_las(tmp_path / name, source, Choice())
    assert (n, without) == (memory.n_voxels, [3, 4])
    las = laspy.read(tmp_path / name)
    assert las.header.are_points_compressed == (name == 'a.laz')
    order = np.lexsort((las.z, las.y, las.x))
    columns = memory.voxels()
    assert np.array_equal(las.xyz[order], (columns['voxel'] + 0.5) * 0.5 + ORIGIN)
    for field in ('label', 'majority', 'confidence', 'observations', 'source'):
        assert np.array_equal(np.asarray(las[field])[order], columns[field]), field
    codes = {1: 11, 2: 64, 3: 1, 4: 1}
    assert np.array_equal(las.classification[order], [codes[c] for c in columns['label']])
    names = las.header.vlrs.get('ClassificationLookupVlr')[0]
    assert names[64].startswith('wall')
    assert np.asarray(las.red).max() == 200 * 257


def test_a_map_without_las_codes_is_unclassified(tmp_path):
    laspy = pytest.importorskip('laspy', reason='needs the extra gis')
    source, _ = written(tmp_path / 'm.persem', legend=Legend())
    assert write_las(tmp_path / 'a.las', source, Choice())[1] == [1, 2, 3, 4]
    assert set(laspy.read(tmp_path / 'a.las').classification) == {1}


def test_geotiff(town, tmp_path):
    rasterio = pytest.importorskip('rasterio', reason='needs the extra gis')
    source, _ = town
    width, height = write_geotiff(tmp_path / 'a.tif', source, Choice())
    assert height == 15 and 40 <= width < 48
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        with rasterio.open(tmp_path / 'a.tif') as out:
            classes = out.read(1)
            pixel = {(i, j): out.index((i + 0.5) * 0.5 + 100, (j + 0.5) * 0.5 + 200)
                     for i in range(-20, 20) for j in range(-3, 12)}
            assert out.colormap(1)[2] == (200, 0, 0, 255) and out.nodata == 255
            assert out.tags(1)['CLASS_2'] == 'wall <&>' and out.crs is None
        with rasterio.open(tmp_path / 'a.values.tif') as out:
            heights, _, seen = out.read()
            assert out.descriptions[0] == 'height (m)'
    assert classes[pixel[5, 5]] == 2 and heights[pixel[5, 5]] == 7 + 4.25     # the wall's top
    assert classes[pixel[-7, 0]] == 3 and heights[pixel[-7, 0]] == 7 + 15.25
    assert classes[pixel[0, 0]] == 4 and classes[pixel[-20, 11]] == 1
    assert (classes != 255).sum() == 600 == (seen == 3).sum()
    names = (tmp_path / 'a.tif.aux.xml').read_text()
    assert names.count('<Category>') == 5 and 'wall &lt;&amp;&gt;' in names


def test_geotiff_slabs_join(tmp_path, monkeypatch):
    """Tiles narrower than the map, and blocks read one at a time, give the same raster."""
    rasterio = pytest.importorskip('rasterio', reason='needs the extra gis')
    source, _ = written(tmp_path / 'm.persem')
    write_geotiff(tmp_path / 'a.tif', source, Choice())
    monkeypatch.setattr('persem_ros.outputs.export.raster.TILE', 16)
    monkeypatch.setattr(MapSource.chunks, '__defaults__', (None, 1))
    write_geotiff(tmp_path / 'b.tif', source, Choice())
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for suffix in ('.tif', '.values.tif'):
            with rasterio.open(tmp_path / f'a{suffix}') as a, \
                    rasterio.open(tmp_path / f'b{suffix}') as b:
                assert np.array_equal(a.read(), b.read(), equal_nan=suffix == '.values.tif')


@pytest.mark.parametrize('suffix', ['ply', 'glb'])
def test_mesh(town, tmp_path, suffix):
    trimesh = pytest.importorskip('trimesh')
    source, memory = town
    n = write_mesh(tmp_path / f'a.{suffix}', source, Choice())
    mesh = trimesh.load(tmp_path / f'a.{suffix}', force='mesh')
    assert len(mesh.faces) == 2 * n
    assert mesh.area == pytest.approx(0.25 * n)
    assert mesh.volume == pytest.approx(0.125 * memory.n_voxels)    # closed, faces outwards
    low = [-10, -1.5, 0] if suffix == 'ply' else [-10, 0, -6]       # glTF has y up
    assert mesh.bounds[0] == pytest.approx(low)
    assert {tuple(c[:3]) for c in mesh.visual.vertex_colors.tolist()} == \
        {(9, 9, 9), (200, 0, 0), (0, 90, 0), (0, 200, 0)}
    assert [path.name for path in tmp_path.iterdir()] == [f'a.{suffix}']


def test_faces_are_those_of_a_plain_count(town):
    known = set(map(tuple, town[1].voxels()['voxel'].tolist()))
    steps = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
    wanted = sum((x + i, y + j, z + k) not in known for x, y, z in known for i, j, k in steps)
    assert sum(len(labels) for _, labels in outer_faces(town[0], Choice(), 'x')) == wanted


def test_a_glb_has_a_bound(town, tmp_path, monkeypatch):
    monkeypatch.setattr('persem_ros.outputs.export.mesh.MOST_GLB', 10)
    with pytest.raises(PersemError, match='more than 10 faces .* --crop, or write a .ply'):
        write_mesh(tmp_path / 'a.glb', town[0], Choice())
    with pytest.raises(PersemError, match=r'ends in \.ply or \.glb'):
        write_mesh(tmp_path / 'a.obj', town[0], Choice())


def pixels(path):
    """Return the image in a binary .pgm, first row in the north."""
    _, size, most, data = path.read_bytes().split(b'\n', 3)
    width, height = map(int, size.split())
    return np.frombuffer(data, 'u1' if most == b'255' else '>u2').reshape(height, width)


def test_grid_for_nav2(town, tmp_path):
    cells = write_nav2(tmp_path / 'grid', town[0], Choice())
    about = yaml.safe_load((tmp_path / 'grid' / 'map.yaml').read_text())
    assert about['mode'] == 'raw' and about['resolution'] == 0.5
    assert about['origin'] == [90.0, 198.5, 0.0]
    cost = pixels(tmp_path / 'grid' / 'map.pgm')[::-1]      # row 0 in the south, as in the map
    assert cost.shape == (15, 40)

    def at(i, j):
        return j + 3, i + 20
    assert cost[at(1, 1)] == 0              # road
    assert cost[at(5, 5)] == 100            # an obstacle of the robot's height
    assert cost[at(-7, 0)] == 0             # what is above the robot is no obstacle
    assert cost[at(0, 0)] == 255            # nobody saw its ground
    classes = pixels(tmp_path / 'grid' / 'labels.pgm')[::-1]
    assert classes[at(5, 5)] == 2 and classes[at(-7, 0)] == 3 and classes[at(1, 1)] == 1
    assert (cells.cost == 100).sum() == 1 and (cells.cost == -1).sum() == 1


def test_grid_settings(tmp_path):
    source, _ = written(tmp_path / 'm.persem', **{
        'grid.labels': 'ground', 'grid.height': 20.0, 'grid.step': 0.2})
    cells = grid_of(source, Choice())
    assert cells.label[3, 13] == 1 and cells.cost[3, 13] == 100     # below the crown: an obstacle
    assert cells.label[8, 25] == 1
    for tie, cost in (('highest', 100), ('lowest', 0), ('unknown', -1)):
        source.config = updated(source.config, {'grid.resolution': 1.0, 'grid.tie': tie})
        coarse = grid_of(source, Choice())
        x, y = 2 - coarse.corner[0], 2 - coarse.corner[1]
        assert coarse.cost[y, x] == cost and coarse.size == 1.0


def test_a_class_without_a_cost_is_lethal(tmp_path):
    legend = Legend.from_yaml('classes:\n- {id: 4, name: b, cost: 7}\n')
    source, _ = written(tmp_path / 'm.persem', legend=legend)
    assert (grid_of(source, Choice()).cost[3, :20] == 100).all()


@pytest.mark.parametrize(('settings', 'legend', 'words'), [
    ({}, Legend.from_yaml('title: t\nclasses:\n- {id: 1, name: a}'), "'t' has none; give its"),
    ({}, Legend(), 'legend is empty'),
    ({'refine.up': '-y'}, LEGEND, 'needs z to point up'),
    ({'grid.resolution': 0.1}, LEGEND, r'size of a voxel \(0.5 m\), got 0.1'),
    ({'grid.height': 0.1}, LEGEND, 'expected more than grid.step'),
    ({'grid.min_observations': 9}, LEGEND, 'no voxel is left'),
])
def test_grids_that_cannot_be(tmp_path, settings, legend, words):
    source, _ = written(tmp_path / 'm.persem', legend=legend, **settings)
    with pytest.raises(PersemError, match=words):
        write_nav2(tmp_path / 'grid', source, Choice())
    assert not (tmp_path / 'grid').exists()


@pytest.mark.parametrize(('option', 'library', 'words'), [
    ('--laz', 'laspy', "pip install 'laspy[lazrs]'"), ('--laz', 'lazrs', "'laspy[lazrs]'"),
    ('--geotiff', 'rasterio', 'pip install rasterio'),
    ('--parquet', 'pyarrow', 'pip install pyarrow')])
def test_a_missing_library_is_one_line(town, tmp_path, capsys, monkeypatch, option, library,
                                       words):
    monkeypatch.setitem(sys.modules, library, None)
    if library == 'lazrs':
        pytest.importorskip('laspy', reason='needs the extra gis')
    status = main(['map', 'export', str(town[0].path), option, str(tmp_path / 'a.laz')])
    out, err = capsys.readouterr()
    assert (status, out) == (1, '') and len(err.splitlines()) == 1
    assert library in err and words in err and '.[gis]' in err
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_where_one_of_several_cannot_be(town, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rasterio', None)
    for wrong in (['--geotiff', str(tmp_path / 'a.tif')], ['--classes', ','],
                  ['--laz', str(tmp_path / 'a.las'), '--set', 'map.crs=EPSG:1']):
        assert main(['map', 'export', str(town[0].path), '--npz', str(tmp_path / 'a.npz'),
                     *wrong]) == 1
        assert len(capsys.readouterr().err.splitlines()) == 1 and not list(tmp_path.iterdir())


def test_a_legend_of_another_data_set_is_said(town, tmp_path, capsys):
    path = str(town[0].path)
    assert main(['map', 'export', path, '--npz', str(tmp_path / 'a.npz'), '--legend',
                 'cityscapes']) == 0
    assert 'calls classes otherwise than the map' in capsys.readouterr().err
    assert main(['map', 'export', path, '--npz', str(tmp_path / 'b.npz')]) == 0
    assert not capsys.readouterr().err


def test_several_at_once_and_what_is_refused(town, tmp_path, capsys):
    path, out = str(town[0].path), tmp_path / 'out'

    def run(*words):
        status = main(['map', 'export', path, *map(str, words)])
        return (status, *capsys.readouterr())
    status, said, err = run('--ply', out / 'a.ply', '--npz', out / 'a.npz', '--grid', out,
                            '--classes', 'road, 2')
    assert (status, err) == (0, '')
    assert said.splitlines() == [
        f'607 of 628 voxels written to {out}/a.ply', f'607 of 628 voxels written to {out}/a.npz',
        f'40 x 15 cells of 0.5 m written to {out}/map.yaml: 598 passable, 1 lethal, 1 unknown '
        '(nothing was seen there, or no ground)']
    for words, sentence in [
            ([], 'nothing to write: give at least one of --ply'),
            (['--grid', out], 'map.yaml exists; give another name with --grid, or --force'),
            (['--ply', path], 'is the map itself'),
            (['--npz', out / 'b.npz', '--classes', 'raod'],
             "no class 'raod', did you mean 'road'"),
            (['--npz', out / 'b.npz', '--set', 'memory.stride=2'], 'expected one of grid.*'),
            (['--npz', out / 'b.npz', '--set', 'grid.tie=x'], 'expected one of highest'),
            (['--npz', out / 'b.npz', '--min-observations', 50], 'up to 3 observations')]:
        status, said, err = run(*words)
        assert (status, said) == (1, '') and sentence in err, sentence
        assert len(err.splitlines()) == 1
    assert not (out / 'b.npz').exists()


def test_memory_stays_flat(tmp_path):
    """A file many times as long costs no more memory to read."""
    peaks = []
    for reach in (2, 12):
        memory = cw.core_of([])
        seen = {(i, j, k): (1 + k, 1.0) for i in range(-8 * reach, 8 * reach)
                for j in range(16) for k in range(8)}
        for t in range(2):
            memory.add(cw.observations(t, seen))
        store.save(tmp_path / 'm.persem', memory, Config())
        source = MapSource(tmp_path / 'm.persem')
        tracemalloc.start()
        assert sum(len(chunk['voxel']) for chunk in source.chunks(blocks=2)) == len(seen)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]
