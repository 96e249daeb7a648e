"""Figures and report of an evaluation: all there, readable, escaped, the same every time."""

from html.parser import HTMLParser

import cv2
from persem_ros import cli
from persem_ros.errors import PersemError
from persem_ros.evaluate import run
from persem_ros.evaluate.show import page, style
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
