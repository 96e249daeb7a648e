"""Findings: one sentence, and the settings to type as command line and node take them."""

import bags
from persem_ros.errors import PersemError
from persem_ros.preflight import look as look_room
from persem_ros.preflight.findings import Finding, NOTE, of_severity, REFUSE, Remedy, WARN
from persem_ros.preflight.look import look, opened, takes_of
from persem_ros.preflight.sample import Sample
from persem_ros.settings.config import Config
import pytest

FINDING = Finding(REFUSE, 'it is this or that', (
    Remedy({'pose.child_frame': 'base_link'}, 'if it is this'),
    Remedy({'sync.tolerance': '0.1', 'topics.pose': '/a b'})))


def test_flags_are_those_of_the_command_line_and_of_the_node():
    assert FINDING.text() == (
        'it is this or that: --set pose.child_frame=base_link if it is this, or --set '
        "sync.tolerance=0.1 --set 'topics.pose=/a b'")
    assert '-p pose.child_frame:=base_link if it is this' in FINDING.text(live=True)
    assert Finding(WARN, 'as it is').text() == 'as it is'


def test_a_node_names_what_a_replay_takes():
    taken = Finding(NOTE, 'the root is odom', takes={'frames.map': 'odom'})
    assert taken.text() == 'the root is odom'
    assert taken.text(live=True) == 'the root is odom: -p frames.map:=odom'


@pytest.mark.parametrize('live', [False, True])
def test_what_is_taken_holds_for_the_checks_after_it(monkeypatch, live):
    seen = []

    def first(sample):
        yield Finding(NOTE, 'a', takes={'frames.map': 'odom'})
        yield Finding(NOTE, 'a', takes={'frames.map': 'odom'})

    def second(sample):
        seen.append(sample.config.frames.map)
        yield Finding(WARN, 'b')

    monkeypatch.setattr(look_room, 'CHECKS', (first, second))
    found = look(Sample(Config(), [], live))
    assert [f.sentence for f in found] == ['a', 'b'] and seen == ['map' if live else 'odom']
    assert takes_of(found) == {'frames.map': 'odom'} and len(of_severity(found, WARN)) == 1


def test_a_recording_is_refused_with_every_reason(monkeypatch, tmp_path, caplog):
    def warned(sample):
        yield Finding(WARN, 'may be', takes={'frames.map': 'odom'})

    path = bags.write(tmp_path / 'bag')
    monkeypatch.setattr(look_room, 'CHECKS', (warned,))
    with opened(path, Config()) as recording:
        assert recording.config.frames.map == 'odom' and 'may be' in caplog.text
        assert len(list(recording.frames())) == 5
    monkeypatch.setattr(look_room, 'CHECKS', (warned, lambda sample: iter((FINDING,) * 2)))
    with pytest.raises(PersemError, match='it is this or that: --set pose.child_frame=base_link'):
        opened(path, Config())
