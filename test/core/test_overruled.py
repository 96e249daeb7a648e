"""What heights of classes do to the votes of a map, and when that speaks against the heights."""

from dataclasses import replace

from core_worlds import examples
import geometry_reference as plain
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.geometry import upright as turned
from persem_ros.core.geometry.columns import Columns, merged
from persem_ros.core.geometry.ground import lower, NONE, TILE, tiles_of
from persem_ros.core.geometry.overruled import counts_of, Overruled, overruled, summed
from persem_ros.settings.config import Geometry, Refine
import pytest

HEIGHTS = '0 -1 1; 1 2 inf; 4 -inf 9; 7 0 1'


@given(st.integers(0, 2 ** 31), st.sampled_from(['z', '-x', 'y']), st.sampled_from([3, 20]))
@examples(max_examples=30)
def test_counts_are_those_of_the_definition(seed, up, window):
    rng = np.random.default_rng(seed)
    voxel = np.unique(rng.integers(-30, 40, (rng.integers(1, 300), 3)), axis=0).astype(np.int32)
    majority, label = rng.choice(np.array([0, 1, 4, 9], np.uint16), (2, len(voxel)))
    settings = replace(Refine(), up=up, geometry=Geometry(heights=HEIGHTS, window=window))
    columns = {'voxel': voxel, 'majority': majority, 'label': label}
    found = overruled(columns, settings)
    upright = np.array([plain.upright(v, up) for v in voxel.tolist()])
    steps = 12 * np.searchsorted(plain.HEIGHTS, plain.heights(upright, window), 'right')
    classes = [0, 1, 4]
    out = plain.hinted(HEIGHTS, steps, classes) < 1
    wanted = []
    for k, c in enumerate(classes):
        mine = majority == c
        if mine.any():
            wanted.append((c, mine.sum(), (mine & out[:, k]).sum(),
                           (mine & out[:, k] & (label == c)).sum()))
    assert [(one.label, *one[3:]) for one in found] == wanted
    parts = [{name: column[voxel[:, 0] // 8 % 2 == k] for name, column in columns.items()}
             for k in range(2)]
    whole = merged([lowest_of(turned.upright(part['voxel'], turned.up_of(up))) for part in parts])
    assert found == summed(
        [row for part in parts for row in counts_of(part, settings, whole)], settings)


def lowest_of(index):
    """Return the Columns of some upright voxels in any order."""
    tiles, tile = tiles_of(index // 8)
    lowest = np.full((len(tiles), TILE), NONE, np.int32)
    lower(index, tile, lowest)
    return Columns(tiles, lowest)


def test_without_heights_there_is_nothing_to_say():
    columns = {'voxel': np.zeros((1, 3), np.int32), 'majority': np.zeros(1, np.uint16),
               'label': np.zeros(1, np.uint16)}
    assert overruled(columns, Refine()) == []


@pytest.mark.parametrize('voxels, out, kept, doubtful', [
    (10_000, 5400, 200, False),     # a network that calls most roofs pavement
    (10_000, 1100, 340, False), (10_000, 400, 400, False), (100, 99, 99, False),
    (10_000, 9900, 200, True),      # where the class is not found at all
    (10_000, 6000, 3800, True), (10_000, 600, 460, True)])
def test_when_the_votes_speak_against_the_heights(voxels, out, kept, doubtful):
    assert Overruled(3, -5.0, 2.0, voxels, out, kept).doubtful == doubtful
