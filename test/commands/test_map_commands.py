"""persem map info, export, query on a small map, and what they refuse."""

from pathlib import Path

import core_worlds as cw
import numpy as np
from persem_ros.cli import main
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.map import store
from persem_ros.outputs.map.cloud import map_points
from persem_ros.outputs.map.ply import VERTEX
from persem_ros.settings import config_file
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

LEGEND = Legend.from_yaml("""
classes:
- {id: 1, name: road, color: [9, 9, 9]}
- {id: 2, name: "water\\e[31m", color: [0, 0, 255]}
""")


def saved(folder, method='persem', **settings):
    """Save a wall of ten voxels: one is water to itself and road to its neighbours."""
    config = updated(Config(), {'refine.method': method, 'map.origin': [100.0, 0.0, 0.0],
                                **settings})
    memory = cw.core_of([])
    memory.origin = (100.0, 0.0, 0.0)
    for t in range(4):
        seen = {(0, j, 0): (1, 1.0) for j in range(10) if t or j != 9}
        seen[0, 4, 0] = (2, 1.0) if t < 2 else (1, 0.75)
        memory.add(cw.observations(10 ** 9 * t + 5, seen))
    refine(memory, config.refine)
    store.save(folder / 'wall.persem', memory, config, LEGEND)
    return folder / 'wall.persem', memory


@pytest.fixture
def wall(tmp_path):
    """Return (path of a map file, its memory)."""
    return saved(tmp_path)


def run(capsys, *arguments):
    """Return (status, standard output, standard error) of a command."""
    status = main([str(argument) for argument in arguments])
    return (status, *capsys.readouterr())


def vertices(path):
    """Return the points of a PLY file."""
    return np.frombuffer(Path(path).read_bytes().partition(b'end_header\n')[2], VERTEX)


def test_info(capsys, wall):
    status, out, err = run(capsys, 'map', 'info', wall[0])
    assert (status, err) == (0, '')
    assert 'frame map, voxels of 0.5 m, origin 100 0 0 m' in out
    assert '10 voxels in 2 blocks, 39 observations' in out
    assert 'extent from 100.25 0.25 0.25 to 100.25 4.75 0.25 m' in out
    assert '4 frames from 1970-01-01 00:00:00 UTC to 1970-01-01 00:00:03 UTC, 1 session' in out
    rows = [line.split() for line in out.splitlines() if line.strip().startswith('1  road')]
    assert rows == [['1', 'road', '10', '100.0%', '9', '1', '0', '0', '0']]
    assert out.splitlines()[-1] == 'settings other than the defaults: map.origin=[100.0, 0.0, 0.0]'


def test_settings_are_printed_as_set_takes_them(capsys, tmp_path):
    given = {'memory.ignore_labels': [0], 'camera.rectified': True, 'frames.map': 'odom'}
    path, _ = saved(tmp_path, **given)
    last = run(capsys, 'map', 'info', path)[1].splitlines()[-1]
    for item in ('memory.ignore_labels=[0]', 'camera.rectified=true', 'frames.map=odom'):
        assert f' {item}' in last
        name, value = config_file.parse_item(item)
        assert value == given[name]


def test_a_folder_in_place_of_its_map(capsys, wall, tmp_path):
    status, _, err = run(capsys, 'map', 'info', tmp_path)
    assert status == 1 and 'is a folder; expected a .persem file' in err
    wall[0].rename(tmp_path / 'map.persem')
    for words in (['info', tmp_path], ['query', tmp_path, 1, 2, 3]):
        status, _, err = run(capsys, 'map', *words)
        assert status == 1 and f'did you mean {tmp_path}/map.persem?' in err


def test_info_of_an_empty_map(capsys, tmp_path):
    store.save(tmp_path / 'empty.persem', cw.core_of([]), Config())
    status, out, _ = run(capsys, 'map', 'info', tmp_path / 'empty.persem')
    assert status == 0 and '0 voxels' in out and 'no frames' in out


