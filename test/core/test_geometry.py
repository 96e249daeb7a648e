"""The method geometry against its plain reference (section 12 of the specification)."""

from dataclasses import replace

from core_worlds import core_of, examples, observations
import geometry_reference as plain
from hypothesis import given, strategies as st
import numpy as np
from persem_ros.core import jit
from persem_ros.core.geometry.account import account
from persem_ros.core.geometry.ground import (
    ground_of, level_of, NONE, TILE, tiles_around, tiles_of, windowed_minimum)
from persem_ros.core.geometry.kept import sound
from persem_ros.core.geometry.labelling import label_rows
from persem_ros.core.geometry.method import places_of, relabel
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.evict import keep_near
from persem_ros.core.memory.loading import load
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.explain import explain, quickly
from persem_ros.core.refine.job import finish
from persem_ros.core.refine.labelled import label
from persem_ros.core.refine.rules import at_rest, swept
from persem_ros.core.refine.snapshot import take
from persem_ros.core.refine.turns import begin_next
from persem_ros.core.refine.whole import refine
from persem_ros.settings.config import Geometry, Refine
import pytest

SIZE = 0.5
ORIGIN = (3.0, -20.0, 7.5)
GEOMETRY = replace(Refine(), method='geometry')


def world(rng, kind, corner):
    """Return the voxels (n, 3) of a scene of some kind, around a corner."""
    n = int(rng.integers(3, 9))
    square = np.stack(np.meshgrid(np.arange(n), np.arange(n), [0]), -1).reshape(-1, 3)
    line = np.zeros((n, 3), int)
    line[:, 2] = np.arange(n)
    found = {'flat': square,
             'wall': square[:, [0, 2, 1]],
             'slope': square + square[:, :1] * [0, 0, 1],
             'pole': np.concatenate([square, line + [1, 1, 1]]),
             'wire': np.concatenate([square[square[:, 0] != 1], line[:, [2, 0, 1]] + [0, 2, 9]]),
             'cloud': np.argwhere(rng.random((n, n, n)) < 0.3),
             'far columns': np.concatenate([square, square + [24, 3, 6], square - [0, 45, 2]]),
             'one': np.zeros((1, 3), int)}[kind]
    return np.unique(np.concatenate([found, np.zeros((1, 3), int)]) + corner, axis=0)


KINDS = ('flat', 'wall', 'slope', 'pole', 'wire', 'cloud', 'far columns', 'one')
CORNERS = ((0, 0, 0), (-3, 5, -2), (-40, 7, 6), (10 ** 6, -10 ** 6, -1))


@st.composite
def flights(draw, ids=None, kinds=KINDS):
    """
    Draw frames over a scene.

    Returns
    -------
    list of (stamp, dict, tuple)
        Per frame the stamp, {voxel: (c, s)} and the sensor's position in the map: anywhere,
        within a voxel, or straight along an axis from one.

    """
    rng = np.random.default_rng(draw(st.integers(0, 2 ** 32 - 1)))
    voxels = world(rng, draw(st.sampled_from(kinds)), draw(st.sampled_from(CORNERS)))
    ids = ids or [int(c) for c in rng.permutation([0, 1, 2, 7, 300, 65534])[
        :draw(st.integers(1, 6))]]
    shares = draw(st.sampled_from([(1.0,), (0.5, 1.0), (0.25, 0.4, 2 / 3, 1.0)]))
    rate, where = draw(st.sampled_from([0.1, 0.5, 1.0])), draw(st.integers(0, 2))
    habit = rng.choice(ids, len(voxels))
    frames = []
    for stamp in range(draw(st.integers(1, 12))):
        sensor = (voxels.mean(axis=0) + 0.5) * SIZE + np.array(ORIGIN)
        if where == 0 or rng.random() < 0.3:
            sensor += rng.normal(scale=4.0, size=3)
        else:
            sensor = (voxels[rng.integers(len(voxels))] + 0.5) * SIZE + np.array(ORIGIN)
            sensor += SIZE * (where == 2) * rng.integers(-3, 4) * np.eye(3)[rng.integers(3)]
        seen = {tuple(v): (int(c if rng.random() < 0.6 else rng.choice(ids)),
                           float(np.float32(rng.choice(shares))))
                for v, c in zip(voxels.tolist(), habit) if rng.random() < rate}
        frames.append((stamp, seen, tuple(sensor.tolist())))
    return frames


