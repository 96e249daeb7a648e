"""The reference itself against examples worked out by hand from the specification."""

from dataclasses import replace
import math

import numpy as np
from persem_ros.settings.config import Refine
import pytest
import reference as ref

EYE = np.eye(4)
A, B, C = 3, 7, 9       # three classes, in order of id
HERE, EAST, WEST = (0, 0, 0), (1, 0, 0), (-1, 0, 0)


def memory_of(histories):
    """Return the Memory in which voxel v saw [(c, s), ...] at t = 0, 1, 2 ..."""
    memory = ref.Memory()
    for t in range(max(map(len, histories.values()))):
        memory.add({v: h[t] for v, h in histories.items() if t < len(h)}, stamp=1000 * t)
    return memory


# ---- section 1


def test_backprojection_of_a_pixel_by_hand():
    # fx = fy = 100, c = (1, 0): pixel (u=2, v=1) at 5 m lies at (0.05, 0.05, 5).
    rays = [[((u - 1) / 100, v / 100) for u in range(3)] for v in range(2)]
    depth = [[0.0, 2.0, math.nan], [math.inf, 0.05, 5.0]]
    labels = [[1, 2, 3], [4, 5, 6]]
    points, ids = ref.backproject(depth, rays, labels)
    assert ids == [2, 6]
    assert points == [(0.0, 0.0, 2.0), (0.05, 0.05, 5.0)]


def test_pixels_that_do_not_count():
    rays = [[(0.0, 0.0)] * 8]
    depth = [[1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 200.0, 200.1]]
    labels = [[255, 65535, -1, 70000, 12, 0, 65534, 1]]
    _, ids = ref.backproject(depth, rays, labels, dynamic=(12,))
    assert ids == [0, 65534]        # both ends of the range of depths and of ids are in


def test_stride_takes_every_nth_pixel_of_every_nth_row():
    rays = [[(0.0, 0.0)] * 5] * 3
    labels = [[10 * v + u for u in range(5)] for v in range(3)]
    _, ids = ref.backproject([[1.0] * 5] * 3, rays, labels, stride=2)
    assert ids == [0, 2, 4, 20, 22, 24]


def test_labels_of_another_size_are_resampled_to_the_depth():
    assert ref.resampled([[1, 2], [3, 4]], 4, 4) == [
        [1, 1, 2, 2], [1, 1, 2, 2], [3, 3, 4, 4], [3, 3, 4, 4]]
    # One of three: the middle one.
    assert ref.resampled([[1, 2, 3, 4, 5, 6]], 1, 2) == [[2, 5]]


def test_voxel_is_the_floor_also_below_zero():
    assert ref.voxel_of((0.49, 0.5, -0.01), EYE, 0.5) == (0, 1, -1)
    turned = np.array([[0, -1, 0, 10.0], [1, 0, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1]])
    # x' = -y + 10 = 8, y' = x = 1, z' = 3 - 1 = 2
    assert ref.voxel_of((1.0, 2.0, 3.0), turned, 0.5) == (16, 2, 4)
    assert ref.voxel_of((1.0, 2.0, 3.0), turned, 0.5, origin=(8.0, 0.0, 0.5)) == (0, 2, 3)


def test_one_observation_per_voxel_and_frame():
    points = [(0.1, 0.1, 0.1)] * 3 + [(0.9, 0.1, 0.1)] * 2 + [(math.nan, 0, 0)]
    seen = ref.observe(points, [A, B, B, C, -1, A], EYE, 0.5)
    assert seen == {(0, 0, 0): (B, float(np.float32(2 / 3))), (1, 0, 0): (C, 1.0)}


def test_a_tie_in_a_voxel_goes_to_the_smaller_id():
    assert ref.observe([(0, 0, 0)] * 4, [B, A, B, A], EYE, 1.0) == {HERE: (A, 0.5)}


def test_a_voxel_below_min_pixels_is_not_observed():
    points = [(0, 0, 0), (0, 0, 0), (1, 0, 0), (1, 0, 0)]
    # The second voxel has two pixels, one of which counts.
    assert ref.observe(points, [A, A, A, -1], EYE, 1.0, min_pixels=2) == {HERE: (A, 1.0)}


# ---- section 2


def test_time_counts_the_distinct_stamps():
    memory = ref.Memory()
    memory.add({HERE: (A, 1.0)}, stamp=500, sensor='front')
    memory.add({HERE: (B, 1.0)}, stamp=500, sensor='down')
    memory.add({}, stamp=600)       # saw nothing, and still is a frame
    memory.add({HERE: (A, 0.5)}, stamp=700)
    assert [o.t for o in memory.histories[HERE]] == [0, 0, 2]
    assert len(memory.frames) == 4


