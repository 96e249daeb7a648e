"""report.html: every section whatever the recording lacks, nothing trusted, nothing loaded."""

import base64
from html.parser import HTMLParser
import json
from pathlib import Path
import re
import shlex
import sys
from types import SimpleNamespace
import zlib

import bags
import core_worlds as cw
import cv2
import numpy as np
from persem_ros.cli import main
from persem_ros.commands import replay as replay_command
from persem_ros.errors import PersemError
from persem_ros.outputs.report import cloud3d, maps, series, strip, tables
from persem_ros.outputs.report.figure import FigureWatcher
from persem_ros.outputs.report.png import indexed_png
from persem_ros.replay import replay
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

ASSETS = Path(strip.__file__).parent / 'assets'
SECTIONS = {'frames', 'map', 'view', 'accuracy', 'flicker', 'regions', 'cost', 'legend', 'run'}
HOSTILE = ('</script><script>alert(1)</script>', '"><img src=x onerror=alert(2)>',
           "'; alert(3) //", '{{ 7 * 7 }} <!-- ')
LEGEND = Legend.from_yaml(json.dumps({'title': '<b>hostile</b>', 'classes': [
    {'id': i + 1, 'name': name, 'color': [40 * i, 255 - 40 * i, 90], 'group': f'<u>{i}</u>'}
    for i, name in enumerate(HOSTILE)]}))
VOID = {'meta', 'img', 'input', 'br', 'hr', 'link'}
SVG_VOID = {'polyline'}


class Page(HTMLParser):
    """A page taken apart; refuses what is not well-formed."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.texts, self.bodies = [], [], [], {}
        self.feed(text)
        self.close()
        assert not self.open
        ids = [attributes['id'] for _, attributes in self.tags if 'id' in attributes]
        assert len(ids) == len(set(ids))
        self.ids, self.text = set(ids), ' '.join(' '.join(self.texts).split())

    def handle_starttag(self, tag, attributes):
        assert len({name for name, _ in attributes}) == len(attributes)
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        assert tag in VOID | SVG_VOID
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ('script', 'style'):
            self.bodies.setdefault(self.open[-1], []).append(data)
        else:
            self.texts.append(data)

    def handle_comment(self, data):
        raise AssertionError('a comment')


def with_everything(out):
    """Write truth, colour and a legend with hostile names."""
    for i in range(5):
        out.image('semantic/truth', bags.stamp(i), 'camera', np.roll(bags.labels(i), 1), 'mono16')
        shade = np.full((bags.HEIGHT, bags.WIDTH, 3), 40 * i, np.uint8)
        out.image('color/image', bags.stamp(i), 'camera', shade, 'rgb8')
    out.text('semantic/legend', LEGEND.to_yaml(), latched=True)


def run(folder, name='flight', extra=None, methods=None, causal=False, watchers=(), **values):
    """Replay a small recording; return its folder, metrics.json's content and the page."""
    bag = bags.write(folder / name, extra=extra)
    result = replay(bag, folder / 'out', updated(Config(), values), methods, causal,
                    watchers=watchers)
    text = (folder / 'out' / 'report.html').read_text('utf-8')
    return SimpleNamespace(folder=folder / 'out', bag=bag, result=result, text=text,
                           page=Page(text))


@pytest.fixture(scope='module')
def full(tmp_path_factory):
    return run(tmp_path_factory.mktemp('full'), '<i>flight & co', with_everything,
               ('raw2d', 'ema2d', 'majority', 'persem'),
               **{'memory.voxel_size': 0.1, 'frames.map': 'map',
                  'topics.depth': 'depth/image'})


@pytest.fixture(scope='module')
def bare(tmp_path_factory):
    return run(tmp_path_factory.mktemp('bare'), **{'refine.method': 'history'})


@pytest.fixture(scope='module')
def causal(tmp_path_factory):
    return run(tmp_path_factory.mktemp('causal'), extra=with_everything, causal=True)


@pytest.fixture(params=['full', 'bare', 'causal'])
def each(request):
    return request.getfixturevalue(request.param)


def test_every_section_is_there(each):
    assert SECTIONS <= each.page.ids
    links = {a['href'][1:] for tag, a in each.page.tags if tag == 'a'}
    assert links == SECTIONS


