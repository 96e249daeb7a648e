"""How names that came with the ids differ from a given legend is said in one line."""

from collections import Counter
import logging
from types import SimpleNamespace

import bags
from persem_ros.inputs.decode.legends import table
from persem_ros.inputs.intake import LEGEND
from persem_ros.inputs.live import LiveIntake
from persem_ros.inputs.names import Names
from persem_ros.inputs.recording.recording import Recording
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

MOVED = ("ids follow their names, as labels.legend has them: 'tree' 1 is 7, 'road' 7 is 0; "
         "without a name in labels.legend: 7 'road'; in labels.legend only: 1 'house'; to keep "
         'ids as they are: --set labels.topic=none')


def legend(**names):
    """Return a legend of {name: id} as YAML text."""
    return 'classes:\n' + ''.join(f'- {{id: {i}, name: {n}}}\n' for n, i in names.items())


def said(given, theirs, **settings):
    """Return what is said of two legends {name: id}."""
    config = updated(Config(), {'labels.legend': 'FILE', **settings})
    names = Names(config, Legend.from_yaml(legend(**given)))
    names.add(table(SimpleNamespace(data=legend(**theirs))))
    names.add(table(SimpleNamespace(data=legend(later=3))))     # no part of it
    return names.difference()


def test_ids_that_move_and_names_without_a_partner_are_said():
    assert said({'tree': 7, 'house': 1}, {'tree': 1, 'road': 7}) == MOVED


def test_names_that_differ_alone_are_said():
    assert said({'tree': 1, 'street': 2, 'house': 9}, {'tree': 1, 'road': 2, 'car': 5}) == (
        "labels.legend and the recording name classes otherwise, ids stay as they are: 2 'road' "
        "is 'street', 5 'car' has no name; in labels.legend only: 2 'street', 9 'house'")


def test_ids_of_settings_that_are_other_classes_now_are_said():
    given, theirs = {'sky': 10, 'vehicle': 25}, {'vehicle': 10, 'sky': 3}
    told = said(given, theirs, **{'memory.dynamic_labels': (10, 4)})
    assert told.endswith("labels.topic=none; memory.dynamic_labels 10 is 'sky' now; 'vehicle' is "
                         '25: --set memory.dynamic_labels=25,4')
    told = said(given, theirs, **{'memory.ignore_labels': (10, 65535)})
    assert told.endswith("memory.ignore_labels 10 is 'sky' now, which is left out beside "
                         "'vehicle'; 'vehicle' is 25: --set memory.ignore_labels=25,65535")


@pytest.mark.parametrize('setting, ids', [('dynamic_labels', (25,)), ('dynamic_labels', (-1,)),
                                          ('ignore_labels', (255, 65535)),
                                          ('ignore_labels', (25, 65535))])
def test_ids_of_settings_that_fit_are_not_spoken_of(setting, ids):
    told = said({'sky': 10, 'vehicle': 25}, {'vehicle': 10, 'sky': 3},
                **{f'memory.{setting}': ids})
    assert 'ids follow' in told and 'memory.' not in told


@pytest.mark.parametrize('given, theirs', [
    ({'tree': 1, 'road': 2}, {'tree': 1, 'road': 2}), ({'tree': 1, 'road': 2}, {'tree': 1}),
    ({'tree': 1}, {'tree': 1, 'nothing': 255})])
def test_names_that_fit_are_not_spoken_of(given, theirs):
    assert said(given, theirs) == ''


def test_of_many_names_a_few_are_said():
    told = said({f'a{i}': i for i in range(20)}, {f'a{i}': i + 1 for i in range(20)})
    assert "'a5' 6 is 5 and 14 more; to keep" in told and 'a6' not in told


@pytest.fixture
def file(tmp_path):
    """Return a file with the legend that is given."""
    (tmp_path / 'given.yaml').write_text(legend(tree=7, house=1))
    return str(tmp_path / 'given.yaml')


def write(path):
    """Write a recording whose ids 1 and 7 are called otherwise."""
    return bags.write(path, extra=lambda out: out.text('semantic/legend', legend(tree=1, road=7),
                                                       latched=True))


def test_a_recording_says_it_and_keeps_its_ids_where_it_is_asked_to(tmp_path, file):
    path = write(tmp_path / 'bag')
    chosen = updated(Config(), {'labels.legend': file})
    with Recording(path, chosen) as recording:
        assert recording.notes == [MOVED] and recording.names.changes
    with Recording(path, updated(chosen, {'labels.topic': 'none'})) as recording:
        list(recording.frames())
        assert recording.notes == [] and not recording.names.changes
        assert recording.legend.name(7) == 'tree'


def test_a_node_says_it_once(file, caplog):
    config = updated(Config(), {'labels.legend': file})
    with open(file, encoding='utf-8') as content:
        given = Legend.from_yaml(content.read())
    intake = LiveIntake(config, lambda data, kind: data, Counter(), lambda: None)
    intake.names = Names(config, given)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            intake.take(LEGEND, None, '', 0, SimpleNamespace(data=legend(tree=1, road=7)))
    assert caplog.messages == [MOVED]
