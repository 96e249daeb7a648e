"""A map tied to the Earth: fits to fixes, what is entered, what is refused."""

from pathlib import Path
import subprocess
import sys

import bags
import core_worlds as cw
import numpy as np
from persem_ros.cli import main
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.fixes import read_fixes
from persem_ros.outputs.export import georeference
from persem_ros.outputs.export.place import Place, place_of
from persem_ros.outputs.export.source import MapSource
from persem_ros.outputs.map import store
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config
import pytest

pyproj = pytest.importorskip('pyproj', reason='needs the extra gis')
ROOT = Path(__file__).resolve().parents[2]
PLACE = Place('EPSG:32632', 691000.0, 5335000.0, 500.0, 30.0)


def flight(path, frames=20):
    """Save a map whose camera flew a quarter of a circle of 50 m, a frame a second."""
    memory = cw.core_of([])
    for i in range(frames):
        memory.add(cw.observations(bags.START + i * 10 ** 9, {(i, 0, 0): (1, 1.0)}))
        angle = i / frames * np.pi / 2
        memory.frames.placed[-1] = memory.frames.best[-1] = transform(
            [50 * np.cos(angle), 50 * np.sin(angle), 20.0 + i], [0.0, 0.0, 0.0, 1.0])
    store.save(path, memory, Config())
    return MapSource(path)


def fixes_of(source, place=PLACE, error=0.0):
    """Return rows (stamp, latitude, longitude, altitude) of the flight as a receiver sees it."""
    rng = np.random.default_rng(1)
    east, north, up = place.placed(source.positions).T
    noise = rng.normal(scale=error, size=(3, len(east)))
    lon, lat = pyproj.Transformer.from_crs(place.crs, 'EPSG:4326', always_xy=True).transform(
        east + noise[0], north + noise[1])
    return [(int(s), float(a), float(o), float(u))
            for s, a, o, u in zip(source.stamps, lat, lon, up + noise[2])]


def table(path, rows):
    """Write rows as a table."""
    path.write_text('stamp,latitude,longitude,altitude\n' + ''.join(
        f'{s // 10 ** 9}.{s % 10 ** 9:09d},{a!r},{o!r},{u!r}\n' for s, a, o, u in rows))
    return path


def run(capsys, *words):
    """Return (status, standard output, standard error) of a command."""
    status = main(['map', 'georeference', *map(str, words)])
    return (status, *capsys.readouterr())


def test_a_fit_finds_where_the_flight_was(tmp_path, capsys):
    path = tmp_path / 'm.persem'
    rows = fixes_of(flight(path))
    status, out, err = run(capsys, path, '--fix', table(tmp_path / 'fix.csv', rows))
    assert (status, err) == (0, '')
    assert '20 of 20 fixes lie within the flight; residual 0.00 m' in out
    found = place_of(MapSource(path))
    assert found.crs == 'EPSG:32632'
    assert (found.east, found.north, found.up, found.yaw) == pytest.approx(
        (691000.0, 5335000.0, 500.0, 30.0), abs=1e-3)
    assert run(capsys, path)[1].startswith('EPSG:32632, origin of the map frame at east 691000.0')
    assert store.load(path).config().map.crs == 'EPSG:32632'        # whole, by its checksums


def test_the_residual_is_that_of_the_receiver(tmp_path, capsys):
    path = tmp_path / 'm.persem'
    rows = fixes_of(flight(path, 400), error=1.5)
    out = run(capsys, path, '--fix', table(tmp_path / 'fix.csv', rows), '--crs', 'EPSG:25832')[1]
    rms = float(out.partition('residual ')[2].partition(' m')[0])
    assert rms == pytest.approx(1.5 * 2 ** 0.5, rel=0.15)
    assert place_of(MapSource(path)).yaw == pytest.approx(30.0, abs=1.0)


def navsatfix(out, topic, row, status=0):
    """Write a NavSatFix."""
    make = out.make.make
    out.message(topic, row[0], 'sensor_msgs/msg/NavSatFix', make(
        'sensor_msgs/msg/NavSatFix', out.make.header(row[0], 'gps'),
        make('sensor_msgs/msg/NavSatStatus', status, 1), *row[1:], np.zeros(9), 0))