def test_nothing_is_loaded(each):
    for tag, attributes in each.page.tags:
        assert tag not in ('link', 'iframe', 'object', 'embed', 'base', 'form')
        assert tag != 'script' or 'src' not in attributes
        for name in ('src', 'href', 'srcset', 'action', 'poster', 'data'):
            assert attributes.get(name, '#').startswith(('#', 'data:image/'))
    policy = [a['content'] for tag, a in each.page.tags if 'http-equiv' in a]
    assert policy == ["default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
                      "script-src 'unsafe-inline'"]
    assert not re.search(r'url\(|@import', ' '.join(each.page.bodies['style']))
    for name in ('page.js', 'viewer.js'):
        assert not re.search(r'https?:|fetch\(|XMLHttpRequest|import\(|innerHTML|eval\(',
                             (ASSETS / name).read_text())


def test_names_are_escaped(full):
    scripts = [a for tag, a in full.page.tags if tag == 'script']
    assert sum('type' not in a for a in scripts) == 3       # page.js, three.js, viewer.js
    assert not any(name.startswith('on') for _, a in full.page.tags for name in a)
    assert not {tag for tag, _ in full.page.tags} & {'u'}
    for name in (*HOSTILE, '<b>hostile</b>', '<u>1</u>', '<i>flight & co'):
        assert ' '.join(name.split()) in full.page.text
    voxels = json.loads(next(body for body in full.page.bodies['script']
                             if body.startswith('{"classes"')))
    assert {item['name'] for item in voxels['classes']} == set(HOSTILE)


def test_numbers_are_those_of_the_metrics(full):
    for row in full.result['methods'].values():
        for key in ('pixel_accuracy', 'miou', 'flicker'):
            assert f'{row[key]:.2f}' in full.page.text
    assert f'floor {full.result["truth_flicker"]:.1f} % (truth)' in full.page.text
    assert f'{full.result["observations"]:,}'.replace(',', '\u202f') in full.page.text


def test_what_is_missing_is_said(full, bare, causal):
    for sentence in ('holds no truth', 'holds no colour', 'colours and names are made up'):
        assert sentence in bare.page.text
        assert sentence not in full.page.text
    assert 'Not measured: with --causal' in causal.page.text
    assert 'as it stood then' in causal.page.text


def test_ignored_ids_are_grey_and_called_so(tmp_path):
    found = run(tmp_path, **{'memory.ignore_labels': [2]})
    body, = (body for body in found.page.bodies['script'] if body.startswith('[{"color"'))
    shown = {item['id']: item for item in json.loads(body)}
    assert shown[2]['name'] == 'ignored' and tuple(shown[2]['color']) == (96, 96, 96)
    assert shown[1]['name'] == 'class 1' and tuple(shown[1]['color']) == Legend().color(1)
    rows = tables.legend_rows(Legend().ignoring((2, 255)), {1: 5}, (1, 2))
    assert [(row['id'], row['name'], row['marks']) for row in rows] == [
        (1, 'class 1', []), (2, 'ignored', [])]
    assert re.search(r'2 ignored', found.page.text)


def test_panels_and_their_number(full, bare):
    def keys(page):
        return [a['class'].split()[1] for tag, a in page.tags if tag == 'figure']
    assert keys(full.page)[:6] == ['color', 'input', 'majority', 'refined', 'truth', 'changed']
    assert keys(bare.page)[:4] == ['input', 'majority', 'refined', 'changed']
    assert len(keys(bare.page)) == 4 * 5


def test_frames_and_reasons_for_dropping(tmp_path):
    bag = bags.write(tmp_path / 'flight', poses=[0.5, 1.5, 2.5])
    result = replay(bag, tmp_path / 'out', Config())
    page = Page((tmp_path / 'out' / 'report.html').read_text())
    assert result['frames']['dropped']
    for reason, n in result['frames']['dropped'].items():
        assert f'{n} {reason}' in page.text


def test_size(full):
    assert len(full.text) < 1_000_000       # of which three.js is 560 kB


