"""What viewers of a map are told: only what changed, and in the end all of it."""

from dataclasses import replace

import core_worlds as cw
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core.memory.changes import Changes
from persem_ros.core.memory.evict import drop
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.map.cloud import map_points
from persem_ros.outputs.map.mirror import matched, Mirror
from persem_ros.settings.config import Map, Refine
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_files import load_legend

LEGEND = Legend()
SETTINGS = replace(Refine(), min_observations=1)


class Listener:
    """Adds up what it is told."""

    def __init__(self):
        """Know nothing."""
        self.state, self.told = {}, 0

    def take(self, points):
        """Take the points of a message."""
        self.told += len(points)
        for k, point in enumerate(points):
            key = point['x'].item(), point['y'].item(), point['z'].item()
            self.state[key] = points[k:k + 1].tobytes()
            if point['observations'] == 0:
                del self.state[key]


def points_of(memory):
    """Return the map's points, in order."""
    return map_points(memory.voxels(), memory.voxel_size, LEGEND)


def frame_of(rng, stamp):
    """Return Observations of some voxels in a handful of blocks."""
    seen = {tuple(v): (int(rng.choice(cw.IDS)), float(rng.choice(cw.EXACT)))
            for v in rng.integers(-20, 20, (12, 3)).tolist()}
    return cw.observations(stamp, seen)


@cw.examples(max_examples=25)
@given(cw.seeds, st.sampled_from([1, 7, 100_000]), st.sampled_from([1, 5, 100_000]))
def test_what_listeners_are_told_adds_up_to_the_map(seed, most, slice_):
    rng, changes = np.random.default_rng(seed), Changes()
    memory, mirror = VoxelMemory(0.5), Mirror(0.5, LEGEND)
    listeners = [Listener()]

    def tell():
        mirror.update(changes.take(memory, (1.0, 2.0, 3.0), most))
        points = mirror.difference((1.0, 2.0, 3.0), slice_)
        for listener in listeners:
            listener.take(points)

    for stamp in range(12):
        memory.add(frame_of(rng, stamp))
        act = rng.integers(0, 6)
        if act == 0:
            refine(memory, SETTINGS)
        elif act == 1:
            live = np.flatnonzero(memory.m.blocks['near'][:memory.n_blocks, 13])
            drop(memory, live[rng.random(len(live)) < 0.3])
        elif act == 2:
            memory = VoxelMemory(0.5)
        elif act == 3:
            listeners.append(Listener())
            mirror.tell_all()
        tell()
    for _ in range(3000):
        tell()
        if mirror.complete and not mirror.waiting:
            break
    expected = points_of(memory)
    for listener in listeners:
        assert sorted(listener.state.values()) == sorted(
            expected[k:k + 1].tobytes() for k in range(len(expected)))
    assert len(mirror) == len(expected)
    assert mirror.shown((0, 0, 0), Map()).tobytes() == expected.tobytes()
    told = listeners[0].told
    tell()
    assert listeners[0].told == told


def test_only_what_differs_is_told():
    memory, mirror, changes = VoxelMemory(0.5), Mirror(0.5, LEGEND), Changes()
    memory.add(cw.observations(0, {(x, 0, 0): (1, 1.0) for x in range(40)}))
    mirror.update(changes.take(memory))
    assert len(mirror.difference((0, 0, 0), 100)) == 40
    memory.add(cw.observations(1, {(3, 0, 0): (1, 1.0)}))
    changed = changes.take(memory)
    assert len(changed.columns['label']) == 8 and changed.complete      # a block
    mirror.update(changed)
    told = mirror.difference((0, 0, 0), 100)
    assert told['observations'].tolist() == [2] and told['x'].tolist() == [1.75]
    assert len(changes.take(memory).index) == 0


def test_a_late_listener_gets_the_nearest_first():
    memory, mirror, changes = VoxelMemory(1.0), Mirror(1.0, LEGEND), Changes()
    memory.add(cw.observations(0, {(8 * x, 0, 0): (1, 1.0) for x in range(10)}))
    centre = (40.5, 0.5, 0.5)
    taken = [changes.take(memory, centre, 3) for _ in range(4)]
    assert sorted(taken[0].columns['voxel'][:, 0].tolist()) == [32, 40, 48]
    assert [len(one.index) for one in taken] == [3, 3, 3, 1]
    assert [one.complete for one in taken] == [False, False, False, True]
    for one in taken:
        mirror.update(one)
    mirror.difference(centre, 100)
    mirror.tell_all()
    assert mirror.difference(centre, 3)['x'].tolist() == [32.5, 40.5, 48.5]
    assert mirror.waiting


def test_the_map_shows_the_nearest_or_the_most_observed():
    memory, mirror, changes = VoxelMemory(1.0), Mirror(1.0, LEGEND), Changes()
    for t in range(10):
        memory.add(cw.observations(t, {(x, 0, 0): (1, 1.0) for x in range(10 - t)}))
    mirror.update(changes.take(memory))
    centre = (9.5, 0.5, 0.5)
    shown = mirror.shown(centre, Map(max_voxels=3))
    assert shown['x'].tolist() == [7.5, 8.5, 9.5]
    assert mirror.shown(centre, Map(max_voxels=3, show='observed'))['x'].tolist() == [.5, 1.5, 2.5]
    assert mirror.shown(centre, Map(min_observations=9))['x'].tolist() == [0.5, 1.5]
    assert mirror.shown(centre, Map(crop=2.1))['x'].tolist() == [7.5, 8.5, 9.5]


def test_other_colours_are_told():
    memory, mirror, changes = VoxelMemory(1.0), Mirror(1.0, LEGEND), Changes()
    memory.add(cw.observations(0, {(x, 0, 0): (x, 1.0) for x in range(3)}))
    mirror.update(changes.take(memory))
    mirror.difference((0, 0, 0), 9)
    town = load_legend('town')
    mirror.recolour(town)
    assert mirror.difference((0, 0, 0), 9).tobytes() == map_points(
        memory.voxels(), 1.0, town).tobytes()


def test_voxels_are_matched_however_far_apart_they_lie():
    far = np.array([[-2 ** 31, 0, 2 ** 31 - 1], [2 ** 31 - 1, 5, -2 ** 31], [0, 0, 0]], np.int32)
    place, there = matched(far[[2, 0]], far[:2])
    assert there.tolist() == [False, True] and place[1] == 0
    assert matched(far[:0], far)[1].shape == (0,) and not matched(far, far[:0])[1].any()
