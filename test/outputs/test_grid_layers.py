"""The grid that follows a map: whatever came in whatever order, it is the grid of the whole."""

from types import SimpleNamespace

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.outputs.grid import layers
from persem_ros.outputs.grid.layers import Layers, TooLarge
from persem_ros.outputs.grid.rule import rule_of
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
import pytest

LEGEND = Legend.from_yaml('classes:\n' + '\n'.join(
    f'- {{id: {c}, name: c{c}, cost: {10 * c}}}' for c in range(1, 9)))


def grid(resolution=0.0, tie='highest', window=2, labels='top'):
    """Return fresh Layers of voxels of 0.5 m."""
    config = updated(Config(), {
        'grid.window': window, 'grid.step': 0.6, 'grid.height': 2.1, 'grid.labels': labels,
        'grid.min_observations': 2})
    return Layers(rule_of(config, LEGEND, 0.5), 0.5, resolution, tie)


def changed(blocks, forgotten=(), anew=False):
    """Return what core.memory.changes hands over, of {block: (voxels, labels, observations)}."""
    parts = list(blocks.values())
    return SimpleNamespace(
        index=np.array(list(blocks), np.int32).reshape(-1, 3),
        counts=np.array([len(part[0]) for part in parts], np.int64),
        columns={'voxel': np.concatenate([np.empty((0, 3), np.int32), *(p[0] for p in parts)]),
                 'label': np.concatenate([np.empty(0, np.uint16), *(p[1] for p in parts)]),
                 'observations': np.concatenate([np.empty(0, np.uint32),
                                                 *(p[2] for p in parts)])},
        forgotten=np.array(list(forgotten), np.int32).reshape(-1, 3), anew=anew)


def block(rng, index):
    """Return random voxels of a block."""
    cells = np.unique(rng.integers(0, 512, rng.integers(1, 80)))
    voxel = np.array(index) * 8 + np.stack([cells >> 6, cells >> 3 & 7, cells & 7], axis=1)
    return (voxel.astype(np.int32), rng.integers(1, 9, len(cells)).astype(np.uint16),
            rng.integers(1, 5, len(cells)).astype(np.uint32))


def known(cells):
    """Return {(x, y): (cost, label)} of all cells that are not blank."""
    y, x = np.nonzero((cells.cost >= 0) | (cells.label != 65535))
    return {(int(i) + cells.corner[0], int(j) + cells.corner[1]):
            (int(cells.cost[j, i]), int(cells.label[j, i])) for i, j in zip(x, y)}


@cw.examples(max_examples=25)
@given(cw.seeds, st.sampled_from([(0.0, 'highest'), (1.0, 'lowest'), (1.3, 'unknown'),
                                  (5.0, 'highest')]), st.sampled_from(['top', 'ground']))
def test_the_order_of_changes_leaves_no_trace(seed, cell, labels):
    rng = np.random.default_rng(seed)
    followed, state = grid(*cell, labels=labels), {}
    for step in range(6):
        new = {}
        for _ in range(rng.integers(1, 6)):
            index = tuple(rng.integers(-3, 3, 3).tolist())
            new[index] = block(rng, index)
        gone = [index for index in state if rng.random() < 0.15]
        for index in gone:
            del state[index]
        state.update(new)
        before, corner = known(followed.cells), followed.cells.corner
        box, grown = followed.update(changed(new, gone))
        whole = grid(*cell, labels=labels)
        whole.update(changed(state))
        assert known(followed.cells) == known(whole.cells)
        if not grown:       # what is outside of the box was told before
            x0, y0, x1, y1 = box
            after = known(followed.cells)
            for key in {**before, **after}:
                x, y = key[0] - corner[0], key[1] - corner[1]
                assert before.get(key) == after.get(key) or x0 <= x < x1 and y0 <= y < y1


def test_another_map_begins_anew():
    rng = np.random.default_rng(0)
    followed = grid()
    followed.update(changed({(0, 0, 0): block(rng, (0, 0, 0))}, anew=True))
    assert known(followed.cells)
    new = {(5, 5, 0): block(rng, (5, 5, 0))}
    assert followed.update(changed(new, anew=True))[1]
    fresh = grid()
    fresh.update(changed(new))
    assert known(followed.cells) == known(fresh.cells)
    assert followed.update(changed({})) == (None, False)


def test_a_rectangle_has_a_bound(monkeypatch):
    monkeypatch.setattr(layers, 'MOST_CELLS', 64 * 64)
    rng = np.random.default_rng(0)
    followed = grid()
    followed.update(changed({(0, 0, 0): block(rng, (0, 0, 0))}))
    with pytest.raises(TooLarge):
        followed.update(changed({(50, 0, 0): block(rng, (50, 0, 0))}))
