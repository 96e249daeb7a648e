"""Maps that were merged: the flight that they are halves of; classes by name; refusals."""

from dataclasses import replace
import re

import core_worlds as cw
from hypothesis import assume, given, strategies as st
import numpy as np
from persem_ros.cli import main
from persem_ros.core.memory.capture import dump
from persem_ros.core.refine.whole import refine
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.map.merge import merge
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_class import LegendClass
import pytest
from test_store import plain

CONFIG = updated(Config(), {'refine.min_observations': 1})


def saved(path, frames, legend=None, config=CONFIG):
    """Save a map of some frames, refined; return what is in the file."""
    memory = cw.core_of(frames, config.memory.max_history)
    refine(memory, config.refine)
    store.save(path, memory, config, legend)
    return store.load(path)


def named(*names, first=0):
    """Return a Legend of some names with ids from *first* on."""
    return Legend('', tuple(LegendClass(first + k, name, (k, 0, 0), name)
                            for k, name in enumerate(names)))


def frames(*labels, first=0):
    """Return a frame a label, one voxel each."""
    return [(10 ** 9 * (first + k), {(k, 0, 0): (c, 1.0)}, [c]) for k, c in enumerate(labels)]


@cw.examples(max_examples=15)
@given(cw.worlds(most_frames=16), st.integers(1, 14))
def test_two_halves_of_a_flight_are_the_flight(tmp_path_factory, world, cut):
    # What begins with the same frame is the same flight: taken once, or refused.
    assume(cut >= len(world) or world[0] != world[cut])
    folder = tmp_path_factory.mktemp('maps')
    halves = [part for part in (world[:cut], world[cut:]) if part]
    straight = cw.core_of([])
    for k, part in enumerate(halves):
        if k:
            straight.new_session()
        for frame in part:
            straight.add(cw.observations(*frame))
    refine(straight, CONFIG.refine)
    done = merge([saved(folder / f'{k}.persem', part) for k, part in enumerate(halves)])
    refine(done.memory, CONFIG.refine)
    assert done.exact and not done.notes
    assert plain(done.memory) == plain(straight)


def test_what_is_gone_stays_gone_and_the_command_promises_nothing(tmp_path):
    one = saved(tmp_path / 'a', frames(1, 2))
    other = cw.core_of(frames(3, 4, first=9))
    other.store.passed[0], other.some_passed, other.n_gone = (7, 1, 5), True, 1
    other.m.voxels['gone'][0] = 1
    refine(other, CONFIG.refine)
    store.save(tmp_path / 'b', other, CONFIG)
    done = merge([one, store.load(tmp_path / 'b')])
    assert not done.exact and 'b was looked through' in done.notes[0]
    number = done.memory.find([[0, 0, 0]])
    assert done.memory.m.voxels['gone'][number] and not done.memory.m.voxels['gone'].sum() > 1
    kept = dump(done.memory)
    assert (kept.passed.tolist(), kept.passed_at.tolist()) == ([5, 0], [7, 0])


def test_classes_are_matched_by_name(tmp_path):
    one = saved(tmp_path / 'a', frames(1, 2), named('road', 'tree', first=1))
    two = saved(tmp_path / 'b', frames(1, 2, 3, first=9), named('tree', 'road', 'roof', first=1))
    done = merge([one, two])
    assert {c.id: c.name for c in done.legend.classes} == {1: 'road', 2: 'tree', 0: 'roof'}
    assert not done.exact
    assert [done.memory.history((x, 0, 0))[0].tolist() for x in range(3)] == [[1, 2], [2, 1], [0]]
    assert np.flatnonzero(done.memory.seen_ids).tolist() == [0, 1, 2]
    done = merge([one, two], by_id=True)
    assert done.exact
    assert [done.memory.history((x, 0, 0))[0].tolist() for x in range(3)] == [[1, 1], [2, 2], [3]]


def test_origins_that_are_whole_voxels_apart(tmp_path):
    there = replace(CONFIG, map=replace(CONFIG.map, origin=(1.5, 0.0, -0.5)))
    one = saved(tmp_path / 'a', frames(1))
    memory = cw.VoxelMemory(0.5, there.map.origin)
    memory.add(cw.observations(*frames(2, first=5)[0]))
    store.save(tmp_path / 'b', memory, there)
    done = merge([one, store.load(tmp_path / 'b')])
    assert done.memory.history((3, 0, -1))[0].tolist() == [2] and not done.exact


def test_a_session_that_is_in_both_is_taken_once(tmp_path):
    one = saved(tmp_path / 'a', frames(1, 2))
    done = merge([one, saved(tmp_path / 'b', frames(1, 2))])
    assert done.memory.n_observations == 2 and 'taken once' in done.notes[0]
    with pytest.raises(PersemError, match='the same flight mapped differently'):
        merge([one, saved(tmp_path / 'c', [*frames(1, 2), *frames(5, first=7)])])