@pytest.mark.parametrize('kind', ['no topic', 'no image', 'ignored', 'known'])
def test_no_truth_is_said_only_where_there_is_none(tmp_path, capsys, kind):
    def extra(out):
        for i in range(5) if kind != 'no topic' else ():
            image = bags.labels(i) if kind == 'known' else np.full((12, 16), 255, np.uint16)
            out.image('semantic/truth', bags.stamp(i + 0.5 * (kind == 'no image')), 'camera',
                      image, 'mono16')

    bag = bags.write(tmp_path / 'flight', extra=extra)
    assert main(['replay', str(bag), '--out', str(tmp_path / 'out')]) == 0
    said = {'no topic': 'the recording holds no truth', 'known': '',
            'no image': 'no frame has a true label image of its own',
            'ignored': 'no pixel has depth, a label that counts and a truth that counts'}[kind]
    out, text = capsys.readouterr().out, (tmp_path / 'out' / 'report.html').read_text()
    page = Page(text).text
    assert ('accuracy unknown' in out) == bool(said) and said in out
    assert ('Coarser voxels always flicker less' in page) == bool(said)
    assert said[1:] in page and ('holds no truth' in page) == (kind == 'no topic')


def test_the_command_does_the_same_again(full, bare, monkeypatch):
    for case in (full, bare):
        words = shlex.split(re.search(r'<code>(persem replay .*?)</code>', case.text).group(1)
                            .replace('&lt;', '<').replace('&gt;', '>').replace('&amp;', '&')
                            .replace('&#39;', "'").replace('&#34;', '"'))
        calls = []
        monkeypatch.setattr('persem_ros.replay.replay',
                            lambda *given, **rest: calls.append(given) or case.result)
        assert '--force' in words       # the folder is there
        monkeypatch.setattr(replay_command, 'summary', lambda *given: '')
        assert main(words[1:]) == 0
        (bag,), out, config, methods, causal, *_ = calls[0]
        assert (Path(bag), Path(out)) == (case.bag, case.folder) and not causal
        assert [row['name'] for row in tables.changed_settings(config)] == \
            [name for name in ('memory.voxel_size',) if case is full] + \
            [name for name in ('refine.method',) if case is bare]
        assert set(methods or ['raw2d', 'majority', config.refine.method]) == \
            set(case.result['methods'])


def test_settings_that_differ():
    config = updated(Config(), {'memory.voxel_size': 0.25, 'cameras': ['left', 'right'],
                                'cameras.left.topics.depth': 'd'})
    rows = {row['name']: row for row in tables.changed_settings(config)}
    assert rows['memory.voxel_size']['value'] == '0.25'
    assert rows['memory.voxel_size']['default'] == '0.5'
    assert 'cameras' in rows and rows['cameras.left.topics.depth']['value'] == "'d'"
    assert tables.changed_settings(Config()) == []


def test_gains_point_the_right_way():
    rows = {'raw2d': {'pixel_accuracy': 70.0, 'miou': None, 'flicker': 40.0},
            'persem': {'pixel_accuracy': 80.0, 'miou': None, 'flicker': 45.0}}
    first, second = tables.methods_table(rows)
    assert [cell['gains'] for cell in first['cells']] == [[], [], []]
    assert [cell['gains'] for cell in second['cells']] == [
        [('raw2d', 10.0)], [('raw2d', None)], [('raw2d', -5.0)]]
    assert [cell['best'] for cell in first['cells']] == [False, False, True]
    assert [cell['best'] for cell in second['cells']] == [True, False, False]


@pytest.mark.parametrize('expected, frames', [(5, 5), (1000, 3), (10, 400), (0, 1), (150, 150)])
def test_the_strip_is_spread_evenly(expected, frames):
    kept = strip.Strip(expected)
    for _ in range(frames):
        kept.offer(lambda number: number)
    chosen = kept.chosen()
    assert chosen[0] == 0 and chosen == sorted(set(chosen))
    assert len(chosen) <= strip.FRAMES
    if expected <= 2 * frames:
        assert len(chosen) == min(frames, strip.FRAMES)
        assert np.diff([*chosen, frames]).max(initial=1) <= 2 * frames / len(chosen) + 1