def test_evidence_share_and_majority():
    memory = memory_of({HERE: [(A, 0.5), (B, 0.75), (A, 0.75)]})
    assert memory.evidence(HERE) == {A: 1.25, B: 0.75}
    assert memory.share(HERE) == {A: 0.625, B: 0.375}
    assert memory.majority(HERE) == A


@pytest.mark.parametrize('values, preferred, answer', [
    ({A: 1.0, B: 2.0}, A, B),
    ({A: 1.0, B: 1.0}, None, A),
    ({A: 1.0, B: 1.0}, B, B),               # the majority label wins its tie
    ({A: 1.0, B: 1.0, C: 0.5}, C, A),       # it takes no part: the smaller id
    ({A: 1.0, B: 1.0 + 0.9e-9}, None, A),   # within 1e-9 is a tie
    ({A: 1.0, B: 1.0 + 1.1e-9}, None, B),
])
def test_argmax(values, preferred, answer):
    assert ref.argmax(values, preferred) == answer


def test_greater_means_greater_by_more_than_the_tie():
    assert not ref.exceeds(0.1, 0.1)
    assert not ref.exceeds(0.1 + 0.9e-9, 0.1)
    assert ref.exceeds(0.1 + 1.1e-9, 0.1)


def test_neighbourhoods():
    assert [len(ref.offsets(n)) for n in (6, 18, 26)] == [6, 18, 26]
    assert ref.offsets(6) == [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0)]
    assert (1, 1, 1) not in ref.offsets(18) and (1, 0, 1) in ref.offsets(18)
    corner, edge = (1, 1, 1), (0, -1, 1)
    memory = memory_of({HERE: [(A, 1.0)], corner: [(A, 1.0)], edge: [(A, 1.0)], EAST: [(A, 1.0)]})
    assert memory.neighbours(HERE, 6) == [EAST]
    assert memory.neighbours(HERE, 18) == [edge, EAST]
    assert memory.neighbours(HERE, 26) == [edge, EAST, corner]


# ---- section 3


def test_volatility_over_all_pairs_of_all_voxels():
    memory = memory_of({HERE: [(A, 1.0), (A, 1.0), (B, 1.0), (A, 1.0)],
                        EAST: [(A, 1.0), (C, 1.0)]})
    # Pairs AA AB BA and AC: A starts three and changes twice, B starts one; C starts none.
    assert memory.volatility() == {A: 2 / 3, B: 1.0}


def test_history_anchor():
    # p = (A 0.6, B 0.4), both neighbours are all B: 0.7 p + 0.3 q = (A 0.42, B 0.58).
    memory = memory_of({HERE: [(A, 0.6), (B, 0.4), (A, 0.6), (B, 0.4)],
                        EAST: [(B, 1.0)], WEST: [(B, 0.5)]})
    assert ref.label(memory, 'persem', Refine())[HERE] == (B, ref.HISTORY)
    assert ref.label(memory, 'history', Refine())[HERE] == (B, ref.HISTORY)
    # EAST and WEST were seen once: not recurrent, so the neighbour changes nothing there.
    assert ref.label(memory, 'history', Refine())[EAST] == (B, ref.MAJORITY)
    # eta = 1/6: (A 0.5, B 0.5), a tie, which the majority label wins.
    assert ref.anchor(memory, HERE, replace(Refine(), eta=1 / 6)) == A


def test_anchor_without_a_neighbour_is_the_majority():
    memory = memory_of({HERE: [(A, 0.6), (B, 0.5)], (5, 5, 5): [(B, 1.0)]})
    assert ref.anchor(memory, HERE, replace(Refine(), eta=1.0)) == A


def test_replay_step_by_step():
    memory = memory_of({HERE: [(A, 1.0), (A, 1.0), (B, 1.0), (B, 0.5)]})
    history, rho = memory.histories[HERE], {A: 0.5, B: 0.25}
    made_up = replace(Refine(), lambda_volatility=2.0, lambda_disagreement=1.0, lambda_gap=0.1,
                      gamma=0.5)
    e = ref.trusted_evidence(history, rho, made_up)
    # exp(-2 0.5) = 0.367879 for A, exp(-2 0.25) = 0.606531 for B; a gap of 1 costs 0.904837,
    # a surprise 0.367879.
    # 1: A 0.367879. 2: A 0.183940 + 0.332871 = 0.516811.
    # 3: A 0.258405, B (a surprise) 0.606531 0.904837 0.367879 = 0.201897.
    # 4: A leads before it, so B surprises again: A 0.129203, B 0.100948 + 0.5 0.201897.
    assert e == pytest.approx({A: 0.129203, B: 0.201897}, abs=1e-6)


