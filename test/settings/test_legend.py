"""Legends: reading, refusing, colouring."""

import logging

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend, shipped_legends
from persem_ros.settings.palette import made_up_colors
import pytest

SMALL = """
title: small
classes:
- {id: 1, name: road, color: [10, 20, 30], group: flat}
- {id: 4, name: path, color: '#0A141F', group: flat}
- {id: 9, name: car, color: [200, 0, 0], dynamic: true}
- {id: 255, name: nothing, ignored: true}
"""


def test_shipped_names():
    assert {'town', 'uavscenes', 'forest', 'cityscapes'} <= set(shipped_legends())


@pytest.mark.parametrize('name', ['town', 'uavscenes', 'forest', 'cityscapes'])
def test_shipped_round_trip(name):
    legend = load_legend(name)
    again = Legend.from_yaml(legend.to_yaml())
    assert again == legend and again.title == name
    assert len(set(legend.ids)) == len(legend.classes)
    colors = [item.color for item in legend.classes if not item.ignored]
    assert len(set(colors)) == len(colors)


def test_uavscenes_groups_and_flags():
    legend = load_legend('uavscenes')
    assert legend.groups() == {
        'building': (1, 17), 'road': (2, 3, 10, 18, 19), 'water': (4, 5),
        'structure': (6, 9, 11, 15, 16), 'vegetation': (13, 14), 'vehicle': (20, 24)}
    assert legend.dynamic == (20, 24)
    assert legend.ignored == (0, 7, 8, 12, 21, 22, 23, 25, 255)


def test_costs_and_codes():
    legend = Legend.from_yaml('classes:\n- {id: 1, name: a, cost: 0, las: 11}\n- {id: 2, name: b}')
    assert (legend.numbers('cost'), legend.numbers('las')) == ({1: 0}, {1: 11})
    assert Legend.from_yaml(legend.to_yaml()) == legend


@pytest.mark.parametrize('name', ['town', 'uavscenes', 'forest', 'cityscapes'])
def test_shipped_legends_have_costs_and_codes(name):
    legend = load_legend(name)
    wanted = {item.id for item in legend.classes if not item.ignored} - (
        {10} if name == 'cityscapes' else set())        # its sky is a class
    assert set(legend.numbers('cost')) == set(legend.numbers('las')) == wanted
    own = [code for code in legend.numbers('las').values() if code >= 64]
    assert len(own) == len(set(own))


@pytest.mark.parametrize(('key', 'value'), [
    ('cost', -1), ('cost', 101), ('cost', 0.5), ('cost', 'true'), ('las', 256), ('las', 'road')])
def test_costs_and_codes_out_of_range(key, value):
    with pytest.raises(PersemError, match=f'{key}: expected a whole number 0 .. (100|255), got'):
        Legend.from_yaml(f'classes:\n- {{id: 1, name: a, {key}: {value}}}')


def test_queries():
    legend = Legend.from_yaml(SMALL)
    assert legend.name(4) == 'path' and legend.name(77) == 'class 77'
    assert legend.groups() == {'flat': (1, 4), 'car': (9,)}
    assert legend.ignored == (255,) and legend.dynamic == (9,)
    assert legend.color(4) == (10, 20, 31)


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.int16, np.int32, np.int64])
def test_colors_of_images(dtype):
    legend = Legend.from_yaml(SMALL)
    image = np.array([[1, 4, 9], [9, 1, 1]], dtype)
    colors = legend.colors(image)
    assert colors.shape == (2, 3, 3) and colors.dtype == np.uint8
    assert colors[0].tolist() == [[10, 20, 30], [10, 20, 31], [200, 0, 0]]
    assert colors.flags.c_contiguous


def test_ids_out_of_range_are_black():
    colors = Legend.from_yaml(SMALL).colors(np.array([-1, -7, 65535, 70000], np.int32))
    assert not colors.any()


def test_unknown_ids_warn_once_and_differ(caplog):
    legend = Legend.from_yaml(SMALL)
    with caplog.at_level(logging.WARNING):
        first = legend.colors(np.array([2, 3, 5, 6, 7, 8, 1], np.uint16))
        second = Legend.from_yaml(SMALL.replace('car', 'bus')).colors(np.array([1], np.uint16))
        legend.colors(np.array([2, 11], np.uint16))
    assert len(np.unique(first, axis=0)) == 7
    assert second.tolist() == [[10, 20, 30]]
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == 1 and '2, 3, 5, 6, 7, 8' in messages[0]