def test_export_is_the_map(capsys, wall, tmp_path):
    path, memory = wall
    status, out, _ = run(capsys, 'map', 'export', path, '--ply', tmp_path / 'a.ply')
    assert (status, out) == (0, f'10 of 10 voxels written to {tmp_path}/a.ply\n')
    found, points = vertices(tmp_path / 'a.ply'), map_points(memory.voxels(), 0.5, LEGEND)
    for name in ('x', 'y', 'z', 'label', 'majority', 'confidence', 'observations', 'source'):
        assert (found[name] == points[name]).all()
    assert (found['red'] == 9).all()


def test_export_of_a_part(capsys, wall, tmp_path):
    out = tmp_path / 'a.ply'
    # the box is in the map frame, the points have the origin taken off
    assert run(capsys, 'map', 'export', wall[0], '--ply', out, '--crop', 100, 1, -1, 101, 2.3, 1,
               )[1].startswith('3 of 10')
    assert vertices(out)['y'].tolist() == [1.25, 1.75, 2.25]
    assert vertices(out)['x'].tolist() == [0.25] * 3
    before = out.read_bytes()
    status, _, err = run(capsys, 'map', 'export', wall[0], '--ply', out)
    assert status == 1 and f'{out} exists' in err and '--force' in err
    assert out.read_bytes() == before
    assert run(capsys, 'map', 'export', wall[0], '--ply', out, '--min-observations', 4, '--force',
               )[1].startswith('9 of 10')


def test_export_refuses_nothing_to_export(capsys, wall, tmp_path):
    out = tmp_path / 'a.ply'
    status, _, err = run(capsys, 'map', 'export', wall[0], '--ply', out, '--crop',
                         -1, -1, -1, 1, 1, 1)
    assert status == 1 and 'no voxel is left' in err and 'from 100.25 0.25 0.25' in err
    status, _, err = run(capsys, 'map', 'export', wall[0], '--ply', out, '--crop',
                         1, 1, 1, 0, 2, 2)
    assert status == 1 and 'expected x0 y0 z0 x1 y1 z1 with x0 < x1' in err
    assert not out.exists()
    status, _, err = run(capsys, 'map', 'export', wall[0], '--ply', wall[0] / 'below' / 'a.ply')
    assert status == 1 and 'cannot write' in err


def test_what_is_gone_is_told_not_exported_and_comes_back(capsys, wall, tmp_path):
    path, memory = wall
    whole = store.load(path).saved
    number = memory.find([[0, 4, 0]])[0]
    memory.store.passed[number], memory.m.voxels['gone'][number] = (9, 4, 6), 1
    memory.n_gone, memory.some_passed = 1, True
    store.save(path, memory, store.load(path).config(), LEGEND)
    assert '1 of the voxels are gone' in run(capsys, 'map', 'info', path)[1]
    out = run(capsys, 'map', 'query', path, 100.3, 2.2, 0.1)[1]
    assert 'gone: later frames looked through it in 6 seconds' in out and 'anchor: (1' not in out
    out = run(capsys, 'map', 'export', path, '--ply', tmp_path / 'a.ply')[1]
    assert out.startswith('9 of 10 voxels')
    assert run(capsys, 'map', 'restore', path) == (0, f'{path}: 1 voxels are back\n', '')
    back = store.load(path).saved
    assert not back.gone.any() and not back.passed.any() and (back.label == whole.label).all()
    assert 'the file stays as it is' in run(capsys, 'map', 'restore', path)[1]


