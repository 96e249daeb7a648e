"""Difficult regions against the reference."""

from core_worlds import core_of, EXACT, examples, reference_of, worlds
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from persem_ros.core.refine.regions import REGIONS, regions
import pytest
import reference as ref


def found_in(memory, neighbours):
    """Return {voxel: (set of region names, entropy, switch rate)} as the core sees it."""
    codes, entropy, rate = regions(memory, neighbours)
    columns = memory.voxels()
    return {tuple(v): ({name for name, bit in REGIONS.items() if codes[n] & bit},
                       float(entropy[n]), float(rate[n]))
            for v, n in zip(columns['voxel'].tolist(), columns['number'])}


def assert_same(frames, neighbours):
    """Hold the core's regions against the reference's."""
    expected = reference_of(frames)
    found = found_in(core_of(frames), neighbours)
    assert {v: names for v, (names, _, _) in found.items()} == ref.regions(expected, neighbours)
    for voxel, (_, entropy, rate) in found.items():
        h = expected.histories[voxel]
        changes = sum(a.c != b.c for a, b in zip(h, h[1:]))
        assert entropy == pytest.approx(ref.entropy(expected.share(voxel)), abs=1e-6)
        assert rate == pytest.approx(changes / max(1, len(h) - 1), abs=1e-6)


@given(worlds(most_frames=24), st.sampled_from([6, 18, 26]))
@examples(max_examples=100)
def test_random_worlds(frames, neighbours):
    assert_same(frames, neighbours)


@given(worlds(most_frames=12, shares=EXACT), st.sampled_from([6, 26]))
@examples(max_examples=60)
def test_round_shares(frames, neighbours):
    assert_same(frames, neighbours)


@pytest.mark.parametrize('pairs', [10, 20, 30, 70, 110, 130, 190, 230, 510, 990])
def test_a_switch_rate_of_exactly_three_tenths_is_not_high(pairs):
    changes = pairs * 3 // 10
    labels = [i % 2 for i in range(changes)] + [changes % 2] * (pairs + 1 - changes)
    frames = [(t, {(0, 0, 0): (c, 1.0)}, ()) for t, c in enumerate(labels)]
    (names, _, rate), = found_in(core_of(frames), 26).values()
    assert rate == pytest.approx(0.3) and 'high_switch' not in names
    frames.append((pairs + 1, {(0, 0, 0): (9, 1.0)}, ()))
    (names, _, rate), = found_in(core_of(frames), 26).values()
    assert rate > 0.3 and 'high_switch' in names


@pytest.mark.parametrize('shares', [(13, 7), (65, 35), (6, 3, 1), (4, 1, 1, 1, 1, 1, 1),
                                    (45, 15, 14, 13, 13), (35,) + 13 * (5,)])
def test_a_margin_of_exactly_three_tenths_is_not_low(shares):
    # Entropy is high here; the margin alone would make the second hint of a difficult core.
    order = [c for c, n in enumerate(shares) for _ in range(n)]     # few changes of label
    frames = [(t, {(0, 0, 0): (c, 1.0)}, ()) for t, c in enumerate(order)]
    if len(shares) - 1 > 0.3 * (len(order) - 1):        # thin out: repeat every observation
        frames = [(t, {(0, 0, 0): (c, 1.0)}, ()) for t, c in enumerate(np.repeat(order, 10))]
    (names, entropy, _), = found_in(core_of(frames), 26).values()
    assert entropy > 0.5 and names == set()