def test_surprise_in_a_tie_is_of_the_smaller_id():
    # Without decay e is (B 1), then (A 1, B 1): the argmax is A, so a third B is a surprise.
    plain = replace(Refine(), lambda_volatility=0.0, lambda_disagreement=math.log(2),
                    lambda_gap=0.0, gamma=1.0)
    memory = memory_of({HERE: [(B, 1.0), (A, 2.0), (B, 1.0)]})
    assert ref.trusted_evidence(memory.histories[HERE], {}, plain) == pytest.approx(
        {A: 1.0, B: 1.5})


def late_change():
    """Return a Memory: HERE saw A A A A, then B B; its two neighbours are B and mostly B."""
    return memory_of({HERE: [(A, 1.0)] * 4 + [(B, 0.8)] * 2,
                      EAST: [(B, 1.0)] * 3, WEST: [(B, 0.6), (A, 0.4), (B, 1.0)]})


QUICK = replace(Refine(), gamma=0.5, eta=0.0, lambda_volatility=0.0, lambda_disagreement=0.0,
                lambda_gap=0.0)


def test_trust_proposal_and_its_verification():
    memory = late_change()
    # e(A) = (1 + 1/2 + 1/4 + 1/8) / 4 = 0.46875, e(B) = 0.8 + 0.4 = 1.2: B by 0.73125.
    assert ref.trusted_evidence(memory.histories[HERE], {}, QUICK) == pytest.approx(
        {A: 0.46875, B: 1.2})
    # S_hard = (B 1), S_hist = (A 0.1, B 0.9): margins 1 and 0.8.
    assert ref.margins(memory, HERE, B, QUICK) == pytest.approx((1.0, 0.8))
    assert ref.label(memory, 'persem', QUICK)[HERE] == (B, ref.TRUST)
    assert ref.label(memory, 'trust', QUICK)[HERE] == (B, ref.TRUST)
    assert ref.label(memory, 'majority', QUICK)[HERE] == (A, ref.MAJORITY)


def test_thresholds_hit_exactly_are_not_exceeded():
    memory = late_change()
    assert ref.label(memory, 'persem', replace(QUICK, tau_replay=0.73125))[HERE][0] == A
    assert ref.label(memory, 'persem', replace(QUICK, tau_replay=0.7312))[HERE][0] == B
    assert ref.label(memory, 'persem', replace(QUICK, tau_context=0.8))[HERE][0] == A
    assert ref.label(memory, 'persem', replace(QUICK, tau_context=0.79))[HERE][0] == B
    # trust asks no neighbour
    assert ref.label(memory, 'trust', replace(QUICK, tau_context=0.8))[HERE][0] == B


def test_nothing_is_accepted_without_a_neighbour():
    memory = memory_of({HERE: [(A, 1.0)] * 4 + [(B, 0.8)] * 2})
    free = replace(QUICK, tau_context=0.0)
    assert ref.label(memory, 'persem', free)[HERE] == (A, ref.MAJORITY)
    assert ref.label(memory, 'context', free)[HERE] == (A, ref.MAJORITY)
    assert ref.label(memory, 'trust', free)[HERE] == (B, ref.TRUST)


def test_the_replay_reads_only_the_newest():
    memory = memory_of({HERE: [(A, 1.0)] * 3 + [(B, 0.9)] * 2})
    slow = replace(QUICK, gamma=1.0)
    assert ref.proposal(memory, HERE, {}, slow) is None             # A 3.0, B 1.8
    assert ref.proposal(memory, HERE, {}, slow, max_history=3) == B  # A 1.0, B 1.8
    assert memory.majority(HERE) == A
    # The window's first observation starts the replay: no gap, no surprise.
    gap = replace(slow, lambda_gap=1.0, lambda_disagreement=1.0)
    e = ref.trusted_evidence(memory.histories[HERE][-1:], {}, gap)
    assert e == {B: pytest.approx(0.9)}
    assert ref.proposal(memory, HERE, {}, gap, max_history=1) == B


def test_one_observation_less_than_recurrent():
    memory = memory_of({HERE: [(A, 1.0), (B, 0.9)], EAST: [(B, 1.0)] * 3})
    eager = replace(QUICK, eta=1.0)
    assert ref.label(memory, 'persem', eager)[HERE] == (A, ref.MAJORITY)
    assert ref.label(memory, 'persem', replace(eager, min_observations=2))[HERE] == (
        B, ref.HISTORY)


