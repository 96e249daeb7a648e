"""What the node says when no frame is complete any more, without ROS."""

import logging
from types import SimpleNamespace

from persem_ros.ros import watchdog
from persem_ros.ros.counters import Statistics
from persem_ros.ros.watchdog import MISSING, Watchdog
import pytest

ENDED = 'nothing comes any more'


class World:
    """A watchdog whose clock is set by hand, topics whose messages come at hand."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(watchdog, 'time', SimpleNamespace(monotonic=lambda: self.now))
        self.topics = {role: SimpleNamespace(
            role=role, listened=f'/{role}', came=None, count=0, stamp=None, lost=0,
            reliability='reliable') for role in ('labels', 'depth', 'pose')}
        self.statistics = Statistics()
        self.dog = Watchdog(SimpleNamespace(
            needed=list(self.topics.values()), verdict=lambda one: '',
            publishers=lambda one: []), self.statistics)
        self.states = []

    def pass_time(self, seconds, topics, mapped=False):
        """Let messages of some topics come at 10 Hz, mapped or not; look once a second."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            for role in topics:
                self.topics[role].came = self.now
                self.topics[role].count += 1
            if mapped:
                self.statistics.frames += 1
                self.statistics.last_frame = self.now
            if round(self.now * 10) % 10 == 0:
                self.dog.look()
                self.states += [self.dog.state] if self.states[-1:] != [self.dog.state] else []


@pytest.mark.parametrize('longer', [0.0, 1.0, 2.0])
def test_the_end_of_a_recording_whose_poses_run_on_is_an_end(monkeypatch, caplog, longer):
    world = World(monkeypatch)
    world.pass_time(10, ('labels', 'depth', 'pose'), mapped=True)
    with caplog.at_level(logging.WARNING, 'persem_ros'):
        world.pass_time(longer, ('pose',))
        world.pass_time(20, ())
    assert world.states == ['', ENDED]
    [record] = caplog.records
    assert record.getMessage().startswith('nothing comes any more: 100 frames were mapped, for ')


@pytest.mark.parametrize('topics', [('pose',), ('depth', 'pose'), ('labels', 'pose')])
def test_a_topic_that_is_missing_while_others_go_on_is_no_end(monkeypatch, topics):
    world = World(monkeypatch)
    world.pass_time(10, ('labels', 'depth', 'pose'), mapped=True)
    world.pass_time(20, topics)
    assert world.states == ['', MISSING]


def test_labels_that_were_not_mapped_before_the_end_are_said_first(monkeypatch):
    world = World(monkeypatch)
    world.pass_time(10, ('labels', 'depth', 'pose'), mapped=True)
    world.pass_time(2, ('labels', 'depth', 'pose'))
    world.pass_time(20, ())
    assert world.states == ['', MISSING, ENDED]
