"""The evaluation against the replay's metrics, and its folder: resumed, refused, complete."""

import csv
import io
import itertools
import json
import logging
import re

from hypothesis import given, settings as examples, strategies as st
import numpy as np
from persem_ros import cli
from persem_ros.core.refine.regions import regions
from persem_ros.errors import PersemError
from persem_ros.evaluate import run
from persem_ros.evaluate.measure import combine, intervals
from persem_ros.evaluate.measure.taxonomy import taxonomy
from persem_ros.evaluate.measure.voxel_kinds import kinds_of
from persem_ros.evaluate.show.paper_tables import tables
from persem_ros.evaluate.show.table import comma_separated, console, latex, markdown
from persem_ros.evaluate.work import manifest
from persem_ros.evaluate.work.sequence import evaluate_sequence, Sequence
from persem_ros.evaluate.work.stream import Disturbance
from persem_ros.evaluate.work.task import ALL_METHODS, Task
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.results.metrics import Metrics
from persem_ros.pipeline import Pipeline
from persem_ros.rendering import Renderer
from persem_ros.settings.config import Config, METHODS, updated
from persem_ros.settings.legend import Legend
import pytest
import reference
import worlds

SETTINGS = {'memory.voxel_size': 0.2, 'memory.dynamic_labels': (worlds.MOVING,)}
LEGEND = ('title: small\nclasses:\n- {id: 1, name: one, group: a}\n'
          '- {id: 3, name: three, group: a}\n- {id: 7, name: seven, group: b}\n'
          '- {id: 9, name: mover, group: b, dynamic: true}\n'
          '- {id: 255, name: nothing, ignored: true}\n')


def config(**values):
    return updated(Config(), {**SETTINGS, **{k.replace('__', '.'): v for k, v in values.items()}})


def replayed(path, config, table=None):
    """Return the replay's metrics of all methods: every method rendered, every pixel counted."""
    pipeline = Pipeline(config)
    with Recording(path, config) as recording:
        for frame in recording.frames():
            pipeline.add(frame)
        pipeline.refine()
        renderer, metrics = Renderer(pipeline, ALL_METHODS), Metrics(ALL_METHODS, table)
        renderer.relabel()
        codes = regions(pipeline.memory)[0]
        for frame in recording.frames(truth=True):
            r = renderer.render(frame)
            at = np.where(r.voxels >= 0, codes[r.voxels], np.uint8(0))
            metrics.update(r.valid, r.images, r.truth, at, frame.sensor)
    return metrics


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    return worlds.write(tmp_path_factory.mktemp('recordings') / 'wall')


@pytest.mark.parametrize('grouped, dynamic, labels, with_truth', [
    (False, True, '', True), (False, True, '', False), (False, True, '', lambda i: i % 3 != 1),
    (True, True, LEGEND, True), (True, False, LEGEND, lambda i: i % 3 != 1),
    (False, False, LEGEND, True), (True, True, LEGEND, False)],
    ids=['plain', 'no truth', 'truth at another rate', 'grouped', 'grouped, without dynamic',
         'without dynamic', 'grouped, no truth'])
def test_equals_the_replays_metrics(tmp_path, grouped, dynamic, labels, with_truth):
    path = worlds.write(tmp_path / 'r', with_truth=with_truth)
    file = ''
    if labels:
        (tmp_path / 'legend.yaml').write_text(labels)
        file = str(tmp_path / 'legend.yaml')
    table = taxonomy(file, grouped, dynamic).table
    expected = replayed(path, config(), table)
    summary, arrays = evaluate_sequence(Task(str(path), config(), labels=file, grouped=grouped,
                                             dynamic=dynamic))
    for key, value in expected.result().items():
        assert summary[key] == value, key
    counts = expected.flicker_counts()
    changed, compared = arrays['frame/changed'].sum(0), arrays['frame/compared'].sum(0)
    for m, name in enumerate((*ALL_METHODS, 'truth')):
        assert counts[name] == (changed[m], compared[m])
    for m, name in enumerate(ALL_METHODS if with_truth is True else ()):
        ids, matrix = expected.confusion(name)
        places = [arrays['ids'].tolist().index(i) for i in ids]
        assert (arrays['matrix'][m][np.ix_(places, places)] == matrix).all()
        assert arrays['matrix'][m].sum() == matrix.sum()


