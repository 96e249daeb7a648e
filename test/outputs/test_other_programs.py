"""What is written for other programs, opened by them: every field arrives."""

import json
import os
from pathlib import Path
import shutil
import subprocess

import cv2
import numpy as np
from persem_ros.cli import main
from persem_ros.outputs.export.choice import Choice
from persem_ros.outputs.export.nav2 import write_nav2
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map.cloud import colors_of, map_points
import pytest
from small_maps import written
import yaml

OURS = ('label', 'majority', 'confidence', 'observations', 'source')
PLACE = ('EPSG:32632', '691000,5335000,500,0')
# Run by the interpreter that QGIS was made for, without a screen: argument 1 is drawn to 2.
DRAW = """
import json, sys
from qgis.core import QgsApplication, QgsMapRendererSequentialJob, QgsMapSettings, QgsRasterLayer
from qgis.PyQt.QtCore import QSize
app = QgsApplication([], False)
app.initQgis()
layer = QgsRasterLayer(sys.argv[1], 'map')
settings = QgsMapSettings()
settings.setLayers([layer])
settings.setDestinationCrs(layer.crs())
settings.setExtent(layer.extent())
settings.setOutputSize(QSize(10 * layer.width(), 10 * layer.height()))
job = QgsMapRendererSequentialJob(settings)
job.start()
job.waitForFinished()
job.renderedImage().save(sys.argv[2])
print(json.dumps({'valid': layer.isValid(), 'crs': layer.crs().authid(),
                  'renderer': layer.renderer().type(), 'bands': layer.bandCount(), 'classes': {
                      c.value: [c.label, c.color.name()] for c in layer.renderer().classes()}}))
layer = job = None
app.exitQgis()
"""


@pytest.fixture(scope='module')
def town(tmp_path_factory):
    """Return (folder with map.persem, its points as map.ply has them)."""
    folder = tmp_path_factory.mktemp('town')
    source, memory = written(folder / 'map.persem')
    assert main(['map', 'export', str(source.path), '--ply', str(folder / 'map.ply')]) == 0
    return folder, map_points(memory.voxels(), source.voxel_size, source.legend)


def exported(folder, option, name):
    """Export the map once more, in a projected system; return the file."""
    out = folder / name
    if not out.exists():
        assert main(['map', 'export', str(folder / 'map.persem'), option, str(out), '--set',
                     f'map.crs={PLACE[0]}', '--set', f'map.georeference=[{PLACE[1]}]']) == 0
    return out


def program(name):
    """Return the path of a program; skip where it is not installed."""
    return shutil.which(name) or pytest.skip(f'needs the program {name}')