def memory_of(frames, max_history=0):
    """Return the core's memory of frames."""
    memory = VoxelMemory(SIZE, ORIGIN, max_history)
    for frame in frames:
        memory.add(memory_frame(*frame))
    return memory


def memory_frame(stamp, seen, sensor):
    """Return the Observations of a frame."""
    T = np.eye(4)
    T[:3, 3] = sensor
    return replace(observations(stamp, seen), T_map_sensor=T)


def histories_of(frames):
    """Return the reference's histories of frames."""
    found = {}
    for _, seen, sensor in frames:
        for voxel, (c, s) in seen.items():
            found.setdefault(voxel, []).append((c, s, sensor))
    return found


def assert_alike(memory, wanted, confident=1e-6):
    """Hold a refined map against the reference's result."""
    columns = memory.voxels()
    row = {tuple(v): i for i, v in enumerate(columns['voxel'].tolist())}
    assert set(row) == set(wanted.voxels)
    order = [row[v] for v in wanted.voxels]
    top = np.sort(wanted.posterior, axis=1)[:, ::-1]
    gap = top[:, 0] - top[:, 1] if top.shape[1] > 1 else np.ones(len(top))
    clear = (gap < 1e-11) | (gap > 1e-7)        # else rounding may tip the scales
    labels = columns['label'][order]
    assert (labels == wanted.labels)[clear].all()
    place = {c: z for z, c in enumerate(wanted.classes)}
    own = wanted.posterior[np.arange(len(order)), [place[int(c)] for c in labels]]
    assert np.abs(columns['confidence'][order] - own).max() <= confident
    assert (columns['source'][order] == np.where(
        labels == columns['majority'][order], 0, 4)).all()


SETTINGS = st.sampled_from([
    Geometry(), Geometry(), Geometry(directions=2), Geometry(directions=32, cell=2),
    Geometry(window=0, cell=5), Geometry(window=3, cell=9), Geometry(weight=0.0),
    Geometry(smoothing=0.0, rounds=1), Geometry(prior=1.0, shrink=1.0, rounds=5),
    Geometry(groups='shapes'), Geometry(groups='cells', prior=2.0),
    Geometry(heights='1 -1 1; 3 2 inf'), Geometry(heights='0 1 4; 2 -inf 0', groups='cells')])
UPS = st.sampled_from(['z', 'z', 'x', 'y', '-x', '-y', '-z'])


@given(flights(), SETTINGS, UPS, st.sampled_from([0, 0, 1, 3]))
@examples(max_examples=80)
def test_as_the_reference(frames, constants, up, bound):
    memory, histories = memory_of(frames, bound), histories_of(frames)
    settings = replace(GEOMETRY, up=up, geometry=constants)
    assert refine(memory, settings) == len(histories)
    if histories:
        wanted = plain.geometry(histories, SIZE, ORIGIN, up, bound, constants)
        assert_alike(memory, wanted)
        assert memory.geometry.rho == pytest.approx(wanted.parameters.rho, abs=1e-8)
        assert np.abs(memory.geometry.theta - wanted.parameters.theta).max() < 1e-6


@given(st.integers(0, 2 ** 32 - 1), st.sampled_from([0, 1, 2, 7, 8, 20, 41]),
       st.integers(1, 60))