def test_truth_of_another_size(tmp_path, recording):
    large = worlds.write(tmp_path / 'wall', truth_scale=3)
    one, two = (evaluate_sequence(Task(str(path), config()))[0] for path in (recording, large))
    assert one['has_truth'] and {**one, 'runtime': 0} == {**two, 'runtime': 0}


def test_other_settings_and_more_classes_than_room(tmp_path, monkeypatch):
    from persem_ros.evaluate.measure import counts
    monkeypatch.setattr(counts.Counts.__init__, '__defaults__', (2,))
    path = worlds.write(tmp_path / 'r')
    other = config(memory__stride=2, refine__neighbours=6, refine__method='trust',
                   memory__max_depth=2.08)
    summary, _ = evaluate_sequence(Task(str(path), other))
    assert {k: summary[k] for k in ('methods', 'truth_flicker')} == {
        k: v for k, v in replayed(path, other).result().items() if k != 'regions'}


@examples(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_kinds_stand_for_their_voxels(seed):
    rng = np.random.default_rng(seed)
    n, methods = int(rng.integers(1, 60)), int(rng.integers(1, 5))
    labels = rng.integers(0, 4, (methods, n)).astype(np.uint16)
    codes = rng.integers(0, 3, n).astype(np.uint8)
    index = np.zeros(65536, np.uint16)
    index[:5] = rng.integers(0, 3, 5)
    kinds = kinds_of(labels, codes, index, dynamic=(4, -1))
    assert (kinds.classes[kinds.of] == index[labels].T).all()
    assert (kinds.codes[kinds.of] == codes).all()
    rows = {(*index[labels[:, v]].tolist(), codes[v]) for v in range(n)}
    assert len(np.unique(kinds.of)) == len(rows)
    assert (kinds.classes[kinds.moving[4]:][:8] == index[4]).all()
    assert kinds.codes[kinds.moving[4]:].tolist() == list(range(8))


def test_intervals_hold_what_they_promise():
    # A method that is right at 60 % of the pixels against one at 50 %, block by block with
    # noise: the interval of the difference covers 10 points in about 95 of 100 sequences.
    rng, covered = np.random.default_rng(1), 0
    for _ in range(120):
        hits = np.stack([rng.normal(500, 60, 30), rng.normal(600, 60, 30)], 1)
        blocks = {name: np.zeros((30, 4, *shape)) for name, shape in (
            ('hits', (2, 2)), ('predicted', (2, 2)), ('true', (2,)), ('changed', (3,)),
            ('pairs', ()), ('pixels', ()))}
        blocks['hits'][:, :, :, 1] = hits[:, None]
        blocks['predicted'][:, :, :, 1] = blocks['true'][:, :, None, 1] = 1000
        row = intervals.differences([blocks], ('a', 'b'), 'a', 400)['all']['b']
        assert row['flicker']['value'] is None and row['flicker']['low'] is None
        covered += row['pixel_accuracy']['low'] <= 10 <= row['pixel_accuracy']['high']
        assert row['pixel_accuracy']['value'] == pytest.approx(
            (hits[:, 1] - hits[:, 0]).mean() / 10)
    assert 0.88 <= covered / 120 <= 0.99


def test_intervals_of_drawn_sequences():
    gains, sequences = (1.0, 2.0, 4.0, 8.0, -3.0), []
    for gain in gains:
        blocks = {name: np.zeros((6, 4, *shape)) for name, shape in (
            ('hits', (2, 2)), ('predicted', (2, 2)), ('true', (2,)), ('changed', (3,)),
            ('pairs', ()), ('pixels', ()))}
        blocks['hits'][..., 1] = 500, 500 + 10 * gain
        blocks['predicted'][..., 1] = blocks['true'][..., 1] = 1000
        sequences.append(blocks)
    row = intervals.differences(sequences, ('a', 'b'), 'a', 4000, whole=True)['all']['b']
    means = [np.mean(drawn) for drawn in itertools.product(gains, repeat=5)]    # all there are
    found, wanted = row['pixel_accuracy'], np.percentile(means, [2.5, 97.5])
    assert [found['low'], found['high']] == pytest.approx(wanted, abs=0.3)
    assert (found['value'], found['rises'], found['falls']) == (pytest.approx(2.4), 4, 1)
    row = intervals.differences(sequences[:4], ('a', 'b'), 'a', 100, whole=True)['all']['b']
    assert row['pixel_accuracy']['low'] is None


def test_identical_methods_differ_by_nothing(recording):
    summary, arrays = evaluate_sequence(Task(str(recording), config()))
    blocks = {k: arrays[k] for k in combine.BLOCK_ARRAYS}
    names = summary['methods_order']
    for key in ('hits', 'predicted'):
        blocks[key] = blocks[key].copy()
        blocks[key][:, :, names.index('trust')] = blocks[key][:, :, names.index('majority')]
    row = intervals.differences([blocks], names, 'majority', 100)['all']['trust']
    assert {k: row['miou'][k] for k in ('value', 'low', 'high', 'rises')} == {
        'value': 0, 'low': 0, 'high': 0, 'rises': 0}


def test_folder_tables_and_second_run(tmp_path, recording, capsys, caplog):
    other = worlds.write(tmp_path / 'other', seed=1, frames=9)
    words = ['evaluate', str(recording), str(other), '--out', str(tmp_path / 'out'),
             '--no-figures', '--workers', '1', '--set', 'memory.voxel_size=0.2']
    assert cli.main(words) == 0
    first = capsys.readouterr().out
    evaluation = json.loads((tmp_path / 'out' / 'evaluation.json').read_text())
    assert list(evaluation['sequences']) == ['wall', 'other']
    values = [s['methods']['persem']['miou'] for s in evaluation['sequences'].values()]
    assert evaluation['macro']['all']['methods']['persem']['miou'] == pytest.approx(
        np.mean(values))
    for name in ('main', 'sequences', 'classes', 'ablation', 'trust', 'regions', 'runtime',
                 'gains_over_majority', 'gains_over_raw2d'):
        assert (tmp_path / 'out' / 'tables' / f'{name}.tex').read_text().count('toprule') == 1
    assert '(truth)' in first and 'persem' in first
    caplog.set_level(logging.INFO, 'persem_ros')
    stamp = (tmp_path / 'out' / 'sequences' / 'wall' / 'arrays.npz').stat().st_mtime_ns
    assert cli.main(words) == 0
    assert '2 of 2 are finished already' in caplog.text
    assert capsys.readouterr().out == first
    assert (tmp_path / 'out' / 'sequences' / 'wall' / 'arrays.npz').stat().st_mtime_ns == stamp


def test_half_finished_folders(tmp_path, recording, capsys):
    out = str(tmp_path / 'out')
    words = ['evaluate', str(recording), '--out', out, '--no-figures', '--workers', '1']
    assert cli.main(words) == 0
    (tmp_path / 'out' / 'sequences' / 'wall' / 'manifest.json').unlink()
    assert cli.main(words) == 0         # what is not whole is computed again
    capsys.readouterr()
    assert cli.main([*words, '--set', 'refine.eta=0.4']) == 1
    error = capsys.readouterr().err
    assert 'refine.eta: 0.3 -> 0.4' in error and '--force' in error and error.count('\n') == 1
    assert cli.main([*words, '--set', 'refine.eta=0.4', '--force']) == 0
    for title, i in (('one', 3), ('two', 5)):
        (tmp_path / f'{title}.yaml').write_text(
            f'title: {title}\nclasses:\n- {{id: 7, name: x}}\n- {{id: {i}, name: three}}\n')
    assert cli.main([*words, '--force', '--labels', str(tmp_path / 'one.yaml')]) == 0
    capsys.readouterr()
    assert cli.main([*words, '--labels', str(tmp_path / 'two.yaml')]) == 1
    assert ("(taxonomy: 'one' -> 'two', only before: 3 three, only now: 5 three)"
            in capsys.readouterr().err)
    assert cli.main(words) == 1
    assert "(taxonomy: 'one' -> none)" in capsys.readouterr().err
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'letter.txt').write_text('dear')
    assert cli.main([*words[:3], str(tmp_path / 'full')]) == 1
    assert 'holds no evaluation' in capsys.readouterr().err