@pytest.mark.parametrize('text', ['', SMALL])
def test_ids_that_the_settings_ignore_are_grey_and_called_so(caplog, text):
    legend = (Legend.from_yaml(text) if text else Legend()).ignoring((0, 4, 65535, -1, 65600))
    with caplog.at_level(logging.WARNING):
        first = legend.colors(np.array([0, 65535], np.uint16)).tolist()
    assert first == [[96, 96, 96], [0, 0, 0]] and not caplog.records
    assert legend.name(0) == legend.name(65535) == 'ignored'
    # What the legend has a name for keeps it.
    assert legend.name(4) == ('path' if text else 'ignored')
    assert legend.color(4) == ((10, 20, 31) if text else (96, 96, 96))
    assert legend.name(2) == 'class 2' and legend.color(2) == Legend().color(2)
    assert legend.to_yaml() == (Legend.from_yaml(text).to_yaml() if text else '')


def test_empty_legend_never_warns(caplog):
    with caplog.at_level(logging.WARNING):
        colors = Legend().colors(np.arange(6, dtype=np.uint8))
    assert not caplog.records and len(np.unique(colors, axis=0)) == 6


def test_made_up_colors_of_the_first_ids_are_far_apart():
    colors = made_up_colors(np.arange(40)).astype(int)
    distance = np.abs(colors[:, None] - colors[None]).sum(-1) + 1000 * np.eye(40, dtype=int)
    assert distance.min() > 20


def test_names_survive_yaml():
    strange = Legend.from_yaml('classes:\n- {id: 3, name: "<b>\\n\\"no\\": #", color: [1, 2, 3]}')
    assert strange.name(3) == '<b>\n"no": #'
    assert Legend.from_yaml(strange.to_yaml()) == strange


@pytest.mark.parametrize('text, expected', [
    ('classes: [', 'not YAML'),
    ('- 1', "a list 'classes'"),
    ('classes: []', "a list 'classes'"),
    ('classes: [7]', 'classes[0]: expected {id'),
    ('classes: [{id: 7, name: road, cost: 900}]', "classes[0] ('road'): cost: expected"),
    ('classes: [{id: 7, nam: road}]', 'classes[0] (7): unknown key'),
    ('classes:\n- {id: 1, name: a}\n- {id: 1, name: b}', "id 1 is given twice, to 'a' and 'b'"),
    ('classes:\n- {name: a}', 'id: expected an integer'),
    ('classes:\n- {id: 70000, name: a}', 'id: expected an integer'),
    ('classes:\n- {id: true, name: a}', 'id: expected an integer'),
    ('classes:\n- {id: 1, name: no}', 'name: expected text'),
    ('classes:\n- {id: 1, name: a, colour: [1, 2, 3]}', "did you mean 'color'?"),
    ('classes:\n- {id: 1, name: a, color: [1, 2]}', 'color: expected'),
    ('classes:\n- {id: 1, name: a, color: [1, 2, 256]}', 'color: expected'),
    ('classes:\n- {id: 1, name: a, color: "#GG0000"}', 'color: expected'),
    ('classes:\n- {id: 1, name: a, color: "#12  34"}', 'color: expected'),     # two of three
    ('classes:\n- {id: 1, name: a, dynamic: maybe}', 'dynamic: expected true or false'),
    ('classes:\n- {id: 65535, name: a}', 'expected ignored: true'),
    ('[' * 5000, 'not YAML'),
])
def test_refusals_are_one_line(text, expected):
    with pytest.raises(PersemError) as caught:
        Legend.from_yaml(text, 'file.yaml')
    message = str(caught.value)
    assert expected in message and message.startswith('file.yaml: ') and '\n' not in message


def test_unknown_name_names_the_nearest():
    with pytest.raises(PersemError, match="did you mean 'uavscenes'"):
        load_legend('uavscene')


def test_file(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(SMALL, encoding='utf-8')
    assert load_legend(path) == load_legend(str(path)) == Legend.from_yaml(SMALL)
    path.write_bytes(b'\xff\xfe\x00')
    with pytest.raises(PersemError, match='cannot be read as text'):
        load_legend(path)