@examples(max_examples=60)
def test_the_least_of_a_window_of_columns(seed, window, spread):
    rng = np.random.default_rng(seed)
    columns = np.unique(rng.integers(-spread, spread, (int(rng.integers(1, 40)), 2)), axis=0)
    values = rng.integers(-99, 99, len(columns))
    tiles, tile = tiles_of(np.c_[columns >> 3, columns[:, :1]].astype(np.int32))
    grid = np.full((len(tiles), TILE), NONE, np.int32)
    place = (columns[:, 0] & 7) * 8 + (columns[:, 1] & 7)
    grid[tile, place] = values
    wanted = np.flatnonzero(rng.random(len(tiles)) < rng.choice([0.3, 1.1]))
    found = windowed_minimum(tiles_around(tiles, window), grid, window, wanted)[tile, place]
    asked = np.isin(tile, wanted)
    near = np.abs(columns[:, None] - columns[None]).max(axis=2) <= window
    assert found[asked].tolist() == [values[row].min() for row in near[asked]]
    whole = ground_of(tiles, grid, window).level
    assert (level_of(tiles, grid, window, wanted) == whole[wanted]).all()


@given(flights(), UPS)
@examples(max_examples=40)
def test_shapes_are_the_references(frames, up):
    memory = memory_of(frames)
    if not memory.n_voxels:
        return
    taken = take(memory)
    places = places_of(memory, taken, replace(GEOMETRY, up=up))
    upright = np.array([plain.upright(v, up) for v in taken.index.tolist()])
    assert (places.index == upright).all()
    heights, _, _, groups = plain.shapes(upright)
    column = (upright[:, 0] & 7) * 8 + (upright[:, 1] & 7)
    assert (upright[:, 2] - places.ground.level[places.tile, column] == heights).all()
    assert places.shape.tolist() == [b1 % 12 for b1, _, _ in groups]


def assert_as_whole(memory, settings):
    """Hold a map's labels against those of the whole map by the same parameters."""
    taken = take(memory)
    wanted = relabel(memory, taken, settings, memory.geometry)
    record, belief = memory.m.voxels[taken.number], memory.store.beliefs[taken.number]
    assert (record['label'] == wanted.labels).all()
    assert (record['source'] == wanted.sources).all()
    assert (belief['posterior'] == wanted.posterior).all()


def advance(memory, settings, fresh=False):
    """Refine what is next in turn, as a node does; return how many voxels were visited."""
    job = begin_next(memory, settings, fresh)
    return finish(job, *job.compute())


def refine_everywhere(memory, settings):
    """Refine all of a map afresh, as ~/refine does; return how many voxels were visited."""
    visited = advance(memory, settings, fresh=True)
    while not swept(memory, settings):
        visited += advance(memory, settings)
    return visited


@given(flights(), SETTINGS, UPS, st.sampled_from([0, 0, 2]), st.integers(0, 11))
@examples(max_examples=60)
def test_an_increment_equals_the_whole_by_the_same_parameters(frames, constants, up, bound, cut):
    settings = replace(GEOMETRY, up=up, geometry=constants)
    memory = memory_of(frames[:cut], bound)
    refine(memory, settings)
    for stamp, seen, sensor in frames[cut:]:
        memory.add(memory_frame(stamp, seen, sensor))
        before = memory.geometry
        refine(memory, settings, full=False)
        if memory.geometry is not None and memory.n_voxels:
            assert_as_whole(memory, settings)
            known = before is not None and not {
                c for c, _ in seen.values()} - set(before.classes.tolist())
            assert memory.geometry is before or not known


def narrow_flight(n_frames=7):
    """Return frames of a strip that goes on over big_flight()'s ground, and digs a pit late."""
    frames = []
    for stamp, seen, sensor in big_flight(5, n_frames=n_frames):
        seen = {v: o for v, o in seen.items() if 0 <= v[0] + 20 - 7 * stamp < 16}
        if stamp == n_frames - 1:
            seen[7 * stamp - 18, 0, -9] = (1, 1.0)
        frames.append((stamp, seen, sensor))
    return frames