@pytest.mark.parametrize('change, said', [
    ({'memory.voxel_size': 0.25}, 'voxel_size 0.25, .* anew with --set memory.voxel_size=0.5'),
    ({'frames.map': 'odom'}, 'frames.map odom, .* anew with --set frames.map=map'),
    ({'map.origin': [0.25, 0.0, 0.0]}, r'not whole voxels apart \(0.500 0.000 0.000\)')])
def test_voxels_that_do_not_fit_are_refused(tmp_path, change, said):
    other = updated(CONFIG, change)
    memory = cw.VoxelMemory(other.memory.voxel_size, other.map.origin)
    memory.add(cw.observations(*frames(1, first=5)[0]))
    store.save(tmp_path / 'b', memory, other)
    with pytest.raises(PersemError, match=said):
        merge([saved(tmp_path / 'a', frames(1)), store.load(tmp_path / 'b')])


@pytest.mark.parametrize('legends, said', [
    ((named('road', 'tree'), named('road')), '1: id 1 is used and has no name; --by-id'),
    ((named('road'), named('road', 'tree')), '0: id 1 is used and has no name; --by-id'),
    ((None, None, named('road', 'tree')), '0: id 0 is used and has no name; --by-id'),
    ((named('road', 'road'), named('road')), "0: 'road' is the name of id 0 and of id 1"),
    ((named('road', 'tree'), named('road', 'road')), "1: 'road' is the name of id 0 and of id 1")])
def test_legends_that_contradict_are_refused(tmp_path, legends, said):
    maps = [saved(tmp_path / str(k), frames(0, 1, first=9 * k), legend)
            for k, legend in enumerate(legends)]
    with pytest.raises(PersemError, match=said):
        merge(maps)
    assert merge(maps, legend=named('a', 'b')).legend == named('a', 'b')


def test_observations_that_are_missing(tmp_path):
    bounded = updated(CONFIG, {'memory.max_history': 1})
    many = [(k, {(0, 0, 0): (1, 1.0)}, ()) for k in range(9)]
    one, two = saved(tmp_path / 'a', frames(1)), saved(tmp_path / 'b', many, config=bounded)
    with pytest.raises(PersemError, match='b has let go of observations .*max_history 1'):
        merge([one, two])


@pytest.mark.parametrize('change, said', [
    ({'memory.dynamic_labels': [1, 7]}, 'memory.dynamic_labels is none in {0} and 1, 7 in {1}'),
    ({'memory.ignore_labels': []}, 'memory.ignore_labels is 255, 65535 in {0} and none in {1}'),
    ({'memory.max_depth': 50.0}, 'memory.max_depth is 200.0 in {0} and 50.0 in {1}'),
    ({'memory.clear_after': 3}, 'memory.clear_after is 0 in {0} and 3 in {1}'),
    ({'depth.kind': 'ray'}, 'depth.kind is z in {0} and ray in {1}'),
    ({'topics.confidence': 'c'}, 'topics.confidence is empty in {0} and c in {1}')],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else '')
def test_other_settings_are_no_one_run(tmp_path, capsys, change, said):
    files = [str(tmp_path / name) for name in 'ab']
    saved(files[0], frames(1, 2))
    saved(files[1], frames(3, first=5), config=updated(CONFIG, change))
    assert main(['map', 'merge', *files, '--out', str(tmp_path / 'c')]) == 0
    note, last = capsys.readouterr().out.splitlines()
    assert note == f'{said.format(*files)}: one run has one of them'
    assert last.endswith('c: not what one run over all recordings gives, but all that was kept')


def test_settings_that_put_nothing_into_a_map(tmp_path):
    """Labels go by the settings of the first, which is one run with these."""
    one = saved(tmp_path / 'a', frames(1, 2))
    values = {'topics.depth': 'other', 'render.fill': 'unknown', 'memory.clear_margin': 3.0,
              'memory.ignore_labels': [65535, 255], 'memory.max_history': 9, 'refine.sweep': 7,
              'refine.geometry.rounds': 5}
    two = saved(tmp_path / 'b', frames(3, first=5), config=updated(CONFIG, values))
    done = merge([one, two])
    assert done.exact and done.known and not done.notes
    three = saved(tmp_path / 'c', frames(3, first=5), config=updated(CONFIG, {'refine.eta': 0.5}))
    done = merge([one, three])
    assert done.exact and done.known and done.notes == [
        f'refine.eta is 0.3 in {one.path} and 0.5 in {three.path}: the map is refined by that of '
        f'{one.path}']


@pytest.mark.parametrize('heights, exact', [
    ('', False), ('legend: 1 -2 2', False), ('1 -2 2', True), ('none', True)])
def test_heights_that_legends_gave_are_no_one_run(tmp_path, heights, exact):
    config = updated(CONFIG, {'refine.method': 'geometry', 'refine.geometry.heights': heights})
    one = saved(tmp_path / 'a', frames(1, 2), config=config)
    two = saved(tmp_path / 'b', frames(3, first=5), config=updated(config, {
        'refine.geometry.heights': 'legend: 3 1 9'}))
    done = merge([one, two])
    assert done.exact == exact and done.notes[0].startswith('refine.geometry.heights is ')