def test_a_changed_recording_is_another(tmp_path):
    path = worlds.write(tmp_path / 'r')
    before = manifest.identity(Task(str(path)))
    manifest.content_hash.cache_clear()
    (path / 'note.txt').write_text('x')
    assert manifest.identity(Task(str(path))) != before
    manifest.content_hash.cache_clear()
    (path / 'note.txt').unlink()
    assert manifest.identity(Task(str(path))) == before


def test_refusals(tmp_path, recording, capsys):
    def refused(*words):
        assert cli.main(['evaluate', *map(str, words), '--no-figures', '--workers', '1']) == 1
        return capsys.readouterr().err

    assert "did you mean 'majority'" in refused(recording, '--methods', 'majorty')
    assert 'does not exist' in refused(tmp_path / 'nothing')
    assert 'map.path' in refused(recording, '--set', 'map.path=x.persem')
    assert 'name one with --labels' in refused(recording, '--grouped')
    assert 'neither a file nor a shipped legend' in refused(recording, '--labels', 'twon')
    empty = worlds.write(tmp_path / 'empty', frames=0)
    assert 'empty' in refused(empty)


def test_help_counts_the_methods(capsys):
    assert cli.main(['evaluate', '--help']) == 0
    assert f'(default: all {len(ALL_METHODS)})' in ' '.join(capsys.readouterr().out.split())