def test_fixes_of_a_recording(tmp_path, capsys):
    path = tmp_path / 'm.persem'
    rows = fixes_of(flight(path))
    with RecordingWriter(tmp_path / 'flight') as out:
        for k, row in enumerate(rows):
            navsatfix(out, 'gps/fix', row, status=-1 if k == 3 else 0)
    stamps, values = read_fixes(tmp_path / 'flight')
    assert len(stamps) == 19 and stamps[0] == rows[0][0] and tuple(values[0]) == rows[0][1:]
    status, said, _ = run(capsys, path, '--fix', tmp_path / 'flight')
    assert status == 0 and '19 of 19 fixes' in said
    with RecordingWriter(tmp_path / 'two') as out:
        navsatfix(out, 'a', rows[0])
        navsatfix(out, 'b', rows[0])
    err = run(capsys, path, '--fix', tmp_path / 'two')[2]
    assert 'several topics of sensor_msgs/msg/NavSatFix; there are /a, /b: choose one' in err
    assert run(capsys, path, '--fix', tmp_path / 'two', '--topic', 'b')[0] == 1
    err = run(capsys, path, '--fix', bags.write(tmp_path / 'none', frames=1))[2]
    assert 'no topic of sensor_msgs/msg/NavSatFix; give a recording with one, or a table' in err


def test_by_hand_and_refusals(tmp_path, capsys):
    path = tmp_path / 'm.persem'
    rows = fixes_of(flight(path))
    before = path.read_bytes()
    assert run(capsys, path)[1] == 'no georeference (map.crs is empty); --fix or --crs gives one\n'
    for words, sentence in [
            (['--crs', 'EPSG:99999'], "there is no coordinate reference system 'EPSG:99999'"),
            (['--crs', 'EPSG:4326'], 'is not measured in metres; expected a projected system'),
            (['--crs', 'EPSG:2272'], 'is not measured in metres'),          # feet
            (['--shift', 1, 2, 3], 'give that as well'),
            (['--crs', 'EPSG:25832', '--shift', 1, 2, 'nan'], 'expected finite numbers'),
            (['--fix', 'x.csv', '--shift', 1, 2, 3], 'expected one of them'),
            (['--fix', tmp_path / 'none.csv'], 'cannot be read'),
            (['--fix', table(tmp_path / 'two.csv', rows[:2])], '2 of 2 fixes lie within'),
            (['--fix', table(tmp_path / 'late.csv', [(s + 10 ** 12, *r) for s, *r in rows])],
             'are their stamps of the same clock?'),
            (['--fix', table(tmp_path / 'same.csv', [(s, *rows[0][1:]) for s, *_ in rows])],
             'the turn of the map cannot be told')]:
        status, out, err = run(capsys, path, *words)
        assert (status, out) == (1, '') and sentence in err, (sentence, err)
        assert len(err.splitlines()) == 1
    (tmp_path / 'bad.csv').write_text('1,2,3\n')
    assert 'bad.csv, line 1' in run(capsys, path, '--fix', tmp_path / 'bad.csv')[2]
    assert path.read_bytes() == before
    status, out, _ = run(capsys, path, '--crs', 'EPSG:25832', '--shift', 100, 200, 3, '--yaw', 90)
    assert status == 0 and place_of(MapSource(path)) == Place('EPSG:25832', 100, 200, 3, 90)
    assert [p.name for p in Path(tmp_path).glob('m.persem*')] == ['m.persem']


def test_a_map_that_is_being_written_is_left_alone(tmp_path, capsys):
    path = tmp_path / 'm.persem'
    flight(path)
    lock = WriterLock(path)
    try:
        status, _, err = run(capsys, path, '--crs', 'EPSG:25832')
    finally:
        lock.close()
    assert status == 1 and 'is being written by' in err and not place_of(MapSource(path)).crs