def test_settings_name_classes_by_the_legends(tmp_path):
    car, van = (updated(CONFIG, {'memory.dynamic_labels': [c]}) for c in (2, 3))
    one = saved(tmp_path / 'a', frames(1), named('road', 'car', first=1), car)
    two = saved(tmp_path / 'b', frames(1, first=5), named('road', 'van', 'car', first=1), van)
    assert merge([one, two]).exact
    done = merge([one, two], by_id=True)
    assert not done.exact and 'is 2 (car) in ' in done.notes[0] and '3 (car)' in done.notes[0]
    two = saved(tmp_path / 'c', frames(1, first=5), named('road', 'van', first=1), car)
    assert not merge([one, two]).exact      # its 2 is another class


def test_what_a_file_does_not_know_was_not_compared(tmp_path, capsys):
    files = [str(tmp_path / name) for name in 'abcd']
    one, two = saved(files[0], frames(1, 2)), saved(files[1], frames(3, first=5))
    less = replace(two, settings=re.sub(r'\n +stride: .*', '', two.settings))
    assert less.settings != two.settings
    done = merge([one, less])
    assert done.exact and not done.known and done.notes == [
        f'{less.path} does not say memory.stride, which was not compared']
    assert main(['map', 'merge', *files[:2], '--out', files[2]]) == 0
    saved(files[3], frames(5, first=20))
    assert main(['map', 'merge', *files[2:], '--out', str(tmp_path / 'e')]) == 0
    note, last = capsys.readouterr().out.splitlines()[1:]
    assert note.startswith(f'{files[2]} has 2 sessions and the settings of its last run alone')
    assert last.endswith(': equal to one run over all recordings, as far as their settings are '
                         'known')


def test_more_observations_than_one_run_keeps(tmp_path):
    bounded = updated(CONFIG, {'memory.max_history': 3})
    one, two = (saved(tmp_path / str(t), [(t + k, {(0, 0, 0): (1, 1.0)}, [1]) for k in range(2)],
                      config=bounded) for t in (0, 9))
    done = merge([one, two])
    assert not done.exact and done.notes == [
        'voxels have up to 4 observations, of which one run with memory.max_history 3, as in '
        f'{one.path}, keeps the newest']


def test_one_session_is_no_sessions(tmp_path, capsys):
    files = [str(tmp_path / name) for name in 'ab']
    saved(files[0], frames(1, 2)), saved(files[1], frames(1, 2))
    assert main(['map', 'merge', *files, '--out', str(tmp_path / 'c')]) == 0
    assert ', 1 session in ' in capsys.readouterr().out


def test_the_command(tmp_path, capsys):
    files = [str(tmp_path / name) for name in 'ab']
    saved(files[0], frames(1, 2)), saved(files[1], frames(3, first=5))
    out = str(tmp_path / 'c')
    assert main(['map', 'merge', *files, '--out', out]) == 0
    assert capsys.readouterr().out == (f'2 voxels, 3 observations, 2 sessions in {out}: equal to '
                                       'one run over all recordings\n')
    assert store.load(out).saved.frames.session.tolist() == [0, 0, 1]
    for arguments, said in (([*files, '--out', out], 'exists'),
                            ([*files, '--out', files[0]], 'is one of the maps'),
                            ([files[0], '--out', out], 'expected two files')):
        assert main(['map', 'merge', *arguments]) == 1
        assert said in capsys.readouterr().err
    assert main(['map', 'merge', *files, '--out', out, '--force']) == 0


@cw.examples(max_examples=10)
@given(cw.seeds, st.integers(0, 2))
def test_what_was_merged_can_be_forgotten(tmp_path_factory, seed, number):
    folder, rng = tmp_path_factory.mktemp('maps'), np.random.default_rng(seed)
    parts = [[(100 * k + t, {tuple(v): (int(rng.choice(cw.IDS)), float(rng.choice(cw.EXACT)))
                             for v in rng.integers(-4, 4, (9, 3)).tolist()}, ())
              for t in range(4)] for k in range(3)]
    files = [str(folder / f'{k}.persem') for k in range(3)]
    for file, part in zip(files, parts):
        saved(file, part)
    out, others = str(folder / 'all.persem'), [f for k, f in enumerate(files) if k != number]
    assert main(['map', 'merge', *files, '--out', out]) == 0
    assert main(['map', 'forget', out, '--session', str(number)]) == 0
    assert main(['map', 'merge', *others, '--out', str(folder / 'two.persem')]) == 0
    assert (folder / 'all.persem').read_bytes() == (folder / 'two.persem').read_bytes()


def test_sessions_that_cannot_be_forgotten(tmp_path, capsys):
    path = tmp_path / 'a'
    saved(path, frames(1, 2))
    lock = WriterLock(path)
    assert main(['map', 'forget', str(path), '--session', '0']) == 1
    assert 'is being written by' in capsys.readouterr().err
    lock.close()
    for number, said in ((3, 'has no session 3; it has 0'), (0, 'no other session than 0')):
        assert main(['map', 'forget', str(path), '--session', str(number)]) == 1
        assert said in capsys.readouterr().err
