"""The synchroniser: who belongs to whom, who leaves when, who is dropped and why."""

from hypothesis import given, strategies as st
import numpy as np
from persem_ros.inputs.sync.match import COLOR, DEPTH, LABELS, TRUTH
from persem_ros.inputs.sync.pairing import Synchronizer
from persem_ros.inputs.sync.track import Lookup
from persem_ros.settings.config import Sync
import pytest

MS = 1_000_000
T = np.eye(4)


class Driver:
    """A synchroniser whose clock is set by hand; everything in milliseconds."""

    def __init__(self, tolerance=0.02, max_wait=1.0, **options):
        self.sync = Synchronizer(Sync(tolerance, max_wait), **options)
        self.now = 0
        self.left = []          # (label stamp, depth stamp)

    def push(self, kind, stamp, size=1, now=None):
        self.now = self.now if now is None else now
        self.sync.push(kind, stamp * MS, stamp, size, self.now * MS)
        return self.take(self.sync.advance(self.now * MS))

    def advance(self, now):
        self.now = now
        return self.take(self.sync.advance(now * MS))

    def flush(self):
        return self.take(self.sync.flush())

    def take(self, matches):
        pairs = [(m.items[LABELS], m.items[DEPTH]) for m in matches]
        assert [m.stamp for m in matches] == [label * MS for label, _ in pairs]
        self.left += pairs
        return pairs


@pytest.mark.parametrize('first, second', [(LABELS, DEPTH), (DEPTH, LABELS)])
def test_an_exact_partner_completes_at_once(first, second):
    d = Driver()
    assert d.push(first, 100) == []
    assert d.push(second, 100) == [(100, 100)]
    assert not d.sync.dropped and d.sync.bytes == 0


def test_the_nearest_is_taken_once_a_later_one_has_come():
    d = Driver()
    d.push(DEPTH, 88)
    d.push(DEPTH, 95)
    assert d.push(LABELS, 100) == []
    assert d.push(DEPTH, 110) == [(100, 95)]


def test_the_later_one_may_be_the_nearest():
    d = Driver()
    d.push(DEPTH, 90)
    d.push(LABELS, 100)
    assert d.push(DEPTH, 103) == [(100, 103)]


def test_an_exact_one_beats_a_nearer_arrival():
    d = Driver()
    d.push(DEPTH, 99)
    d.push(LABELS, 100)
    assert d.push(DEPTH, 100) == [(100, 100)]


def test_without_a_later_one_the_wait_decides():
    d = Driver()
    d.push(DEPTH, 95)
    d.push(LABELS, 100)
    assert d.advance(999) == []
    assert d.advance(1000) == [(100, 95)]


def test_the_tolerance_includes_its_end():
    d = Driver()
    d.push(DEPTH, 80)
    d.push(LABELS, 100)
    assert d.push(DEPTH, 200) == [(100, 80)]
    d = Driver()
    d.push(DEPTH, 79)
    d.push(LABELS, 100)
    assert d.push(DEPTH, 200) == [] and d.advance(1000) == []
    assert d.sync.dropped['no depth within tolerance'] == 1


def test_a_tolerance_of_zero_takes_exact_partners():
    d = Driver(tolerance=0.0)
    d.push(DEPTH, 100)
    assert d.push(LABELS, 100) == [(100, 100)]


def test_each_depth_image_is_used_once():
    d = Driver()
    d.push(DEPTH, 100)
    d.push(LABELS, 99)
    d.push(LABELS, 101)
    d.flush()
    assert d.left == [(99, 100)]
    assert d.sync.dropped == {'no depth within tolerance': 1}


def test_frames_leave_in_stamp_order_whatever_the_order_of_arrival():
    d = Driver()
    for stamp in (100, 200, 300):
        d.push(LABELS, stamp)
    assert d.push(DEPTH, 300) == []
    assert d.push(DEPTH, 200) == []
    assert d.push(DEPTH, 100) == [(100, 100), (200, 200), (300, 300)]


