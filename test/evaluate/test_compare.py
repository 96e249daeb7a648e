"""Comparing two results: what differs is said, drawn, and as sure as it is."""

import json

from persem_ros import cli
from persem_ros.evaluate import run
from persem_ros.evaluate.compare import compare
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.settings.config import Config, updated
import pytest
import worlds

METHODS = 'raw2d', 'majority', 'history', 'persem'


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    base = tmp_path_factory.mktemp('results')
    recording = worlds.write(base / 'wall')
    for name, eta in (('a', 0.3), ('b', 0.9)):
        config = updated(Config(), {'refine.eta': eta, 'memory.voxel_size': 0.2})
        run.evaluate([recording], base / name, config, METHODS, workers=1, figures=False)
    return base


def test_settings_and_measures(results, tmp_path, capsys):
    assert cli.main(['compare', str(results / 'a'), str(results / 'b'), '--out',
                     str(tmp_path / 'c')]) == 0
    said = capsys.readouterr().out
    assert 'refine.eta: 0.3 -> 0.9' in said and 'paired block bootstrap' in said
    assert {p.name for p in (tmp_path / 'c').iterdir()} == {
        f'compare-wall.{kind}' for kind in ('md', 'tex', 'csv', 'svg', 'png')}


def test_majority_does_not_depend_on_eta(results):
    lines, (item,) = compare(results / 'a', results / 'b')
    assert [line for line in lines if not line.startswith('refine.eta')] == []
    cells = {head[0]: row for head, row in item.rows}
    assert [(c.value, c.low, c.high) for c in cells['majority'][2::3]] == [(0, 0, 0)] * 3
    assert cells['history'][2].value != 0


def test_other_frames_are_said(results, tmp_path, capsys):
    config = updated(Config(), {'memory.voxel_size': 0.2})
    run.evaluate([results / 'wall'], tmp_path / 'short', config, METHODS, workers=1,
                 figures=False, excerpt=Excerpt(end='0.5'))
    used = json.loads((tmp_path / 'short' / 'evaluation.json').read_text())[
        'sequences']['wall']['frames']['used']
    assert cli.main(['compare', str(results / 'a'), str(tmp_path / 'short')]) == 0
    said = capsys.readouterr().out
    assert (f'wall: 12 frames against {used}, B - A is no gain of a method; to compare, A has no '
            '--start, --end or --every, B --end 0.5: use the same for both') in said
    assert 'raw2d' in said and used < 12 and 'different data' not in said


def test_other_data_and_voxels_are_said(results, tmp_path):
    other = worlds.write(tmp_path / 'wall', seed=5)
    config = updated(Config(), {'refine.eta': 0.9})
    run.evaluate([other], tmp_path / 'c', config, METHODS, workers=1, figures=False)
    lines, (item,) = compare(results / 'a', tmp_path / 'c')
    text = ' '.join(lines)
    assert 'wall: the recordings hold different data' in text and 'against 12' not in text
    assert 'voxels of 0.2 m against 0.5 m beside other settings' in text
    assert 'give both --set memory.voxel_size=0.2' in text and item.rows


def test_a_result_equals_itself(results, capsys):
    assert cli.main(['compare', str(results / 'a'), str(results / 'a')]) == 0
    assert 'made with the same settings and versions' in capsys.readouterr().out


def test_replays_can_be_compared(results, tmp_path, capsys):
    assert cli.main(['replay', str(results / 'wall'), '--set',
                     'memory.voxel_size=0.2', '--out', str(tmp_path / 'r')]) == 0
    lines, (item,) = compare(tmp_path / 'r', results / 'a')
    assert [head[0] for head, _ in item.rows] == ['raw2d', 'majority', 'persem', '(truth)']
    assert all(abs(cells[2].value) < 1e-9 for _, cells in item.rows[:-1])
    capsys.readouterr()
    assert cli.main(['compare', str(tmp_path / 'r'), str(tmp_path)]) == 1
    assert 'holds no result' in capsys.readouterr().err