def test_query_says_why(capsys, wall):
    status, out, err = run(capsys, 'map', 'query', wall[0], 100.3, 2.2, 0.1)
    assert (status, err) == (0, '')
    assert 'voxel 0 4 0, centre 100.250 2.250 0.250 m in map' in out
    assert 'label 1 road, by history (method persem), confidence 0.4286: its share of the ' \
           'evidence' in out
    assert '4 observations, majority label 2 water?[31m, 2 neighbours' in out
    assert 'anchor: (1 - 0.3) p_v + 0.3 q_v is largest for 1 road, 0.6000, ' \
           'against 0.4000 for the majority label: final' in out
    table = [line.split() for line in out.splitlines()]
    assert ['1', 'road', '1.5000', '0.4286', '1.0000', '1.0000', '0.6000'] in \
        [row[:-1] for row in table]
    steps = [row for row in table if len(row) > 5 and '.000000005' in row[1]]
    assert [row[2] for row in steps] == ['2', '2', '1', '1']
    assert [row[6] for row in steps] == ['0', '0', '1', '1']    # surprise


@pytest.mark.parametrize(('method', 'words'), [
    ('majority', 'fuses the history into one label'),
    ('trust', 'replay: no other label leads'),
    ('history', 'for the majority label: final'),
    ('context', 'most neighbours are 1 road'),
    ('context_history', 'for the majority label: final'),
    ('geometry', 'places of this height and shape are called')])
def test_query_for_each_kind_of_method(capsys, tmp_path, method, words):
    path, _ = saved(tmp_path, method)
    status, out, _ = run(capsys, 'map', 'query', path, 100.3, 2.2, 0.1)
    assert status == 0 and words in out
    assert 'this trace ends' not in out
    assert ('how probable the method holds it' in out) == (method == 'geometry')
    for heading in ('h_v: evidence', 's: share of the pixels'):     # what the columns are
        assert heading in out


def test_query_names_the_classes_that_are_said_to_be_elsewhere(capsys, tmp_path):
    path, _ = saved(tmp_path, 'geometry', **{'refine.geometry.heights': '1 50 99; 2 50 99'})
    status, out, _ = run(capsys, 'map', 'query', path, 100.3, 2.2, 0.1)
    assert status == 0 and 'hardly found so high, by refine.geometry.heights: road' in out
    assert '; against most votes, which say water' in out


def test_query_of_a_trust_proposal(capsys, tmp_path):
    path, _ = saved(tmp_path, **{'refine.eta': 0.0, 'refine.gamma': 0.5})
    status, out, _ = run(capsys, 'map', 'query', path, 100.3, 2.2, 0.1)
    assert status == 0
    assert 'label 1 road, by trust' in out
    assert 'above refine.tau_replay 0.1' in out
    assert "by 1.0000 in the neighbours' labels (above refine.tau_context 0.1)" in out
    assert '  accepted' in out


def test_query_of_a_voxel_that_is_not_refined(capsys, tmp_path):
    path, _ = saved(tmp_path, **{'refine.min_observations': 9})
    out = run(capsys, 'map', 'query', path, 100.3, 2.2, 0.1)[1]
    assert 'not refined: 4 observations, refine.min_observations is 9' in out


def test_query_beside_the_map(capsys, wall):
    status, out, err = run(capsys, 'map', 'query', wall[0], 100.3, -0.75, 0.25)
    assert (status, out) == (1, '')
    assert 'nothing was observed at 100.3 -0.75 0.25 m; ' \
           'the nearest voxel is 1.00 m away at 100.25 0.25 0.25' in err
    assert run(capsys, 'map', 'query', wall[0], 1e300, 0, 0)[0] == 1
    assert run(capsys, 'map', 'query', wall[0], 'nan', 0, 0)[0] == 1


@pytest.mark.parametrize('action', [['info'], ['export', '--ply', 'never.ply'],
                                    ['query', '1', '2', '3']])
def test_not_a_map(capsys, tmp_path, action):
    (tmp_path / 'other').write_text('x')
    status, out, err = run(capsys, 'map', action[0], tmp_path / 'other', *action[1:])
    assert (status, out) == (1, '')
    assert 'not a map file' in err and len(err.splitlines()) == 1
