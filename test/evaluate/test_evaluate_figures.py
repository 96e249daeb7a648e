"""Figures and report of an evaluation: all there, readable, escaped, the same every time."""

from html.parser import HTMLParser
from types import SimpleNamespace

import cv2
import numpy as np
from persem_ros import cli
from persem_ros.errors import PersemError
from persem_ros.evaluate import run
from persem_ros.evaluate.show import page, style, summary_figures
from persem_ros.evaluate.work.pictures import Panels
from persem_ros.evaluate.work.task import ALL_METHODS
from persem_ros.settings.config import Config
import pytest
import worlds

pytest.importorskip('matplotlib')
METHODS = ('raw2d', 'ema2d', 'majority', 'persem', 'geometry')
NASTY = ('classes:\n- {id: 1, name: "<b>one</b>"}\n- {id: 3, name: "$x_3$"}\n'
         '- {id: 7, name: "seven & more"}\n- {id: 9, name: mover, dynamic: true}\n')


class Tags(HTMLParser):
    """Counts tags and refuses those that are closed in the wrong order."""

    VOID = ('meta', 'img', 'br', 'i', 'input')

    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.words = [], 0, []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.images += tag == 'img'
        if tag not in self.VOID:
            self.open.append(tag)
        assert all(value.startswith('data:') for name, value in attributes if name == 'src')

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    base = tmp_path_factory.mktemp('figures')
    one = worlds.write(base / 'one', legend=NASTY)
    two = worlds.write(base / '<i>two', seed=1, legend=NASTY)
    run.evaluate([one, two], base / 'out', Config(), METHODS, workers=1)
    return base / 'out'


def test_every_method_has_a_marker_of_its_own():
    assert set(style.STYLES) == set(ALL_METHODS)
    assert len(set(style.STYLES.values())) == len(ALL_METHODS)


def test_all_figures_are_there_and_not_empty(folder):
    names = {path.name for path in (folder / 'figures').iterdir()}
    for name in ('tradeoff', 'differences', 'regions', 'classes', 'panels-one', 'flicker-one',
                 'confusion-one', 'map-<i>two'):
        assert {f'{name}.svg', f'{name}.png'} <= names
    images = {path.name: cv2.imread(str(path)) for path in (folder / 'figures').glob('*.png')}
    assert [name for name, image in images.items()
            if not (image.std() > 5 and min(image.shape[:2]) > 100)] == []


def test_the_best_method_is_at_the_top(folder):
    rows = {m: {'miou': v, 'flicker': f} for m, v, f in (
        ('raw2d', 90, 1), ('majority', 50, 3), ('persem', 51, 9), ('geometry', 60, 4))}
    assert page._best(rows) == 'geometry'
    assert page._best({m: {**row, 'miou': None} for m, row in rows.items()}) == 'majority'
    assert page._best({'raw2d': {'miou': None, 'flicker': None}}) == 'raw2d'


def test_pictures_are_spread_over_the_flight():
    sequence = SimpleNamespace(frames=100, methods=['raw2d'], images=['raw2d'])
    panels = Panels(sequence, SimpleNamespace(classes=np.zeros((2, 0), np.uint8), of=None,
                                              codes=np.zeros(2)))
    panels._differ, panels._kinds = np.array([False, True]), SimpleNamespace(of=np.array([0, 1]))
    panels._panels = lambda *_: {'truth': np.zeros(1)}
    for number in range(100):       # they differ most at 40 to 60
        differing = np.arange(100) < 50 - abs(number - 50)
        panels.offer(None, None, None, differing.astype(np.int32), [])
    assert [int(key.split('/')[1]) for key in panels.arrays()] == [18, 43, 56, 81]


def test_a_far_geometry_leaves_the_others_readable():
    rows = {'majority': {'miou': 59.5, 'flicker': 17.2}, 'persem': {'miou': 60, 'flicker': 17.1}}
    assert summary_figures._heaped({**rows, 'geometry': {'miou': 67, 'flicker': 15.7}})
    assert not summary_figures._heaped({**rows, 'geometry': {'miou': 60.5, 'flicker': 17}})
    assert not summary_figures._heaped(rows)


def test_nothing_differs_from_majority_alone(tmp_path, capsys):
    one = worlds.write(tmp_path / 'one')
    assert cli.main(['evaluate', str(one), '--methods', 'majority', '--workers', '1', '--out',
                     str(tmp_path / 'out')]) == 0
    assert 'Difference from' not in capsys.readouterr().out
    assert not (tmp_path / 'out' / 'figures' / 'differences.svg').exists()
    assert 'map of majority from above' in (tmp_path / 'out' / 'report.html').read_text()


def test_page_is_whole_and_escaped(folder):
    text = (folder / 'report.html').read_text()
    tags = Tags(text)
    assert tags.images == len(list((folder / 'figures').glob('*.svg')))
    assert '<i>two' not in text and '&lt;i&gt;two' in text
    assert 'http' not in text.replace('http-equiv', '')
    assert 'Main results' in ' '.join(tags.words)


def test_the_same_run_draws_the_same(folder, tmp_path):
    with style.look():
        for k in (1, 2):
            figure = style.new_figure(3, 2)
            figure.subplots().plot([0, 1], [0, k * 0 + 1])
            style.save(figure, tmp_path / str(k))
    assert (tmp_path / '1.svg').read_bytes() == (tmp_path / '2.svg').read_bytes()


def test_without_truth_there_is_still_a_page(tmp_path, capsys):
    blind = worlds.write(tmp_path / 'blind', with_truth=False)
    assert cli.main(['evaluate', str(blind), '--out', str(tmp_path / 'out'), '--methods',
                     'raw2d,majority,persem', '--workers', '1']) == 0
    text = (tmp_path / 'out' / 'report.html').read_text()
    Tags(text)
    assert 'accuracy unknown, flicker only' in text
    assert not (tmp_path / 'out' / 'figures' / 'tradeoff.svg').exists()
    assert (tmp_path / 'out' / 'figures' / 'map-blind.png').exists()


@pytest.mark.parametrize('method', ['raw2d', 'persem'])
def test_one_method_and_one_frame(tmp_path, method):
    short = worlds.write(tmp_path / 'short', frames=1)
    run.evaluate([short], tmp_path / method, Config(), (method,), workers=1)
    Tags((tmp_path / method / 'report.html').read_text())


def test_missing_matplotlib_is_said(monkeypatch):
    import sys
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(PersemError, match=r"pip install '\.\[evaluate\]'.*--no-figures"):
        page.check()
