"""Difficult regions against the reference (spec section 6)."""

import core_worlds as cw
from hypothesis import given, strategies as st
from persem_ros.core.regions import REGIONS, regions
import reference as ref


@cw.examples(max_examples=80)
@given(cw.worlds(), st.sampled_from([6, 18, 26]))
def test_as_in_the_reference(world, neighbours):
    memory, plain = cw.core_of(world), cw.reference_of(world)
    codes, entropy, rate = regions(memory, neighbours)
    for voxel, names in ref.regions(plain, neighbours).items():
        v = memory.number(voxel)
        assert {name for name, bit in REGIONS.items() if codes[v] & bit} == names
        assert abs(entropy[v] - ref.entropy(plain.share(voxel))) < 1e-6
        labels = [c for c, _, _ in plain.histories[voxel]]
        changes = sum(a != b for a, b in zip(labels, labels[1:]))
        assert abs(rate[v] - changes / max(1, len(labels) - 1)) < 1e-6