def test_flicker_series_adds_up_to_the_total():
    rng = np.random.default_rng(3)
    compared = np.concatenate([[0], rng.integers(0, 50, 700)])
    compared[5] = 0
    changed = (compared * rng.random(701)).astype(int)
    found = series.FlickerSeries()
    for i, counts in enumerate(zip(changed.cumsum().tolist(), compared.cumsum().tolist())):
        found.add(10 ** 9 * i, {'raw2d': counts, 'truth': (0, 0)})
    lines = found.lines()
    assert lines['frames'] == 3 and list(lines['lines']) == ['raw2d']
    assert len(lines['t']) == len(lines['lines']['raw2d']) <= series.POINTS
    assert lines['t'][-1] == 700.0
    assert lines['lines']['raw2d'][0] == pytest.approx(
        100 * changed[1:4].sum() / compared[1:4].sum())
    assert series.chart(lines)['top'] >= max(lines['lines']['raw2d'])


def test_a_gap_in_the_flicker_breaks_the_line():
    chart = series.chart({'t': [1.0, 2.0, 3.0, 4.0], 'frames': 1,
                          'lines': {'raw2d': [10.0, None, 30.0, 20.0]}})
    assert [len(line.split()) for line in chart['lines']['raw2d']] == [1, 2]
    assert series.chart({'t': [1.0], 'frames': 1, 'lines': {'raw2d': [10.0]}}) is None


def test_indexed_png_is_read_back_by_opencv():
    rng = np.random.default_rng(1)
    palette = rng.integers(0, 256, (256, 3)).astype(np.uint8)
    index = rng.integers(0, 256, (37, 53)).astype(np.uint8)
    content = np.frombuffer(indexed_png(index, palette), np.uint8)
    assert np.array_equal(cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1], palette[index])
    content = np.frombuffer(indexed_png(index % 3, palette[:3], clear=1), np.uint8)
    alpha = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)[..., 3]
    assert np.array_equal(alpha, np.where(index % 3 == 1, 0, 255))


def test_labels_keep_their_colours():
    legend = Legend()
    ids = np.arange(300).repeat(2).reshape(20, 30).astype(np.uint16)
    for labels in (ids % 7, ids):           # few, and more than a palette holds
        uri = strip._label_png(labels, legend)
        content = np.frombuffer(base64.b64decode(uri.partition(',')[2]), np.uint8)
        pixels = cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1]
        few = labels < 255
        assert np.array_equal(pixels[few], legend.colors(labels)[few])


def world(voxels):
    """Return VoxelMemory.voxels() of a map with {voxel: label}, each seen label + 1 times."""
    memory = cw.core_of([])
    for t in range(max(voxels.values()) + 1):
        seen = {voxel: (label, 1.0) for voxel, label in voxels.items() if t <= label}
        memory.add(cw.observations(t, seen))
    return memory.voxels()


def test_the_top_view_shows_the_highest_voxel_with_y_up():
    columns = world({(0, 0, 0): 1, (0, 0, 5): 2, (2, 1, -3): 3, (0, 1, 4): 4})
    top = maps.top_view(columns, 0.5, LEGEND)
    assert (top['width'], top['height']) == (3, 2)
    assert top['x'] == (0.0, 1.5) and top['y'] == (0.0, 1.0) and top['left_out'] == 0
    shown = {layer['key']: layer['pixels'] for layer in top['layers']}
    for pixels in shown.values():
        assert np.array_equal(pixels[..., 3] > 0, [[True, False, True], [True, False, False]])
    near = np.abs(shown['class'][1, 0, :3].astype(int) - LEGEND.color(2))
    assert near.max() <= 0.2 * 255          # but for the relief
    assert not np.array_equal(shown['observations'][1, 0], shown['observations'][0, 2])


def test_stray_columns_do_not_make_the_map_small():
    voxels = {(i, j, 0): 1 for i in range(40) for j in range(40)}
    top = maps.top_view(world({**voxels, (5000, 0, 0): 1}), 0.5, LEGEND)
    assert (top['width'], top['left_out']) == (40, 1)


@pytest.mark.parametrize('extent, length', [(100.0, 20.0), (7.9, 1.0), (0.3, 0.05), (2100, 500)])
def test_scale_bars_are_round(extent, length):
    assert maps.scale_bar(extent) == pytest.approx(length)


def unpacked(view):
    """Return (cells (n, 4), info (n, 4)) as the viewer reads them."""
    data, n = zlib.decompress(base64.b64decode(view['data'])), view['shown']
    return (np.frombuffer(data, np.uint16, 4 * n).reshape(4, n).T,
            np.frombuffer(data, np.uint8, 4 * n, 8 * n).reshape(4, n).T)


