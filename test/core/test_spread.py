"""Cells within some cells of marked ones, against marks on a plain grid."""

from hypothesis import given, settings, strategies as st
import numpy as np
from persem_ros.core.geometry.spread import MOST, spread
from persem_ros.core.memory.pools import BLOCK, ROWS, SIDE
import pytest


def grid_of_blocks(rng, side):
    """Return blocks of a cube of *side*, in any order and some of them missing, their places."""
    places = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing='ij'), axis=-1).reshape(-1, 3)
    places = places[rng.random(len(places)) < 0.8]
    rng.shuffle(places)
    blocks, number = np.zeros(len(places), BLOCK), {tuple(p): b for b, p in enumerate(places)}
    for b, (i, j, k) in enumerate(places):
        for d in range(27):
            other = number.get((i + d // 9 - 1, j + d // 3 % 3 - 1, k + d % 3 - 1))
            blocks['near'][b, d] = 0 if other is None else other + 1
    return blocks, places


def unpacked(marks):
    """Return marks (blocks, 64) as cells (blocks, 8, 8, 8), bool."""
    return np.unpackbits(marks, axis=1, bitorder='little').astype(bool).reshape(-1, *[SIDE] * 3)


@pytest.mark.parametrize('reach', range(1, MOST + 1))
@given(seed=st.integers(0, 2 ** 32 - 1), share=st.sampled_from([0.0, 0.001, 0.02, 0.5]))
@settings(max_examples=8, deadline=None)
def test_cells_within_reach_of_marked_ones(seed, share, reach):
    rng = np.random.default_rng(seed)
    blocks, places = grid_of_blocks(rng, 3)
    marks = np.packbits(rng.random((len(blocks), ROWS * SIDE)) < share, axis=1, bitorder='little')
    asked = np.flatnonzero(rng.random(len(blocks)) < 0.9)
    before = rng.integers(0, 2, marks.shape).astype(np.uint8)
    out = before.copy()
    spread(blocks, asked, marks, reach, out)

    world = np.zeros([3 * SIDE] * 3, bool)
    for cells, place in zip(unpacked(marks), places):
        world[tuple(slice(SIDE * p, SIDE * p + SIDE) for p in place)] = cells
    for axis in range(3):
        line = np.moveaxis(world, axis, 0)
        line[:] = [line[max(0, x - reach):x + reach + 1].any(axis=0) for x in range(len(line))]
    expected = unpacked(before)
    for b in asked:
        expected[b] |= world[tuple(slice(SIDE * p, SIDE * p + SIDE) for p in places[b])]
    np.testing.assert_array_equal(unpacked(out), expected)
