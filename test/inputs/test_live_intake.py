"""What only a node meets: clocks that differ, lost and late partners, too many frames."""

from collections import Counter

import bags
import numpy as np
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.live import BEHIND, LiveIntake
from persem_ros.inputs.sync.backlog import Backlog
from persem_ros.inputs.sync.clocks import ANOTHER_CLOCK, Clocks
from persem_ros.inputs.sync.pairing import KEEP, NO_DEPTH
from persem_ros.inputs.sync.partners import Partners
from persem_ros.inputs.sync.poses import OTHER_FRAME, PoseBuffer
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, Sync, updated
import pytest
from rosbags.typesys import get_typestore, Stores

S = 1_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageFactory(STORE.types)


class Live:
    """A way in whose clocks are set by hand: now in seconds since bags.START."""

    def __init__(self, offset=0.0, parent='map', **settings):
        self.config = updated(Config(), {'memory.voxel_size': 0.1, **settings})
        self.dropped = Counter()
        self.now = 0.0
        self.offset, self.parent = offset, parent
        self.intake = LiveIntake(self.config, Decoder(), self.dropped, lambda: None,
                                 lambda: self.steady + bags.START, lambda: self.steady)
        self.buffer = PoseBuffer(self.config, strict=True)
        self.station = self.intake.add_camera('', self.buffer)
        self.frames = []
        self.take('camera_info', 'sensor_msgs/msg/CameraInfo',
                  MAKE.camera_info(0, 'camera', bags.WIDTH, bags.HEIGHT, bags.K), self.station)

    @property
    def steady(self):
        return round(self.now * S)

    def take(self, role, kind, message, taker):
        data = bytes(STORE.serialize_cdr(message, kind))
        self.intake.take(role, taker, kind, self.steady, data)
        self.frames += self.intake.leaving(self.steady)

    def pose(self, t):
        stamp = bags.START + round((t + self.offset) * S)
        name, message = MAKE.pose(stamp, self.parent, np.eye(4))
        self.take('pose', name, message, self.buffer)

    def depth(self, t):
        self.take('depth', 'sensor_msgs/msg/Image', MAKE.image(
            bags.START + round(t * S), 'camera', bags.depth(0), '32FC1'), self.station)

    def labels(self, t):
        self.take('labels', 'sensor_msgs/msg/Image', MAKE.image(
            bags.START + round(t * S), 'camera', bags.labels(0), 'mono16'), self.station)

    def fly(self, seconds, depth=True):
        """Let images at 10 Hz and poses at 50 Hz come as they are stamped."""
        first = round(self.now * 50)
        for i in range(first, first + round(seconds * 50)):
            self.now = i / 50
            self.pose(i / 50)
            if i % 5 == 0:
                self.depth(i / 50)
                self.labels(i / 50)


def test_poses_of_a_clock_ahead_are_refused_from_the_first_frame_on():
    live = Live(offset=5.0)
    live.now = 0.0
    for i in range(400):                    # the localisation runs before the camera
        live.now = i / 50
        live.pose(i / 50)
    live.fly(3)
    assert not live.frames and live.dropped[ANOTHER_CLOCK] >= 28
    assert '5.0 s newer' in live.intake.examples[ANOTHER_CLOCK]
    assert 'pose.max_ahead' in live.intake.examples[ANOTHER_CLOCK]


@pytest.mark.parametrize('offset, used', [(0.3, True), (1.2, True), (2.0, False)])
def test_how_far_poses_may_be_ahead(offset, used):
    live = Live(offset=offset)
    live.fly(6)
    assert bool(live.frames) == used
    assert (ANOTHER_CLOCK in live.dropped) != used


def test_poses_of_a_clock_behind_are_told_with_their_distance():
    live = Live(offset=-5.0)
    live.fly(4)
    live.intake.explain()
    assert not live.frames and 's older than the image; do the clocks differ' in \
        live.intake.examples['no pose']


@pytest.mark.parametrize('stamp, newest, clock, ahead, late', [
    (100 * S, 100 * S, 100 * S, 0, 0), (100 * S, 101 * S, 100 * S, 0, 0),
    (100 * S, 103 * S, 100 * S, 3 * S, 0),      # the image tells the node's time, the pose not
    (100 * S, 103 * S, 103 * S, 0, 3 * S),      # the image took long
    (100 * S, 103 * S, 900 * S, 0, 0),          # nobody can tell, yet
    (100 * S, None, 100 * S, 0, 0)])
def test_which_clock_is_off(stamp, newest, clock, ahead, late):
    clocks = Clocks(1.5)
    clocks.image(stamp, newest, clock, 0)
    assert (clocks.ahead, clocks.late) == (ahead, late)