def test_a_label_image_without_depth_holds_the_others_for_no_longer_than_the_wait():
    d = Driver()
    d.push(LABELS, 100, now=0)
    d.push(LABELS, 200, now=100)
    assert d.push(DEPTH, 200, now=100) == []
    assert d.advance(1000) == [(200, 200)]
    assert d.sync.dropped == {'no depth within tolerance': 1}


def test_stamps_that_repeat_or_go_back():
    d = Driver()
    for stamp in (100, 200):
        d.push(LABELS, stamp)
        d.push(DEPTH, stamp)
    for stamp in (200, 150, 100):
        assert d.push(LABELS, stamp) == []
    d.push(LABELS, 300)
    d.push(LABELS, 300)
    d.push(DEPTH, 400)
    d.push(DEPTH, 400)
    assert d.sync.dropped == {'stamp repeated': 2, 'stamp went back': 2,
                              'depth: stamp repeated': 1}


def test_a_stamp_hours_ahead_harms_nobody():
    d = Driver()
    hours = 3 * 3600 * 1000
    d.push(LABELS, hours, now=0)
    for i in range(1, 30):
        d.push(LABELS, i * 100, now=i * 100)
        assert d.push(DEPTH, i * 100, now=i * 100) == [(i * 100, i * 100)]
    assert d.sync.dropped == {'no depth within tolerance': 1}


def test_a_depth_stamp_hours_ahead_does_not_hurry_the_labels():
    d = Driver()
    d.push(DEPTH, 3 * 3600 * 1000)
    d.push(DEPTH, 95)
    assert d.push(LABELS, 100) == []
    assert d.push(DEPTH, 100) == [(100, 100)]


def test_depth_images_without_labels_are_dropped_in_time():
    d = Driver()
    for i in range(300):
        d.push(DEPTH, i * 33, now=i * 33, size=10)
    assert d.sync.bytes <= 620
    d.push(LABELS, 299 * 33)
    assert d.left == [(299 * 33, 299 * 33)]
    d.flush()
    assert d.sync.bytes == 0 and d.sync.dropped == {'depth: no labels': 299}


def test_a_slow_segmenter_finds_its_depth_however_short_the_wait():
    d = Driver(max_wait=0.0)
    d.push(DEPTH, 100, now=100)
    d.advance(1500)
    assert d.push(LABELS, 100, now=1500) == [(100, 100)]


def test_queues_are_bounded_in_bytes():
    d = Driver(max_bytes=1000)
    for i in range(100):
        d.push(LABELS, i, size=100)
        assert d.sync.bytes <= 1000
    assert d.sync.dropped == {'queue full': 90}
    d.push(DEPTH, 99, size=2000)
    assert d.sync.bytes == 0 and d.sync.dropped['depth: queue full'] == 0
    d.push(DEPTH, 500, size=2000)
    assert d.sync.dropped['depth: queue full'] == 1


def test_clear_accepts_earlier_stamps_again():
    d = Driver()
    d.push(LABELS, 100)
    d.push(DEPTH, 100)
    d.sync.clear()
    d.push(LABELS, 50)
    assert d.push(DEPTH, 50) == [(50, 50)] and d.sync.bytes == 0


class Poses:
    """Answers as a PoseBuffer does: known up to a stamp, never for some."""

    def __init__(self):
        self.known, self.never = -1, set()

    def __call__(self, match):
        if match.items[LABELS] in self.never:
            return Lookup(None, True, 'pose gap')
        if match.items[LABELS] > self.known:
            return Lookup(None, False, 'no pose')
        return Lookup(T)


def test_frames_wait_for_their_pose():
    poses = Poses()
    d = Driver(lookup=poses)
    for stamp in (100, 200, 300):
        d.push(LABELS, stamp)
        assert d.push(DEPTH, stamp) == []
    poses.known = 250
    poses.never = {100}
    matches = d.sync.advance(d.now)
    assert [m.stamp for m in matches] == [200 * MS] and matches[0].T_map_camera is T
    assert d.sync.dropped == {'pose gap': 1}
    assert d.advance(1000) == []
    assert d.sync.dropped == {'pose gap': 1, 'no pose': 1}