def test_no_truth_is_said(tmp_path, capsys):
    path = worlds.write(tmp_path / 'blind', with_truth=False)
    assert cli.main(['evaluate', str(path), '--workers', '1']) == 0
    said = capsys.readouterr()
    assert 'has no truth' in said.err and 'accuracy unknown, flicker only' in said.out


def test_ids_outside_the_taxonomy_are_listed(tmp_path, recording, caplog):
    (tmp_path / 'small.yaml').write_text(
        'classes:\n- {id: 3, name: three}\n- {id: 255, name: nothing, ignored: true}\n')
    evaluation = run.evaluate([recording], tmp_path / 'out', config(),
                              labels=str(tmp_path / 'small.yaml'), workers=1, figures=False)
    outside = evaluation['sequences']['wall']['outside_taxonomy']
    assert set(outside) == {'7', str(worlds.MOVING)}
    assert re.search(rf'7 \({outside["7"]} pixels\)', caplog.text)
    assert list(evaluation['sequences']['wall']['methods']['raw2d']['iou']) == ['3']


def test_groups_have_the_name_and_color_of_the_group():
    legend = Legend.from_yaml(LEGEND)
    found = taxonomy('', True, True, legend)
    assert found.table == {1: 1, 3: 1, 7: 7, 9: 7}
    assert found.legend.name(1) == 'a' and found.legend.name(7) == 'b'
    assert taxonomy('', True, False, legend).table == {1: 1, 3: 1, 7: 7}
    assert taxonomy('uavscenes', True).table[18] == taxonomy('uavscenes', True).table[3]


def test_predictions_take_the_place_of_labels(tmp_path, recording, caplog):
    import bags
    import cv2
    (tmp_path / 'p').mkdir()
    for i in range(11):
        cv2.imwrite(str(tmp_path / 'p' / f'{bags.stamp(i)}.png'), worlds.truth(i))
    evaluation = run.evaluate([recording], tmp_path / 'out', config(), workers=1, figures=False,
                              predictions=str(tmp_path / 'p'))
    summary = evaluation['sequences']['wall']
    assert summary['methods']['raw2d']['pixel_accuracy'] == 100
    assert summary['frames'] == {'used': 11, 'dropped': summary['frames']['dropped'],
                                 'without_prediction': 1}
    assert '1 frames have no prediction' in caplog.text
    (tmp_path / 'p' / 'last.png').write_bytes(b'')
    with pytest.raises(PersemError, match='named by the stamps'):
        run.evaluate([recording], tmp_path / 'out2', config(), workers=1, figures=False,
                     predictions=str(tmp_path / 'p'))


def test_disturbances(recording):
    def result(**values):
        return evaluate_sequence(Task(str(recording), config(), pictures=False,
                                      disturbance=Disturbance(**values)))[0]

    plain = result()
    assert result(seed=5)['methods'] == plain['methods']    # nothing to draw
    backwards = result(order='reversed')
    assert backwards['methods']['majority'] == plain['methods']['majority']
    assert backwards['methods']['recency'] != plain['methods']['recency']
    noisy = result(pose_noise=0.3)
    assert noisy['voxels'] > plain['voxels'] and noisy == {**result(pose_noise=0.3),
                                                           'runtime': noisy['runtime']}
    assert result(pose_drift=1.0)['voxels'] != plain['voxels']
    assert result(attitude_noise=5.0)['voxels'] != plain['voxels']
    assert result(depth_noise=0.1)['voxels'] > plain['voxels']