def test_the_view_has_every_voxel_that_can_be_seen():
    block = {(i, j, k): 1 for i in range(-2, 2) for j in range(3) for k in range(3)}
    block[3, 5, 7] = 2
    view = cloud3d.packed(world(block), 0.5, LEGEND)
    cells, info = unpacked(view)
    assert (view['shown'], view['voxels'], view['hidden'], view['merged']) == (35, 37, 2, 1)
    found = {tuple(int(x) for x in np.array(view['low']) / 0.5 + cell[:3]):
             view['classes'][cell[3]]['id'] for cell in cells}
    hidden = {(-1, 1, 1), (0, 1, 1)}
    assert found == {voxel: label for voxel, label in block.items() if voxel not in hidden}
    sides = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
    for cell, bits in zip(cells, info[:, 3]):
        voxel = np.rint(np.array(view['low']) / 0.5).astype(int) + cell[:3].astype(int)
        assert bits == sum((tuple((voxel + side).tolist()) not in block) << bit
                           for bit, side in enumerate(sides))
    assert info[:, 0].max() == 255 and json.dumps(view, allow_nan=False)


def test_too_many_voxels_are_drawn_together(monkeypatch):
    monkeypatch.setattr(cloud3d, 'VOXELS', 30)
    flat = {(i, j, 0): 1 for i in range(-4, 4) for j in range(8)}
    flat[1, 1, 0] = 2           # seen more often than its neighbours
    view = cloud3d.packed(world(flat), 0.5, LEGEND)
    assert (view['shown'], view['merged'], view['size']) == (16, 2, 1.0)
    cells, _ = unpacked(view)
    at = {tuple(c[:3].tolist()): view['classes'][c[3]]['id'] for c in cells}
    assert at[2, 0, 0] == 2 and set(at.values()) == {1, 2}


def test_the_viewer_uses_what_was_bundled():
    used = set(re.findall(r'THREE\.(\w+)', (ASSETS / 'viewer.js').read_text()))
    bundled = (ASSETS / 'three.build.sh').read_text()
    assert used and all(re.search(rf'\b{name}\b', bundled) for name in used)
    version = re.search(r'version=(\S+)', bundled).group(1)
    assert f'three.js {version}' in (ASSETS / 'three.min.js').read_text()[:200]


@pytest.mark.parametrize('extra', [with_everything, None])
def test_the_figure(tmp_path, extra, capsys):
    bag = bags.write(tmp_path / 'flight', extra=extra)
    assert main(['replay', str(bag), '--out', str(tmp_path / 'out'),
                 '--figure', str(tmp_path / 'figure.png')]) == 0
    assert str(tmp_path / 'out' / 'report.html') in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / 'figure.png'))
    assert picture.shape[1] == 1600 and np.ptp(picture) > 200
    with pytest.raises(PersemError, match='expected a name that ends in'):
        FigureWatcher('figure.gif')


def test_rerun_is_named_when_it_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'rerun', None)
    bag = bags.write(tmp_path / 'flight')
    status = main(['replay', str(bag), '--out', str(tmp_path / 'out'), '--rerun', 'a.rrd'])
    assert status == 1
    assert "pip install '.[viewer]'" in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('causal', [False, True])
def test_rerun_logs_camera_images_and_map(tmp_path, causal):
    pytest.importorskip('rerun', exc_type=ImportError)
    from persem_ros.outputs.results.rerun_log import RerunLog
    with RerunLog(tmp_path / 'flight.rrd') as log:
        run(tmp_path, extra=with_everything, causal=causal, watchers=[log])
    content = (tmp_path / 'flight.rrd').read_bytes()
    assert content.startswith(b'RRF')
    for entity in ('camera', 'camera/labels', 'camera/image', 'camera/truth', 'camera/refined',
                   'map/000001'):
        assert f'world/{entity}'.encode() in content
    assert (b'world/map/000005' in content) == causal       # all of it anew, at the end


def test_rerun_leaves_nothing_behind_a_failure(tmp_path):
    pytest.importorskip('rerun', exc_type=ImportError)
    from persem_ros.outputs.results.rerun_log import RerunLog
    with pytest.raises(PersemError), RerunLog(tmp_path / 'flight.rrd') as log:
        replay(tmp_path / 'none', tmp_path / 'out', Config(), watchers=[log])
    assert list(tmp_path.iterdir()) == []
