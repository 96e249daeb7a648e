"""Dropping far blocks in random worlds, against a reference that forgets the same voxels."""

from dataclasses import replace

from core_worlds import columns_of, examples, observations, refinements, worlds
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import stored_observations, VoxelMemory
from persem_ros.core.refine.regions import regions
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import METHODS
import reference as ref

EDGE = 4.0      # of a block of 8 voxels, metres


class Forgetful(ref.Memory):
    """The reference with volatility counters that outlive the voxels that they counted."""

    def __init__(self):
        """Start empty."""
        super().__init__()
        self.starts, self.changes, self.added = {}, {}, 0

    def add(self, seen, stamp, ids=()):
        """Count pairs as they come."""
        self.added += len(seen)
        for voxel, (c, _) in seen.items():
            for before in self.histories.get(voxel, [])[-1:]:
                self.starts[before.c] = self.starts.get(before.c, 0) + 1
                self.changes[before.c] = self.changes.get(before.c, 0) + (before.c != c)
        super().add(seen, stamp, ids)

    def volatility(self):
        """Return rho from the counters."""
        return {c: self.changes[c] / n for c, n in self.starts.items()}


def distance(voxel, position):
    """Return how far the middle of a voxel's block is from a position, metres."""
    middle = (np.array([x >> 3 for x in voxel]) + 0.5) * EDGE
    return float(np.linalg.norm(middle - position))


def forget(memory, expected, position, radius, most):
    """Drop in both memories; check that the right ones went."""
    before = {v: distance(v, position) for v in expected.histories}
    gone = keep_near(memory, position, radius, most)
    left = set(columns_of(memory))
    assert gone == len(before) - len(left) and left <= set(before)
    lost = set(before) - left
    assert {v for v in before if radius and before[v] > radius} <= lost
    if not most or len(before) <= most:
        assert all(radius and before[v] > radius for v in lost)
    else:
        assert len(left) <= most
        assert max((before[v] for v in left), default=0) <= min(before[v] for v in lost)
    for voxel in lost:
        del expected.histories[voxel]


@given(worlds(most_frames=20, repeats=False), refinements(), st.sampled_from(METHODS[:-1]),
       st.sampled_from([0, 3, 8]), st.randoms(use_true_random=False))
@examples(max_examples=120)
def test_random_worlds(frames, settings, method, bound, random):
    settings = replace(settings, method=method)
    memory, expected = VoxelMemory(0.5, max_history=bound), Forgetful()
    corner = np.array(next((v for _, seen, _ in frames for v in seen), (0, 0, 0))) * 0.5
    for stamp, seen, ids in frames:
        memory.add(observations(stamp, seen, ids))
        expected.add(seen, stamp, ids)
        if random.random() < 0.4:
            position = corner + [random.uniform(-4, 4) for _ in range(3)]
            forget(memory, expected, position, random.choice([0.0, 3.0, 4.5, 6.0]),
                   random.choice([0, 0, 2, 8, 15]))
        if random.random() < 0.5:
            refine(memory, settings, full=random.random() < 0.3)
            rho = {int(c): float(memory.rho[c]) for c in np.flatnonzero(memory.rho)}
            assert columns_of(memory) == ref.label(expected, method, settings, bound, rho)
        assert memory.n_voxels == len(expected.histories)
    assert memory.n_observations == expected.added
    rho = memory.volatility()
    assert {int(c): rho[c] for c in np.flatnonzero(rho)} == {
        c: x for c, x in expected.volatility().items() if x}
    for voxel, history in expected.histories.items():
        kept = [(int(c), float(s), int(t)) for c, s, t in zip(*memory.history(voxel))]
        assert kept == history[-bound:]
        assert memory.evidence(voxel) == expected.evidence(voxel)
    if not bound:
        assert stored_observations(memory) == sum(map(len, expected.histories.values()))
    numbers = memory.voxels()['number']
    assert len(set(numbers.tolist())) == len(numbers) <= memory.n_numbers
    assert memory.find(memory.voxels()['voxel']).tolist() == numbers.tolist()
    names = ref.regions(expected, settings.neighbours)
    codes = regions(memory, settings.neighbours)[0]
    assert {v: bool(codes[n] & 1) for v, n in zip(map(
        tuple, memory.voxels()['voxel'].tolist()), numbers)} == {
            v: 'boundary' in found for v, found in names.items()}
    again = load(dump(memory))
    refine(again, settings)
    refine(memory, settings)
    assert columns_of(again) == columns_of(memory)