@pytest.mark.parametrize('up', ['z', '-z', 'x', '-y'])
def test_increments_of_a_large_map(up):
    settings = replace(GEOMETRY, up=up, geometry=Geometry(window=9, cell=16))
    frames = narrow_flight()
    memory = memory_of(frames[:3])
    refine(memory, settings)
    parameters = memory.geometry
    for frame in frames[3:]:
        memory.add(memory_frame(*frame))
        visited = refine(memory, settings, full=False)
        assert memory.geometry is parameters and 0 < visited < memory.n_voxels
        assert_as_whole(memory, settings)
    assert refine(memory, settings, full=False) == 0
    assert keep_near(memory, (0.0, -20.0, 7.5), radius=12.0) > 0
    for frame in frames[-2:]:
        refine(memory, settings, full=False)
        assert_as_whole(memory, settings)
        memory.add(memory_frame(*frame))


@pytest.mark.parametrize('form', ['dense', 'sparse'])
def test_sweeps_estimate_the_parameters_anew(form, monkeypatch):
    if form == 'sparse':
        for name in ('geometry.method', 'geometry.looks', 'geometry.totals', 'refine.gathered'):
            monkeypatch.setattr(f'persem_ros.core.{name}.MOST_DENSE', 0)
    settings = replace(GEOMETRY, sweep=300, geometry=Geometry(cell=16))
    frames = narrow_flight()
    memory = memory_of(frames[:2])
    refine_everywhere(memory, settings)
    first = memory.geometry
    for frame in frames[2:]:
        memory.add(memory_frame(*frame))
        advance(memory, settings)
    for _ in range(60):
        if at_rest(memory, settings):
            break
        advance(memory, settings)
    assert at_rest(memory, settings) and advance(memory, settings) == 0
    assert (memory.geometry.pi != first.pi).any()
    assert_as_whole(memory, settings)
    memory.rho_of = -1          # as if something had been seen: one sweep more, one round
    advance(memory, settings)
    while not memory.sweep.ended:
        advance(memory, settings)
    taken = take(memory)
    whole = relabel(memory, replace(taken, swept=taken.refined), settings, memory.geometry)
    assert memory.tally.voxels == memory.n_voxels
    assert (memory.tally.sums.mass == whole.sums.mass).all()
    assert memory.tally.sums.agreement == whole.sums.agreement
    assert refine_everywhere(memory, settings) == memory.n_voxels       # ~/refine
    straight = memory_of(frames)
    refine(straight, settings)          # a replay
    assert straight.geometry.pi.tolist() == memory.geometry.pi.tolist()
    assert (straight.voxels()['confidence'] == memory.voxels()['confidence']).all()


@pytest.mark.parametrize('form', ['dense', 'sparse'])
def test_parameters_outlive_a_dump(form, monkeypatch):
    if form == 'sparse':
        monkeypatch.setattr('persem_ros.core.geometry.method.MOST_DENSE', 0)
    frames = narrow_flight()
    memory = memory_of(frames[:3])
    refine(memory, GEOMETRY)
    saved = dump(memory)
    assert sound(saved.habits)
    again = load(saved)
    assert {k: a.tolist() for k, a in dump(again).habits.items()} == {
        k: a.tolist() for k, a in saved.habits.items()}
    for one in (memory, again):
        one.add(memory_frame(*frames[3]))
        refine(one, GEOMETRY, full=False)
    assert again.geometry.rho == memory.geometry.rho
    assert again.voxels()['confidence'].tobytes() == memory.voxels()['confidence'].tobytes()
    for name in saved.habits:
        assert not sound({k: a for k, a in saved.habits.items() if k != name})
        assert not sound({**saved.habits, name: saved.habits[name].astype('c16')})


def test_voxels_that_moved_away_are_no_part_of_the_world():
    frames = [(t, {v: o for v, o in seen.items() if v[2] < -1}, sensor)
              for t, seen, sensor in big_flight(6, side=20)]
    towers = [(t, {v: o for v, o in seen.items() if v[2] >= -1}, sensor)
              for t, seen, sensor in big_flight(6, side=20)]
    memory = memory_of([(t, {**a, **b}, s) for (t, a, s), (_, b, _) in zip(frames, towers)])
    refine(memory, GEOMETRY)
    gone = memory.find(np.array(sorted({v for _, seen, _ in towers for v in seen}), np.int32))
    memory.m.voxels['gone'][gone] = 1
    memory.n_gone = len(gone)
    memory.m.stamps['evidence'][:memory.n_blocks] = memory.clock + 1
    without = memory_of(frames)
    for one in (memory, without):
        refine(one, GEOMETRY)
    ours, theirs = memory.voxels(), without.voxels()
    left = ~np.isin(ours['number'], gone)
    assert (ours['voxel'][left] == theirs['voxel']).all() and len(gone)
    assert (ours['confidence'][left] == theirs['confidence']).all()


