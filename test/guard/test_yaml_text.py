"""YAML that means harm: bounded before anything is built, and no tag brings it down."""

from hypothesis import given, strategies as st
from persem_ros.errors import PersemError
from persem_ros.guard import yaml_text
from persem_ros.guard.yaml_text import Bounds, load, RECORDING, SETTINGS
from persem_ros.settings import config_file
from persem_ros.settings.legend import Legend
import pytest

BOMB = 'a: &a [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'{c}: &{c} [{", ".join(["*" + chr(ord(c) - 1)] * 9)}]\n' for c in 'bcdefghi')
HARM = {
    'aliases': (BOMB, 'an alias (*a) in line 2'),
    'recursion': ('&a [*a]', 'an alias'),
    'depth': ('[' * 5000, 'more than 32 levels'),
    'values': ('[' + 'x, ' * 30_000 + ']', 'more than 20000 values'),
    'size': ('x' * (1 << 20) + 'x', 'longer than 1048576 characters'),
    'one value': ('a: ' + 'x' * 20_000, 'a value of more than 10000 characters in line 1'),
    'integer': ('a: ' + '9' * 6000, ''), 'tag int': ('!!int ""', ''), 'tag bool': ('!!bool x', ''),
    'tag time': ('!!timestamp x', ''), 'object': ('!!python/object:os.system {}', ''),
    'float': ('!!float x', ''), 'set': ('!!set [a]', ''), 'date': ('2001-13-45', ''),
    'text': ('a: "\x00"', ''), 'unhashable': ('? [a]\n: b\n? {c: d}\n: e\n', '')}


@pytest.mark.parametrize('kind', HARM)
def test_harm_is_refused_in_one_short_sentence(kind):
    text, why = HARM[kind]
    for read in (lambda: load(text, 'file', SETTINGS), lambda: Legend.from_yaml(text, 'file'),
                 lambda: config_file.from_text(text, 'file')):
        try:
            read()
        except PersemError as error:
            assert len(str(error)) < 600 and str(error).isprintable() and 'file' in str(error)
            refusal = str(error)
    if why:
        with pytest.raises(PersemError) as caught:
            load(text, 'file', SETTINGS)
        assert why in str(caught.value)
    else:
        assert kind == 'integer' or refusal


def test_aliases_of_recordings_count_as_what_they_stand_for():
    # as rosbags writes equal QoS profiles
    assert load('a: &x [1, 2]\nb: *x\nc: *x\n', 'file', RECORDING)['c'] == [1, 2]
    for text in (BOMB, '&a [*a]', 'a: &a {b: *a}'):
        with pytest.raises(PersemError):
            load(text, 'file', RECORDING)


@given(st.text(max_size=300))
def test_any_text_is_read_or_refused(text):
    for read in (Legend.from_yaml, lambda t: config_file.from_text(t, 'file'),
                 lambda t: load(t, 'file', Bounds(200, 50, 5, 20))):
        try:
            read(text)
        except PersemError as error:
            assert str(error).isprintable()


@given(st.sampled_from(['memory.voxel_size', 'memory.ignore_labels', 'refine.method']),
       st.text(max_size=40))
def test_any_value_of_a_setting_is_taken_or_refused(name, value):
    try:
        config_file.from_args(set_items=[f'{name}={value}'])
    except PersemError as error:
        assert len(str(error)) < 1500


def test_a_legend_of_all_classes_is_within_bounds_and_takes_seconds():
    def text(n):
        return 'classes:\n' + ''.join(
            f'- {{id: {i}, name: class number {i}, color: [1, 2, 3], group: group of {i}, '
            f'dynamic: false, ignored: false}}\n' for i in range(n))

    rows, nodes = 10, yaml_text.LEGEND.nodes / 65535
    yaml_text.check(text(rows), yaml_text.LEGEND._replace(
        size=rows * yaml_text.LEGEND.size // 65535, nodes=int(rows * nodes)))
    legend = Legend.from_yaml('classes:\n' + ''.join(
        f'- {{id: {i}, name: class number {i}}}\n' for i in range(65534 - 2000, 65535)))
    assert Legend.from_yaml(legend.to_yaml()) == legend and len(legend.ids) == 2001


def test_no_message_writes_out_a_long_value():
    text = 'classes: [{id: ' + '[' + 'x, ' * 100_000 + '], name: a}]'
    with pytest.raises(PersemError) as caught:
        Legend.from_yaml(text)
    assert len(str(caught.value)) < 400


def test_bounds_are_those_of_what_people_write():
    load('a: [' + 'x, ' * 10_000 + ']', 'file', SETTINGS)
    assert yaml_text.LEGEND.nodes > 65536 * 13      # id, name, colour and three of it, group, …