def test_tables_are_whole(recording):
    evaluation = combine.combined({'a_b': evaluate_sequence(Task(str(recording), config()))}, 50)
    for table in tables(evaluation):
        assert all(len(cells) == len(table.columns) for _, cells in table.rows)
        assert len(markdown(table).splitlines()) >= 4 + len(table.rows)
        text = latex(table)
        assert text.count('&') >= len(table.rows) * len(table.columns)
        assert not re.search(r'(?<!\\)_', text.replace(f'\\label{{tab:{table.key}}}', ''))
        rows = list(csv.reader(io.StringIO(comma_separated(table))))
        assert len({len(row) for row in rows}) == 1 and len(rows) == 1 + len(table.rows)
        assert len(console(table).splitlines()) >= 3 + len(table.rows)
        assert table.key == 'classes' or 'flicker' in console(table).lower()


def test_methods_against_the_reference(recording):
    config_ = config()
    sequence = Sequence(Task(str(recording), config_), Recording(recording, config_))
    with sequence.recording:
        sequence.integrate()
        sequence.label()
        plain = reference.Memory(0.2)
        for frame in sequence.recording.frames():
            points, labels = reference.backproject(
                frame.depth.tolist(), frame.camera.rays.tolist(), frame.labels.tolist(),
                config_.memory.ignore_labels, config_.memory.dynamic_labels)
            plain.add(reference.observe(points, labels, frame.T_map_camera.tolist(), 0.2),
                      frame.stamp, labels, T=frame.T_map_camera)
    memory = sequence.pipeline.memory
    for method in METHODS:
        found = sequence.labels_of(method)
        for voxel, (label, _) in reference.label(plain, method, config_.refine).items():
            assert found[memory.number(voxel)] == label, (method, voxel)


def named(tmp_path, **names):
    """Return the path of a legend of {name: id}, and write it."""
    path = tmp_path / 'given.yaml'
    path.write_text('classes:\n' + ''.join(f'- {{id: {i}, name: {n}}}\n'
                                           for n, i in names.items()))
    return path


def test_ids_follow_the_names_of_the_taxonomy(tmp_path, caplog):
    path = worlds.write(tmp_path / 'r', legend=named(tmp_path, a=1, b=3, c=7).read_text())

    def evaluated(out, labels, **settings):
        shown = run.evaluate([path], tmp_path / out, config(**settings), ('raw2d', 'persem'),
                             labels=str(labels), workers=1, figures=False)['sequences']['r']
        return shown, {c['name']: shown['methods']['raw2d']['iou'].get(str(c['id']))
                       for c in shown['classes']}

    same, by_name = evaluated('same', named(tmp_path, a=1, b=3))
    assert 'ids follow' not in caplog.text and set(same['methods']['raw2d']['iou']) == {'3'}
    moved, by_moved_name = evaluated('moved', named(tmp_path, b=7, a=3))
    assert ("r: ids follow their names, as --labels has them: 'a' 1 is 3, 'b' 3 is 7, 'c' 7 is "
            "0; without a name in --labels: 7 'c'; to keep ids") in caplog.text
    assert "are ignored: 0 'c' (" in caplog.text and moved['names'].startswith('ids follow')
    assert by_moved_name == by_name and by_name['b'] > 50
    kept = evaluated('kept', named(tmp_path, b=7, a=3), labels__topic='none')[0]
    assert set(kept['methods']['raw2d']['iou']) == {'3', '7'} and kept['names'] == ''


def test_names_that_only_differ_are_said(tmp_path, caplog):
    path = worlds.write(tmp_path / 'r', legend=named(tmp_path, a=1, b=3, c=7).read_text())
    plain = run.evaluate([path], tmp_path / 'plain', config(), workers=1, figures=False)
    other = run.evaluate([path], tmp_path / 'other', config(), labels=str(
        named(tmp_path, a=1, street=3, c=7, mover=9)), workers=1, figures=False)
    assert ("r: --labels and the recording name classes otherwise, ids stay as they are: 3 'b' is "
            "'street'") in caplog.text
    assert plain['sequences']['r']['methods'] == other['sequences']['r']['methods']