def big_flight(seed=0, side=60, classes=5, n_frames=12):
    """Return frames over a rough plane with towers, large enough for several slices."""
    rng = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing='ij')
    ground = np.stack([i, j, (i // 16) % 2], -1).reshape(-1, 3)
    towers = np.stack(np.meshgrid(np.arange(10, 18), np.arange(20, 30), np.arange(2, 9)),
                      -1).reshape(-1, 3)
    voxels = np.concatenate([ground, towers]) - [20, 30, 4]
    habit = np.where(voxels[:, 2] > -2, 1, (voxels[:, 0] // 9) % classes)
    frames = []
    for stamp in range(n_frames):
        kept = rng.random(len(voxels)) < 0.6
        labels = np.where(rng.random(len(voxels)) < 0.4, rng.integers(0, classes, len(voxels)),
                          habit)
        shares = rng.choice([0.4, 2 / 3, 1.0], len(voxels)).astype(np.float32)
        frames.append((stamp, {tuple(v): (int(c), float(s)) for v, c, s in zip(
            voxels[kept].tolist(), labels[kept], shares[kept])},
            (2.0 * stamp - 10, 1.0 * stamp, 20.0)))
    return frames


def test_the_same_bytes_for_any_order_of_frames_and_number_of_threads():
    frames, results, before = big_flight(), [], jit.threads()
    try:
        for threads, order in ((1, 1), (2, 1), (7, -1), (2, 5)):
            jit.set_threads(threads)
            shuffled = frames[::order] if order < 2 else frames[order:] + frames[:order]
            memory = memory_of(shuffled)
            refine(memory, GEOMETRY)
            columns = memory.voxels()
            results.append([columns[name].tobytes() for name in ('voxel', 'label', 'confidence')]
                           + [a.tobytes() for a in (memory.geometry.theta, memory.geometry.pi)])
    finally:
        jit.set_threads(before)
    assert results[1:] == results[:1] * 3


@pytest.mark.parametrize('buffer', [1, 1 << 19])
def test_the_same_bytes_in_slices(buffer, monkeypatch):
    memory = memory_of(big_flight())
    taken = take(memory)
    whole = relabel(memory, taken, GEOMETRY)
    monkeypatch.setattr('persem_ros.core.geometry.labelling.SLICE', 700)
    monkeypatch.setattr('persem_ros.core.geometry.method.label_rows',
                        lambda *arguments: label_rows(*arguments, buffer=buffer))
    sliced = relabel(memory, taken, GEOMETRY)
    assert [a.tobytes() for a in whole[:3]] == [a.tobytes() for a in sliced[:3]]


def test_labelling_without_entering_is_the_same():
    memory = memory_of(big_flight(1, side=20))
    labels, sources = label(memory, 'geometry', GEOMETRY)
    assert not memory.store.beliefs['posterior'][:memory.n_numbers].any()
    refine(memory, GEOMETRY)
    columns = memory.voxels()
    assert (labels[columns['number']] == columns['label']).all()
    assert (sources[columns['number']] == columns['source']).all()
    assert 4 in columns['source'] and (columns['confidence'] > 0).all()


def test_another_method_takes_the_posteriors_back():
    memory = memory_of(big_flight(2, side=12))
    refine(memory, replace(Refine(), method='majority'))
    shares = memory.voxels()['confidence']
    refine(memory, GEOMETRY)
    assert (memory.voxels()['confidence'] != shares).any()
    refine(memory, replace(Refine(), method='majority'), full=False)
    assert (memory.voxels()['confidence'] == shares).all()


@given(flights(), SETTINGS, st.sampled_from([0, 2]))
@examples(max_examples=50)
def test_the_sparse_form_as_the_reference(frames, constants, bound):
    # Two candidates by shape in place of sixteen, so that six classes are many.
    memory, histories = memory_of(frames, bound), histories_of(frames)
    if not histories:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('persem_ros.core.geometry.method.MOST_DENSE', 0)
        patch.setattr('persem_ros.core.geometry.sparse_parameters.LIKELY', 2)
        patch.setattr(plain, 'CANDIDATES', 2)
        settings = replace(GEOMETRY, geometry=constants)
        refine(memory, settings)
        wanted = plain.geometry(histories, SIZE, ORIGIN, 'z', bound, constants, dense=0)
    assert_alike(memory, wanted)
    assert memory.geometry.rho == pytest.approx(wanted.parameters.rho, abs=1e-8)


def test_more_than_64_classes():
    frames = big_flight(3, side=16, classes=90)
    memory = memory_of(frames)
    refine(memory, GEOMETRY)
    wanted = plain.geometry(histories_of(frames), SIZE, ORIGIN)
    assert len(wanted.classes) > 64
    assert_alike(memory, wanted)
    before = jit.threads()
    try:
        jit.set_threads(7)
        again = memory_of(frames[::-1])
        refine(again, GEOMETRY)
    finally:
        jit.set_threads(before)
    assert again.voxels()['confidence'].tobytes() == memory.voxels()['confidence'].tobytes()


@pytest.mark.parametrize('form', ['dense', 'sparse'])
def test_an_account_of_a_voxel_is_the_references(form, monkeypatch):
    if form == 'sparse':
        monkeypatch.setattr('persem_ros.core.geometry.method.MOST_DENSE', 0)
    frames = big_flight(4, side=12)
    memory = memory_of(frames)
    refine(memory, GEOMETRY)
    wanted = plain.geometry(histories_of(frames), SIZE, ORIGIN)
    for row in range(0, len(wanted.voxels), 61):
        trace = explain(memory, wanted.voxels[row], GEOMETRY)
        found = trace['geometry']
        assert trace['label'] == trace['stored_label'] == wanted.labels[row]
        assert trace['source'] == trace['stored_source']
        assert found['posterior'] == pytest.approx(
            dict(zip(wanted.classes, wanted.posterior[row])), abs=1e-6)
        assert found['height'] == wanted.shape[0][row]
        assert sum(found['votes'].values()) == pytest.approx(1.0)
        for part in ('shape', 'cell', 'shifted_cell', 'frequencies'):
            assert sum(found[part].values()) == pytest.approx(1.0), part
        number = memory.number(wanted.voxels[row])
        whole = account(memory, take(memory), number, GEOMETRY, memory.geometry)
        assert quickly(memory, wanted.voxels[row], GEOMETRY) and found == whole
    seen = {(500, 0, 0): (1, 1.0), (-20, -30, -4): (2, 1.0)}
    memory.add(memory_frame(99, seen, (0.0, 0.0, 9.0)))
    assert not quickly(memory, (500, 0, 0), GEOMETRY)       # newer than the last refinement
    assert quickly(memory, (-20, -30, -4), GEOMETRY)


@pytest.mark.parametrize('first, then', [((1, 2), (2, 3)), ((2, 5), (1, 2))])
def test_classes_that_come_later_are_numbered_anew(first, then):
    frames = [(10 * k, {(i, j, 0): (ids[(i + j + k) % 2], 0.75) for i in range(5)
                        for j in range(5)}) for k, ids in enumerate([first] * 3 + [then] * 3)]
    grown = core_of(frames[:3])
    refine(grown, GEOMETRY)
    for frame in frames[3:]:
        grown.add(observations(*frame))
        refine(grown, GEOMETRY, full=False)
    assert grown.geometry.classes.tolist() == sorted({*first, *then})
    refine(grown, GEOMETRY)
    whole = core_of(frames)
    wanted = label(whole, 'geometry', GEOMETRY)[0]
    assert (grown.m.voxels['label'][:grown.n_numbers] == wanted).all()
