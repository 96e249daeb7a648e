"""Sweeps: the points are single evaluations, resumed, drawn, refused where they make no sense."""

import json
import logging

from persem_ros import cli
from persem_ros.errors import PersemError
from persem_ros.evaluate.sweep import parse_vary, sweep
from persem_ros.evaluate.work.sequence import evaluate_sequence
from persem_ros.evaluate.work.stream import Disturbance
from persem_ros.evaluate.work.task import Task
from persem_ros.settings.config import Config, updated
import pytest
import worlds


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    return worlds.write(tmp_path_factory.mktemp('recordings') / 'wall')


def test_points_are_evaluations(tmp_path, recording):
    config = Config()
    axes = parse_vary(['refine.eta=0,0.5', 'disturb.pose_noise=0,0.2'], config)
    assert axes == {'refine.eta': [0.0, 0.5], 'disturb.pose_noise': [0, 0.2]}
    result = sweep([recording], tmp_path, config, axes, workers=1)
    assert [p['values'] for p in result['points']] == [
        {'refine.eta': e, 'disturb.pose_noise': n} for e in (0.0, 0.5) for n in (0, 0.2)]
    alone, _ = evaluate_sequence(Task(
        str(recording), updated(config, {'refine.eta': 0.5}), ('majority', 'persem'),
        disturbance=Disturbance(pose_noise=0.2)))
    row = result['points'][3]['mean']
    assert row['methods']['persem']['flicker'] == alone['methods']['persem']['flicker']
    assert row['voxels'] == alone['voxels']
    assert {p.name for p in (tmp_path / 'figures').iterdir()} == {
        f'heat-{m}.{kind}' for m in ('majority', 'persem', 'geometry') for kind in ('svg', 'png')}
    assert json.loads((tmp_path / 'sweep.json').read_text())['points'] == result['points']


def test_one_setting_at_a_time(tmp_path, recording, capsys):
    words = ['sweep', str(recording), '--out', str(tmp_path / 'out'), '--workers', '1', '--each',
             '--no-figures', '--methods', 'majority,history', '--vary', 'refine.eta=0,1', '--vary',
             'memory.voxel_size=0.25']
    assert cli.main(words) == 0
    result = json.loads((tmp_path / 'out' / 'sweep.json').read_text())
    assert [p['values'] for p in result['points']] == [
        {}, {'refine.eta': 0.0}, {'refine.eta': 1.0}, {'memory.voxel_size': 0.25}]
    assert len({p['mean']['voxels'] for p in result['points']}) == 2
    table = capsys.readouterr().out
    assert 'nothing' in table and 'memory.voxel_size=0.25' in table


def test_more_values_use_what_is_finished(tmp_path, recording, capsys, caplog):
    words = ['sweep', str(recording), '--out', str(tmp_path / 'out'), '--workers', '1', '--vary']
    assert cli.main([*words, 'ema.alpha=0.5,0.9', '--no-figures']) == 0
    caplog.set_level(logging.INFO, 'persem_ros')
    assert cli.main([*words, 'ema.alpha=0.5,0.7,0.9']) == 0
    assert '2 of 3 are finished already' in caplog.text
    assert (tmp_path / 'out' / 'figures' / 'curves.png').stat().st_size > 10000
    assert 'http' not in (tmp_path / 'out' / 'report.html').read_text().replace('http-equiv', '')
    capsys.readouterr()
    assert cli.main([*words, 'refine.eta=0.1']) == 1
    assert 'axes' in capsys.readouterr().err


def test_order_of_integration_is_an_axis(tmp_path, recording):
    axes = parse_vary(['disturb.order=recorded,reversed,shuffled'], Config())
    config = updated(Config(), {'memory.voxel_size': 0.1, 'refine.lambda_recency': 0.5})
    result = sweep([recording], tmp_path, config, axes, ('majority', 'recency'), workers=1,
                   figures=False)
    values = [p['mean']['methods'] for p in result['points']]
    assert values[0]['majority'] == values[1]['majority'] == values[2]['majority']
    assert values[0]['recency'] != values[1]['recency']


@pytest.mark.parametrize('items, said', [
    (['refine.etta=0,1'], "did you mean 'refine.eta'"),
    (['refine.eta=0,2'], 'expected 0.0 to 1.0'),
    (['refine.eta'], 'expected NAME=A,B,C'),
    (['refine.eta='], 'expected NAME=A,B,C'),
    (['refine.eta=0', 'refine.eta=1'], 'given twice'),
    (['refine.method=persem,geometry'], 'several methods at once; use --methods persem,geometry'),
    (['map.rate=1,2'], 'no measure depends on it'),
    (['refine.period=1,2'], 'no measure depends on it'),
    (['disturb.posenoise=1'], "did you mean 'disturb.pose_noise'"),
    (['disturb.order=backwards'], 'recorded, reversed, shuffled'),
    (['disturb.depth_noise=-1'], 'a number from 0 on'),
    (['disturb.pose_noise=[1,2]'], 'a number from 0 on'),
    (['refine.neighbours=' + ','.join(['6'] * 3)] + ['memory.voxel_size=' + ','.join(
        str(0.1 + k / 1000) for k in range(2001))], '1 to 2000 points'),
])
def test_refusals(items, said):
    with pytest.raises(PersemError, match=said):
        parse_vary(items, Config())


@pytest.mark.parametrize('item, said', [
    ('ema.alpha=0.5,0.9', 'only ema2d depends .* use --methods majority,persem,ema2d'),
    ('refine.geometry.window=10,20', 'only geometry depends .* majority,persem,geometry')])
def test_settings_of_a_method_that_is_not_measured(tmp_path, item, said):
    with pytest.raises(PersemError, match=said):
        sweep(['nowhere'], tmp_path, Config(), parse_vary([item], Config()),
              ('majority', 'persem'))


def test_lists_are_values_too():
    axes = parse_vary(['memory.ignore_labels=[255],[0, 255]'], Config())
    assert axes == {'memory.ignore_labels': [(255,), (0, 255)]}


def test_voxels_that_do_not_suit_are_said_of_their_point(tmp_path, recording, caplog):
    axes = parse_vary(['memory.voxel_size=0.25,50'], Config())
    sweep([recording], tmp_path, Config(), axes, methods=('majority',), workers=1, figures=False)
    said = [r.getMessage() for r in caplog.records if 'a voxel of' in r.getMessage()]
    assert len(said) == 1
    assert said[0].startswith('wall at memory.voxel_size=50.0: a voxel of 50 m spans about')
    assert '--set memory.voxel_size=' in said[0]
