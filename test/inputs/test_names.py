"""Names are identity: tables of class names of all forms, changing, and who gets which id."""

from types import SimpleNamespace

import numpy as np
from persem_ros.inputs.decode.legends import table
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.names import Names, renamed
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest


def text(data):
    """Return a String."""
    return SimpleNamespace(data=data)


def info(stamp, **names):
    """Return a LabelInfo of {name: id}."""
    at = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=stamp), frame_id='')
    return SimpleNamespace(header=at, threshold=0.0, class_map=[
        SimpleNamespace(class_id=i, class_name=name) for name, i in names.items()])


def json_of(**names):
    """Return what Isaac Sim publishes."""
    return text('{' + ', '.join(f'"{i}": {{"class": "{n}"}}' for n, i in names.items()) + '}')


def ids(names, image, stamp=0, arrived=0):
    """Return the map's ids of an image's."""
    return renamed(np.array(image, np.int32), names.at(stamp, arrived)[1]).tolist()


@pytest.mark.parametrize('msg, stamp, names', [
    (info(5, tree=3, road=1), 5, {3: 'tree', 1: 'road'}),
    (info(5, tree=3, unlabelled=65535), 5, {3: 'tree'}),
    (text('{"0": {"class": "BACKGROUND"}, "3": {"class": "tree"}, '
          '"time_stamp": {"sec": 1, "nanosec": 7}}'), 10**9 + 7, {0: 'BACKGROUND', 3: 'tree'}),
    (text('{"3": "tree"}'), None, {3: 'tree'}),
    (text('{"(255, 0, 9, 255)": {"class": "tree"}}'), None, {0: 'tree'}),
    (text('{"3": {"prim": "tree"}}'), None, {3: 'tree'}),
    (text('classes:\n- {id: 3, name: tree}\n'), None, {3: 'tree'}),
    (text('{"classes": [{"id": 3, "name": "tree"}]}'), None, {3: 'tree'})])
def test_tables_of_every_form(msg, stamp, names):
    found = table(msg)
    assert found.stamp == stamp
    assert {c.id: c.name for c in found.legend.classes} == names
    if 'BACKGROUND' in names.values():
        assert found.legend.ignored == (0,)


def test_isaac_sims_colours_are_those_of_its_images():
    assert table(text('{"(255, 0, 9, 255)": {"class": "tree"}}')).legend.color(0) == (255, 0, 9)


@pytest.mark.parametrize('data', [
    '', 'no', '{"a": {"class": "tree"}}', '{"1": 7}', '{"1"', '[1, 2]', 'classes: {}', '{}',
    '{"1": {"class": ""}}', '{' * 5000, '{"' + '9' * 5000 + '": "tree"}',
    '{"(1, ' + '9' * 5000 + ', 3)": "tree"}', '{"1": ' + '[' * 100_000, '{"1": ' + '9' * 5000])
def test_what_is_no_table_is_a_bad_message(data):
    with pytest.raises(BadMessage, match='expected vision_msgs/LabelInfo'):
        table(text(data))


def test_a_table_that_stays_changes_nothing():
    names = Names(Config())
    for stamp in range(3):
        names.add(table(info(stamp, tree=5, road=9)))
    assert not names.changes and ids(names, [5, 9, 7, -1]) == [5, 9, 7, -1]
    assert names.legend.name(5) == 'tree'


def test_a_name_keeps_its_id_when_its_number_changes():
    names = Names(updated(Config(), {'memory.dynamic_labels': [0]}))
    names.add(table(info(100, tree=1, road=2)))
    names.add(table(info(200, road=1, tree=2, car=7)))
    assert ids(names, [1, 2, 8], 50) == ids(names, [1, 2, 8], 199) == [1, 2, 8]
    # 0 is dynamic, 1 and 2 are used: the new name gets 3; 255 stays what it is.
    assert ids(names, [1, 2, 7, 255, 65535, -4, 70000, 8], 200) == \
        [2, 1, 3, 255, 65535, -1, -1, 8]
    assert [names.legend.name(i) for i in (1, 2, 3)] == ['tree', 'road', 'car']


def test_texts_hold_from_their_arrival_and_the_first_for_what_was_before():
    names = Names(Config())
    names.add(table(json_of(tree=1, road=2)))
    names.add(table(json_of(tree=1, road=2)))       # the same: no other table
    names.add(table(json_of(tree=2, road=1)))
    assert names.arrived == 2
    assert [ids(names, [1, 2], arrived=n) for n in (0, 1, 2)] == [[1, 2], [1, 2], [2, 1]]


def test_the_given_legend_owns_the_ids():
    given = Legend.from_yaml('classes:\n- {id: 7, name: tree}\n- {id: 1, name: house}\n')
    names = Names(Config(), given)
    names.add(table(info(0, tree=1, road=7)))
    assert ids(names, [1, 7]) == [7, 0] and names.legend.name(0) == 'road'
    called = Names(Config(), given)     # the same ids by other names: as before there were names
    called.add(table(info(0, oak=7, villa=1)))
    assert ids(called, [7, 1]) == [7, 1] and called.legend == given


def test_an_unnamed_id_that_is_anothers_is_no_label():
    names = Names(Config())
    names.add(table(info(0, tree=1, road=2)))
    names.add(table(info(1, tree=3)))
    assert ids(names, [1, 2, 3, 4], 1) == [-1, -1, 1, 4]


def test_names_without_end_leave_the_last_ones_without_a_number():
    names = Names(Config())
    for part in range(3):       # each table has names of its own
        names.add(table(SimpleNamespace(data='{' + ', '.join(
            f'"{i}": "{part} {i}"' for i in range(30_000)) + '}')))
    assert len(names.legend.classes) == 65535
    assert ids(names, [29_999, 0], arrived=1) == [29_999, 0]
    assert ids(names, [0, 29_999], arrived=3) == [59_999, -1]


def test_a_time_that_is_none_is_not_taken_for_one():
    assert table(text('{"3": "tree", "time_stamp": {"sec": 1e9}}')).stamp is None
    assert table(text('{"3": "tree", "time_stamp": {"sec": ' + '9' * 30 + '}}')).stamp is None