def test_a_distance_that_no_clock_explains_has_to_last():
    clocks = Clocks(1.5)
    for i in range(20):
        clocks.image(i * S // 10, i * S // 10 + 4 * S, 900 * S, i * S // 10)
    assert clocks.ahead == 0
    for i in range(20, 30):
        clocks.image(i * S // 10, i * S // 10 + 4 * S, 900 * S, i * S // 10)
    assert clocks.ahead == 4 * S
    clocks.image(3 * S, 3 * S, 900 * S, 3 * S)
    assert clocks.ahead == 0


def test_poses_in_another_frame_wait_for_a_chain_and_are_refused_without():
    live = Live(parent='odom')
    live.fly(3)
    assert not live.frames and live.dropped[OTHER_FRAME]
    sentence = live.intake.examples[OTHER_FRAME]
    assert "'odom'" in sentence and '--set frames.map=odom' in sentence
    shift = np.eye(4)
    shift[1, 3] = 100.0
    for i in range(140, 300):
        live.buffer.add_tf(bags.START + i * S // 50, shift, 'map', 'odom')
    live.fly(2)
    assert live.frames and {frame.T_map_camera[1, 3] for frame in live.frames} == {100.0}


def partners(depth, labels):
    """Return a memory of partners and its last label image; all in ms: (stamp, arrival)."""
    seen = Partners(KEEP)
    for stamp, arrival in depth:
        seen.depth(stamp * S // 1000, arrival * S // 1000, 0.02)
    for stamp, arrival in labels:
        seen.labels(stamp * S // 1000, arrival * S // 1000)
    return seen, *(value * S // 1000 for value in labels[-1])


@pytest.mark.parametrize('depth, labels, words', [
    ([], [(0, 0)], 'no depth image has come at all'),
    ([(0, 0), (100, 100)], [(0, 2500)], 'sync.max_wait=4'),
    ([(0, 3000)], [(0, 0)], 'came 3.0 s after it'),
    ([(0, 0), (100, 100)], [(140, 150)], '40 ms earlier'),
    ([(0, 0), (100, 100)], [(140, 150)], 'sync.offset_labels=-0.040'),
    ([(0, 0), (100, 100)], [(140, 150)], 'sync.tolerance=0.048'),
    ([(0, 0), (100, 100), (300, 300), (400, 400)], [(200, 200)],
     'never came: the nearest is 100 ms away, they come every 100 ms'),
    ([(0, 0), (100, 100)], [(500, 500)], 'has not come: the nearest is 400 ms away'),   # it ended
    ([(0, 1500), (100, 1600)], [(700, 700)], 'depth seems to come 1.5 s later'),
    ([(0, 1500), (100, 1600)], [(700, 700)], '--set sync.max_wait=3 ')])
def test_why_there_is_no_depth_image(depth, labels, words):
    seen, stamp, arrival = partners(depth, labels)
    assert words in seen.explain(stamp, arrival, Sync())


@pytest.mark.parametrize('depth, labels, lost', [
    (range(0, 3000, 100), range(40, 3040, 100), None),      # stamped later, nothing is lost
    (range(0, 3000, 33), range(0, 3000, 330), None),        # more depth than labels
    (range(0, 3000, 200), range(0, 3000, 100), (15, 29)),   # what is newer may still come
    (range(0, 1500, 100), range(0, 3000, 100), None),       # so may all of these
    ([], range(0, 3000, 100), None), ([], range(0, 8000, 100), (0, 30))])
def test_whether_depth_was_lost(depth, labels, lost):
    assert partners([(t, t) for t in depth], [(t, t) for t in labels])[0].lost() == lost


def test_labels_that_come_late_name_the_setting_that_lets_depth_wait():
    live = Live()
    for i in range(120):
        live.now = i / 10
        live.pose(live.now)
        live.depth(live.now)
        if i >= 25:
            live.labels(live.now - 2.5)
    assert not live.frames and live.dropped[NO_DEPTH] > 50
    assert '--set sync.max_wait=4' in live.intake.examples[NO_DEPTH]
    live = Live(**{'sync.max_wait': 4.0})
    for i in range(120):
        live.now = i / 10
        live.pose(live.now)
        live.depth(live.now)
        if i >= 25:
            live.labels(live.now - 2.5)
    assert len(live.frames) > 90 and not live.dropped[NO_DEPTH]


@pytest.mark.parametrize('every, late, lost', [(1, 104, None), (2, 52, (52, 104))])
def test_depth_that_comes_late_is_not_lost_and_names_the_wait_that_helps(every, late, lost):
    """Of every second depth image both is true: half are late, half never come."""
    def live(**settings):
        live = Live(**settings)
        for i in range(120):
            live.now = i / 10
            live.labels(live.now)
            if i >= 15:
                live.pose(live.now - 1.5)
            if i >= 15 and i % every == 0:
                live.depth(live.now - 1.5)
        return live
    short = live()
    assert not short.frames and short.dropped[NO_DEPTH] > 100
    sentence = short.intake.examples[NO_DEPTH]
    assert f'up to 1.5 s later than its label image ({late} depth' in sentence, sentence
    assert '--set sync.max_wait=3 ' in sentence and 'never came' not in sentence
    assert short.intake.few_depths() == lost
    assert len(live(**{'sync.max_wait': 3.0}).frames) > 0.8 * late


def test_the_bound_of_bytes_is_that_of_waiting_depth_too():
    size = bags.WIDTH * bags.HEIGHT * 4
    live = Live(**{'sync.max_wait': 100.0})
    live.intake.configure(updated(live.config, {'sync.queue_bytes': 1 << 16}))
    for i in range(200):
        live.now = i / 10
        live.depth(live.now)
    assert live.station.sync.bytes <= 1 << 16 < 200 * size
    assert live.dropped['depth: queue full'] > 50
    live.intake.explain()
    assert '--set sync.queue_bytes=131072' in live.intake.examples['depth: queue full']


def test_a_wait_that_passes_drops_nothing_and_one_that_stays_does():
    passing, lasting = Backlog(), Backlog()
    ms = S // 1000
    assert not any(passing.late(max(800 - 100 * i, 0) * ms, i * 50 * ms, 2 * S)
                   for i in range(20))
    dropped, age = 0, 0
    for i in range(3000):       # a frame comes every 33 ms and takes 50 ms: 17 ms more each time
        if lasting.late(age * ms, i * 33 * ms, 2 * S):
            dropped += 1
            age -= 33
        else:
            age += 17
        assert age < 1000
    assert dropped > 500


def test_what_waited_while_kernels_were_loaded_is_no_backlog():
    live = Live()
    live.fly(1)
    live.pose(1.2)
    before = len(live.frames)
    live.depth(1.1)
    late = live.intake
    late._steady = lambda: live.steady + 3 * S
    late.begin()
    live.labels(1.1)
    assert len(live.frames) == before + 1 and not live.dropped


def test_images_and_poses_that_both_come_late_are_late_and_of_one_clock():
    clocks = Clocks(1.5)
    for i in range(40):         # a busy machine: poses take 3 s, images 8 s
        now = i * S // 8
        clocks.image(now - 8 * S, now - 3 * S, now, now)
        assert clocks.ahead == 0 and clocks.late == 5 * S


def test_what_is_old_is_left_out_where_mapping_is_behind():
    live = Live()
    for i in (1, 2, 3, 4):          # nothing has a pose yet
        live.depth(i / 10)
        live.labels(i / 10)
    live.intake.skip(bags.START + round(0.4 * S), 7)
    assert live.dropped == {BEHIND: 7 + 3}
    live.pose(0.3)
    live.pose(0.5)
    assert [frame.stamp for frame in live.frames] == [bags.START + round(0.4 * S)]


def test_in_the_worst_case_a_late_frame_is_taken_now_and_then():
    backlog = Backlog()
    taken = [i for i in range(300) if not backlog.late(3 * S // 2, i * S // 10, 2 * S)]
    assert 20 <= len(taken) and max(np.diff(taken)) <= 11


def test_labels_wait_for_what_ties_them_to_the_depth_but_not_for_ever():
    live = Live()
    assert not live.intake.untied('depth', 'labels')
    live.now = 0.4
    assert not live.intake.untied('depth', 'labels')
    live.now = 0.6
    assert live.intake.untied('depth', 'labels')


def test_a_longer_queue_has_more_patience_with_a_burst():
    ms = S // 1000
    ages = [(50 * i, i) for i in range(1, 60)]      # 60 frames at once, 50 ms for each
    for queue, lost in ((2 * S, True), (60 * S, False)):
        backlog = Backlog()
        assert any(backlog.late(a * ms, a * ms, queue) for a, _ in ages) == lost


def test_frames_that_waited_for_too_long_are_dropped_before_they_are_decoded():
    live = Live()
    live.fly(1)
    live.pose(1.2)                  # all that was held has its pose
    before = len(live.frames)
    live.depth(1.1)
    late = live.intake
    late._steady = lambda: live.steady + 3 * S      # mapping took three seconds meanwhile
    live.labels(1.1)
    assert len(live.frames) == before and live.dropped == {BEHIND: 1}


def test_a_camera_may_need_more_than_depth_live_too():
    live = Live()
    station = live.intake.add_camera('other', live.buffer, ('color',), ('depth', 'confidence'))
    assert station in live.intake.stations


def test_depth_that_died_out_is_lost_and_no_offset_is_proposed():
    seen, second = Partners(KEEP), 10 ** 9
    seen.depth(0, 0, 0.02)
    for i in range(100):
        seen.labels(i * second // 10, i * second // 10)
    depth, labels = seen.lost()
    assert depth == 1 and labels == 50
    said = seen.explain(9 * second, 9 * second, Config().sync)
    assert said == 'no depth image has come for 9 s'