# ---- section 4


def test_context_and_context_history():
    memory = memory_of({HERE: [(A, 1.0)] * 3, EAST: [(B, 1.0)] * 3, WEST: [(B, 0.6), (A, 0.4)]})
    # S_hard = (B 1), S_hist = (A 0.2, B 0.8): margins 1 and 0.6.
    assert ref.label(memory, 'context', Refine())[HERE] == (B, ref.CONTEXT)
    assert ref.label(memory, 'context', replace(Refine(), tau_context=0.6))[HERE] == (
        A, ref.MAJORITY)
    # 0.7 (A 1) + 0.3 (A 0.2, B 0.8): the anchor stays, and context comes after it.
    assert ref.label(memory, 'context_history', Refine())[HERE] == (B, ref.CONTEXT)
    assert ref.label(memory, 'context_history', replace(Refine(), eta=0.9))[HERE] == (
        B, ref.HISTORY)


def test_context_ties_go_to_the_majority():
    memory = memory_of({HERE: [(C, 1.0)] * 3, EAST: [(C, 1.0)], WEST: [(A, 1.0)]})
    assert ref.label(memory, 'context', replace(Refine(), tau_context=0.0))[HERE] == (
        C, ref.MAJORITY)


def test_unweighted_counts():
    memory = memory_of({HERE: [(B, 1.0), (A, 0.4), (A, 0.4)]})
    assert memory.majority(HERE) == B
    assert ref.fused(memory, HERE, 'unweighted', Refine()) == A
    # One each: a tie, and the majority label has the larger id.
    memory = memory_of({HERE: [(B, 1.0), (A, 0.4)]})
    assert ref.fused(memory, HERE, 'unweighted', Refine()) == B


def test_recency_by_hand():
    # lambda_r = ln 2: weights 1/8, 1/4, 1/2, 1: A 0.125 + 0.25 + 0.5, B 0.9.
    halving = replace(Refine(), lambda_recency=math.log(2))
    memory = memory_of({HERE: [(A, 1.0)] * 3 + [(B, 0.9)]})
    assert ref.fused(memory, HERE, 'recency', halving) == B
    memory = memory_of({HERE: [(A, 1.0)] * 3 + [(B, 0.85)]})
    assert ref.fused(memory, HERE, 'recency', halving) == A


def test_consensus_by_hand():
    # No decay: A 1, then B 0.8 (not the argmax), then A 0.1 (is: 0.15), then B 0.4 (is not).
    # A 1.15, B 1.2; without the bonus A 1.1.
    flat = replace(Refine(), lambda_recency=0.0)
    memory = memory_of({HERE: [(A, 1.0), (B, 0.8), (A, 0.1), (B, 0.32)]})
    assert memory.majority(HERE) == B                                   # B 1.12, A 1.10
    assert ref.fused(memory, HERE, 'recency', flat) == B
    assert ref.fused(memory, HERE, 'consensus', flat) == A              # A 1.15
    assert ref.fused(memory, HERE, 'consensus', replace(flat, beta=0.1)) == B   # A 1.11


def test_probabilistic_by_hand():
    # K = 3. A 0.4 spreads 0.3 and 0.3; three times: A 1.2, B 0.9, C 0.9.
    # B 0.9 spreads 0.05 and 0.05: A 1.25, B 1.8.
    memory = memory_of({HERE: [(A, 0.4)] * 3 + [(B, 0.9)], EAST: [(C, 1.0)]})
    assert memory.majority(HERE) == A
    assert ref.fused(memory, HERE, 'probabilistic', Refine()) == B
    alone = memory_of({HERE: [(A, 0.4)]})
    assert ref.fused(alone, HERE, 'probabilistic', Refine()) == A


def test_probabilistic_spreads_over_ids_that_never_won_a_voxel():
    # K = 2: A 0.4 gives B 0.6 and B wins. K = 4: A 0.4 against 0.2 each.
    two, four = ref.Memory(), ref.Memory()
    two.add({HERE: (A, 0.4)}, 0, ids=[A, B])
    four.add({HERE: (A, 0.4)}, 0, ids=[A, B, C, 0, -1, 70000])
    assert ref.fused(two, HERE, 'probabilistic', Refine()) == B
    assert ref.fused(four, HERE, 'probabilistic', Refine()) == A


