"""Difficult regions against the reference (spec section 6)."""

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.regions import region_image, REGIONS, regions
import reference as ref


@cw.examples(max_examples=80)
@given(cw.worlds(), st.sampled_from([6, 18, 26]))
def test_as_in_the_reference(world, neighbours):
    memory, plain = cw.core_of(world), cw.reference_of(world)
    codes = regions(memory, neighbours)
    for voxel, names in ref.regions(plain, neighbours).items():
        code = codes[memory.number(voxel)]
        assert {name for name, bit in REGIONS.items() if code & bit} == names


def test_a_pixel_has_its_voxels_regions():
    voxels = np.array([[0, -1, 2], [1, 1, -1]], np.int32)
    codes = np.array([5, 0, 7], np.uint8)
    assert region_image(voxels, codes).tolist() == [[5, 0, 7], [0, 0, 0]]
    assert region_image(voxels[:, 1:2] * 0 - 1, codes[:0]).tolist() == [[0], [0]]