def test_a_quarter_turn_is_exact():
    assert Place(yaw=90.0).placed(np.array([[2.0, 1.0, 5.0]])).tolist() == [[-1.0, 2.0, 5.0]]


def test_rasters_and_points_lie_where_the_place_says(tmp_path):
    rasterio = pytest.importorskip('rasterio', reason='needs the extra gis')
    laspy = pytest.importorskip('laspy', reason='needs the extra gis')
    flight(tmp_path / 'm.persem')
    main(['map', 'georeference', str(tmp_path / 'm.persem'), '--crs', PLACE.crs, '--shift',
          '691000', '5335000', '500', '--yaw', '30'])
    assert main(['map', 'export', str(tmp_path / 'm.persem'), '--laz', str(tmp_path / 'a.laz'),
                 '--geotiff', str(tmp_path / 'a.tif')]) == 0
    source = MapSource(tmp_path / 'm.persem')
    wanted = PLACE.placed(source.centres(np.array([[i, 0, 0] for i in range(20)])))
    las = laspy.read(tmp_path / 'a.laz')
    assert np.abs(las.xyz[np.argsort(las.x)] - wanted).max() < 1e-3
    assert las.header.parse_crs().to_epsg() == 32632
    with rasterio.open(tmp_path / 'a.tif') as raster:
        assert raster.crs.to_epsg() == 32632
        values = list(raster.sample(wanted[:, :2].tolist()))
    assert np.ravel(values).tolist() == [1] * 20


@pytest.mark.parametrize(('option', 'library'), [('--laz', 'lazrs'), ('--geotiff', 'rasterio')])
def test_nothing_is_written_in_a_system_that_does_not_exist(tmp_path, capsys, option, library):
    pytest.importorskip(library, reason='needs the extra gis')
    flight(tmp_path / 'm.persem')
    assert main(['map', 'export', str(tmp_path / 'm.persem'), option, str(tmp_path / 'a'),
                 '--set', 'map.crs=EPSG:99999']) == 1
    out, err = capsys.readouterr()
    assert out == '' and len(err.splitlines()) == 1
    assert "there is no coordinate reference system 'EPSG:99999'" in err
    assert [p.name for p in tmp_path.iterdir()] == ['m.persem']


@pytest.mark.parametrize('row', ['9' * 30 + ',48,11,500', '-1,48,11,500', '1,48,11', 'a,48,11,5',
                                 '1.5e3,48,11,500', '9' * 5000 + ',1,2,3', '1,nan,11,x'])
def test_a_table_with_what_is_no_fix(tmp_path, row):
    path = tmp_path / 'fixes.csv'
    path.write_text(f'stamp,latitude,longitude,altitude\n{row}\n')
    with pytest.raises(PersemError, match='line 2: .*expected a line a fix'):
        read_fixes(path)


def test_fixes_that_are_nowhere_are_none(tmp_path, capsys):
    source = flight(tmp_path / 'm.persem')
    rows = [(s, a, o, u) for (s, a, o, _), u in zip(fixes_of(source), [1e308, -1e300] * 10)]
    status, _, errors = run(capsys, source.path, '--fix', table(tmp_path / 'f.csv', rows))
    assert status == 1 and '0 of 0 fixes lie within the flight' in errors


def test_a_kill_while_a_place_is_entered_leaves_a_map_that_is_read(tmp_path):
    path = flight(tmp_path / 'm.persem').path
    code = f"""
import os, sqlite3
from persem_ros.outputs.export import georeference
from persem_ros.outputs.export.place import Place
georeference.fold_log = lambda *_, **__: os._exit(9)
georeference.enter({str(path)!r}, Place('EPSG:32632', 1.0, 2.0, 3.0, 4.0))
"""
    assert subprocess.run([sys.executable, '-c', code], cwd=ROOT).returncode == 9
    store.load(path)
    georeference.enter(path, PLACE)
    assert place_of(MapSource(path)) == PLACE
    assert [p.name for p in tmp_path.iterdir()] == ['m.persem']