def said(*words, **environment):
    """Return what a program prints; it must succeed."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True,
                          timeout=60, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout


def sorted_by_place(xyz, columns):
    """Return columns in the order of their points."""
    order = np.lexsort(np.round(xyz, 3).T[::-1])
    return {name: np.asarray(column)[order].reshape(-1) for name, column in columns.items()}


def same(found, xyz, points):
    """Assert that all our fields are those of the points."""
    wanted = sorted_by_place(np.stack([points[a] for a in 'xyz'], axis=1),
                             {name: points[name] for name in OURS})
    found = sorted_by_place(xyz, found)
    for name in OURS:
        assert np.array_equal(found[name], wanted[name]), name


def test_open3d_reads_every_field_of_map_ply(town, capfd):
    io = pytest.importorskip('open3d', reason='needs the package open3d').t.io
    cloud = io.read_point_cloud(str(town[0] / 'map.ply'))
    out = ''.join(capfd.readouterr())
    assert 'unsupported' not in out.lower() and 'skip' not in out.lower()
    assert set(OURS) <= set(cloud.point)
    same({name: cloud.point[name].numpy() for name in OURS}, cloud.point.positions.numpy(),
         town[1])
    assert (np.sort(cloud.point.colors.numpy(), axis=0)
            == np.sort(colors_of(town[1]), axis=0)).all()


def test_plyfile_reads_every_field_of_map_ply(town):
    plyfile = pytest.importorskip('plyfile', reason='needs the package plyfile')
    vertex = plyfile.PlyData.read(town[0] / 'map.ply')['vertex']
    same({name: vertex[name] for name in OURS}, np.stack([vertex[a] for a in 'xyz'], axis=1),
         town[1])


def test_trimesh_reads_every_field_of_map_ply(town):
    trimesh = pytest.importorskip('trimesh', reason='needs the package trimesh')
    cloud = trimesh.load(town[0] / 'map.ply')
    raw = cloud.metadata['_ply_raw']['vertex']['data']
    same({name: raw[name] for name in OURS}, cloud.vertices, town[1])


def test_cloudcompare_reads_every_field_of_map_ply_as_the_page_prepares_it(town, tmp_path):
    compare, sed = program('CloudCompare'), program('sed')
    page = (Path(__file__).parents[2] / 'docs' / 'exports.md').read_text(encoding='utf-8')
    recipe = next(line for line in page.splitlines() if line.startswith('LC_ALL=C sed '))
    (tmp_path / 'cc.ply').write_bytes(subprocess.run(
        [sed, recipe.split("'")[1], town[0] / 'map.ply'], check=True, capture_output=True,
        env={**os.environ, 'LC_ALL': 'C'}).stdout)
    said(compare, '-SILENT', '-AUTO_SAVE', 'OFF', '-NO_TIMESTAMP', '-C_EXPORT_FMT', 'ASC',
         '-ADD_HEADER', '-PREC', '8', '-O', tmp_path / 'cc.ply', '-SAVE_CLOUDS',
         QT_QPA_PLATFORM='offscreen')
    made = next(tmp_path.glob('*.asc'))
    names = made.read_text().splitlines()[0].lstrip('/').split()
    rows = np.loadtxt(made, skiprows=1)
    assert names == ['X', 'Y', 'Z', 'R', 'G', 'B', *OURS]
    same({name: rows[:, names.index(name)].astype(town[1][name].dtype) for name in OURS},
         rows[:, :3], town[1])


@pytest.mark.parametrize(('option', 'name'), [('--ply', 'map.ply'), ('--laz', 'a.laz')])
def test_pdal_reads_every_field(town, option, name):
    pdal = program('pdal')
    if name == 'a.laz':
        pytest.importorskip('lazrs', reason='needs the extra gis')
        pytest.importorskip('pyproj', reason='needs the extra gis')
    path = exported(town[0], option, name)
    reader = ['--readers.las.use_eb_vlr=true'] if name == 'a.laz' else []
    about = json.loads(said(pdal, 'info', '--stats', path, *reader))['stats']['statistic']
    about = {column['name'].lower(): column for column in about}
    for field in OURS:
        column = town[1][field].astype(float)
        assert about[field]['count'] == len(column)
        assert [about[field][what] for what in ('minimum', 'maximum', 'average')] == \
            pytest.approx([column.min(), column.max(), column.mean()])
    if name == 'a.laz':
        meta = json.loads(said(pdal, 'info', '--metadata', path))['metadata']
        assert '32632' in meta['srs']['wkt'] and meta['minor_version'] == 4


def test_pdal_makes_a_copc_of_the_laz(town, tmp_path):
    """As docs/exports.md says."""
    pdal = program('pdal')
    laspy = pytest.importorskip('laspy', reason='needs the extra gis')
    pytest.importorskip('lazrs', reason='needs the extra gis')
    pytest.importorskip('pyproj', reason='needs the extra gis')
    laz = exported(town[0], '--laz', 'a.laz')
    said(pdal, 'translate', laz, tmp_path / 'a.copc.laz', '--readers.las.use_eb_vlr=true',
         '--writers.copc.forward=all')
    with laspy.CopcReader.open(tmp_path / 'a.copc.laz') as reader:
        points = reader.query()
    same({name: points[name] for name in OURS},
         np.stack([points.x, points.y, points.z], axis=1), town[1])


def test_gdal_reads_colours_names_and_bands(town):
    gdalinfo = program('gdalinfo')
    pytest.importorskip('rasterio', reason='needs the extra gis')
    path = exported(town[0], '--geotiff', 'a.tif')
    info = json.loads(said(gdalinfo, '-json', path))
    band, = info['bands']
    assert info['size'] == [40, 15] or info['size'][1] == 15
    assert (band['type'], band['noDataValue']) == ('Byte', 255)
    assert band['colorTable']['entries'][2] == [200, 0, 0, 255]
    assert 'ID["EPSG",32632]]' in info['coordinateSystem']['wkt']
    # The place of the lower left corner: the shift, map.origin, and the blocks' edge.
    assert info['cornerCoordinates']['lowerLeft'][1] == 5335000 + 200 - 3 * 0.5
    assert 'wall <&>' in said(gdalinfo, path)
    values = json.loads(said(gdalinfo, '-json', '-stats', town[0] / 'a.values.tif'))
    assert [band['description'] for band in values['bands']] == [
        'height (m)', 'confidence', 'observations']
    assert values['bands'][0]['maximum'] == 500 + 7 + 15.25
    assert values['bands'][2]['minimum'] == 3


def test_qgis_draws_the_classes_in_their_colours(town, tmp_path):
    if not Path('/usr/bin/python3').exists() or subprocess.run(
            ['/usr/bin/python3', '-c', 'import qgis.core'], capture_output=True).returncode:
        pytest.skip('needs QGIS (apt install python3-qgis)')
    pytest.importorskip('rasterio', reason='needs the extra gis')
    path = exported(town[0], '--geotiff', 'a.tif')
    # Neither our environment's libraries nor a profile of the user's.
    about = json.loads(said('/usr/bin/python3', '-c', DRAW, path, tmp_path / 'a.png',
                            QT_QPA_PLATFORM='offscreen', HOME=str(tmp_path),
                            XDG_RUNTIME_DIR=str(tmp_path), PYTHONPATH='').splitlines()[-1])
    assert about['valid'] and about['crs'] == 'EPSG:32632' and about['bands'] == 1
    assert about['renderer'] == 'paletted'
    assert {int(float(c)): entry for c, entry in about['classes'].items()} == {
        1: ['road', '#090909'], 2: ['wall <&>', '#c80000'], 3: ['tree', '#005a00'],
        4: ['grass', '#00c800']}
    drawn = cv2.imread(str(tmp_path / 'a.png')).reshape(-1, 3)[:, ::-1]
    seen = set(map(tuple, np.unique(drawn, axis=0).tolist()))
    assert {(9, 9, 9), (200, 0, 0), (0, 90, 0), (0, 200, 0)} <= seen


def loaded_as_by_nav2(path):
    """Return (costs int8, first row in the south; resolution; origin), as map_io.cpp does."""
    about = yaml.safe_load(path.read_text())
    for key, kind in (('image', str), ('mode', str), ('resolution', float), ('negate', int),
                      ('free_thresh', float), ('occupied_thresh', float)):
        assert isinstance(about[key], kind), key
    assert about['mode'] == 'raw' and [type(x) for x in about['origin']] == [float] * 3
    image = cv2.imread(str(path.parent / about['image']), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint8 and image.ndim == 2
    costs = image.view(np.int8)
    return np.where((costs < 0) | (costs > 100), -1, costs)[::-1], about['resolution'], \
        about['origin']


def test_nav2_loads_the_costs(town, tmp_path):
    source = MapSource(town[0] / 'map.persem')
    cells = write_nav2(tmp_path, source, Choice())
    costs, resolution, origin = loaded_as_by_nav2(tmp_path / 'map.yaml')
    assert np.array_equal(costs, cells.cost) and {-1, 0, 100} <= set(costs.ravel().tolist())
    assert resolution == 0.5 and origin == [90.0, 198.5, 0.0]
    labels, *place = loaded_as_by_nav2(tmp_path / 'labels.yaml')
    assert set(labels.ravel().tolist()) == {1, 2, 3, 4} and place == [resolution, origin]


def test_a_map_that_is_not_tied_to_the_earth_says_so(town, capsys, tmp_path):
    pytest.importorskip('lazrs', reason='needs the extra gis')
    assert MapSource(town[0] / 'map.persem').config.map.crs == ''
    assert main(['map', 'export', str(town[0] / 'map.persem'), '--laz',
                 str(tmp_path / 'a.laz')]) == 0
    out, err = capsys.readouterr()
    assert err == '' and 'in the frame map, without georeference (persem map georeference gives' \
        in out