def test_fusion_labels_every_voxel_with_source_0():
    memory = memory_of({HERE: [(B, 1.0)], EAST: [(A, 0.6)] * 5})
    for method in ref.FUSION:
        assert ref.label(memory, method, Refine()) == {HERE: (B, 0), EAST: (A, 0)}


def test_ema2d_by_hand():
    # alpha 0.7: A 1; then A 0.7, B 0.3; then A 0.49, B 0.51.
    images = [[[A, A, 255]], [[B, 255, B]], [[B, B, C]], [[B, -1, 65535]]]
    assert ref.ema2d(images, 0.7) == [[[A, A, -1]], [[A, A, B]], [[B, A, B]], [[B, A, B]]]


def test_ema2d_starts_anew_with_another_size():
    assert ref.ema2d([[[A, A]], [[B]], [[B, B]]], 0.7) == [[[A, A]], [[B]], [[B, B]]]


def test_ema2d_tie_goes_to_the_smaller_id():
    assert ref.ema2d([[[A]], [[B]]], 0.5)[-1] == [[A]]
    assert ref.ema2d([[[B]], [[A]]], 0.5)[-1] == [[A]]


# ---- section 5


def test_render_by_hand():
    points = [(0.2, 0.2, 0.2), (0.7, 0.2, 0.2), None, (0.2, 0.2, 0.2), (0.2, 0.2, 0.2)]
    own = [1, 2, 3, 12, 255]
    known = {(0, 0, 0): 9}
    shown = {fill: ref.render(known, points, own, EYE, 0.5, fill, dynamic=(12,))
             for fill in ('input', 'unknown')}
    assert shown == {'input': [9, 2, 3, 12, 9],
                     'unknown': [9, ref.UNKNOWN, ref.UNKNOWN, 12, 9]}


# ---- section 6


def test_scores_by_hand():
    #        right A, right A, A as B, right B, B unknown, not valid
    truths = [A, A, A, B, B, C]
    given = [A, A, B, B, ref.UNKNOWN, C]
    table = ref.confusion(truths, given, [True] * 5 + [False])
    assert ref.pixel_accuracy(table) == 60.0
    # A: 2 of 3; B: 1 of (2 true + 1 false) = 1/3; mean 1/2. C and "unknown" are not in the truth.
    assert ref.iou(table) == pytest.approx({A: 200 / 3, B: 100 / 3})
    assert ref.miou(table) == pytest.approx(50.0)
    nothing = ref.confusion(truths, given, [False] * 6)
    assert ref.pixel_accuracy(nothing) is None and ref.miou(nothing) is None


def test_groups_by_hand():
    table = {A: 0, B: 0, C: 1}
    assert [ref.grouped(c, table) for c in (A, B, C, 5)] == [0, 0, 1, None]


def test_flicker_by_hand():
    images = [[A, A, A, A], [A, B, B, B], [B, B, B, A]]
    valid = [[True] * 4, [True, True, False, True], [True] * 4]
    # First pair: 3 valid in both, 2 differ. Second: 3 and 2 (A to B, B to A).
    assert ref.flicker(images, valid) == pytest.approx(100 * 4 / 6)
    assert ref.flicker(images[:1], valid[:1]) is None


def test_regions_by_hand():
    memory = memory_of({
        HERE: [(A, 1.0)] * 4,                               # beside a B: boundary alone
        EAST: [(B, 0.6), (A, 0.5), (B, 0.6), (A, 0.5)],     # boundary, switches, entropy, margin
        (9, 0, 0): [(C, 1.0)],                              # alone, seen once
        (20, 0, 0): [(A, 1.0)] * 7 + [(B, 0.1)] * 4})       # one change in ten, low entropy
    found = ref.regions(memory, 26)
    assert found == {HERE: {'boundary'},
                     EAST: {'boundary', 'high_switch', 'difficult_core'},
                     (9, 0, 0): set(), (20, 0, 0): set()}


def test_high_switch_at_exactly_0_3_is_not_high():
    changing = [(A, 1.0), (B, 1.0), (A, 1.0), (B, 1.0)] + [(B, 1.0)] * 7    # 3 of 10
    memory = memory_of({HERE: changing, (9, 0, 0): changing[:-1]})          # 3 of 9
    found = ref.regions(memory, 6)
    assert 'high_switch' not in found[HERE] and 'high_switch' in found[9, 0, 0]


def test_entropy_in_nat():
    assert ref.entropy({A: 0.5, B: 0.5}) == pytest.approx(math.log(2))
    assert ref.entropy({A: 1.0, B: 0.0}) == 0.0