def test_a_longer_wait_for_poses_is_bounded_by_bytes():
    d = Driver(lookup=Poses(), pose_wait=30.0, max_bytes=1000)
    for i in range(20):
        d.push(LABELS, i * 100, size=100, now=i * 100)
        d.push(DEPTH, i * 100, size=100, now=i * 100)
    assert d.sync.dropped == {'no pose': 15}
    d.advance(29_999)
    assert d.sync.dropped['no pose'] < 20
    d.advance(33_000)
    assert d.sync.dropped == {'no pose': 20} and d.sync.bytes == 0


def companions(d):
    """Return {label: (truth, color)} of everything that leaves."""
    return {m.items[LABELS]: (m.items.get(TRUTH), m.items.get(COLOR)) for m in d}


def test_companions_never_hold_a_live_frame_back():
    d = Driver(companions=(TRUTH, COLOR))
    d.sync.push(COLOR, 95 * MS, 95, 1, 0)
    d.sync.push(LABELS, 100 * MS, 100, 1, 0)
    d.sync.push(DEPTH, 100 * MS, 100, 1, 0)
    assert companions(d.sync.advance(0)) == {100: (None, 95)}


def test_a_patient_synchronizer_waits_for_companions():
    d = Driver(companions=(TRUTH, COLOR), patient=True)
    d.sync.push(LABELS, 100 * MS, 100, 1, 0)
    d.sync.push(DEPTH, 100 * MS, 100, 1, 0)
    d.sync.push(COLOR, 92 * MS, 92, 1, 0)
    assert d.sync.advance(0) == []
    d.sync.push(TRUTH, 100 * MS, 100, 1, 0)
    d.sync.push(COLOR, 105 * MS, 105, 1, 0)
    assert companions(d.sync.advance(0)) == {100: (100, 105)}


def test_companions_that_do_not_come_do_not_drop_the_frame():
    d = Driver(companions=(TRUTH,), patient=True)
    d.push(LABELS, 100)
    d.push(DEPTH, 100)
    d.push(LABELS, 200)
    d.push(DEPTH, 200)
    assert d.push(TRUTH, 200) == [(100, 100), (200, 200)]
    d.push(LABELS, 300)
    d.push(DEPTH, 300)
    assert d.advance(1000) == [(300, 300)] and not d.sync.dropped


@given(st.permutations([(kind, stamp) for kind in (LABELS, DEPTH)
                        for stamp in range(0, 600, 100)]))
def test_any_order_of_arrival_within_the_wait_leaves_in_stamp_order(messages):
    """What has an exact partner is never lost but to a later stamp that has left already."""
    d = Driver()
    for kind, stamp in messages:
        d.push(kind, stamp)
    d.flush()
    stamps = [label for label, _ in d.left]
    assert stamps == sorted(set(stamps)) and all(a == b for a, b in d.left)
    assert len(stamps) + d.sync.dropped['stamp went back'] == 6
    assert d.sync.bytes == 0


@given(st.lists(st.tuples(st.sampled_from([LABELS, DEPTH, TRUTH]), st.integers(0, 400),
                          st.integers(0, 60)), max_size=60), st.booleans())
def test_everything_is_used_or_counted_and_every_run_is_the_same(messages, patient):
    runs = []
    for _ in range(2):
        d = Driver(max_wait=0.1, companions=(TRUTH,), patient=patient, max_bytes=30)
        now = 0
        for kind, stamp, later in messages:
            now += later
            d.push(kind, stamp, now=now)
            assert d.sync.bytes <= 30
        d.flush()
        runs.append((d.left, d.sync.dropped))
        assert d.sync.bytes == 0
    assert runs[0] == runs[1]
    left, dropped = runs[0]
    labels = sum(n for reason, n in dropped.items() if ':' not in reason)
    depths = sum(n for reason, n in dropped.items() if reason.startswith('depth: '))
    assert len(left) + labels == sum(kind == LABELS for kind, _, _ in messages)
    used = {depth for _, depth in left}
    assert len(used) == len(left) and all(abs(a - b) <= 20 for a, b in left)
    # A depth image that a dropped label image had taken is gone with it.
    assert len(left) + depths <= sum(kind == DEPTH for kind, _, _ in messages) \
        <= len(left) + depths + labels
