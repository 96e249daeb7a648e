"""A save never costs a map: empty ones, several at once, folders that are none, two Ctrl-C."""

from concurrent.futures import ThreadPoolExecutor
import signal

import bags
import harness
from harness import Player, until
import numpy as np
from persem_ros.outputs.map import store
import pytest
from test_live_equals_replay import replayed
from test_services import set_path

FRAMES = 6


@pytest.fixture
def saved(tmp_path):
    """Return a map file of an earlier run."""
    replayed(bags.write(tmp_path / 'first', FRAMES), tmp_path / 'replay')
    return tmp_path / 'replay' / 'map.persem'


def asides(path):
    """Return what was moved aside."""
    return sorted(path.parent.glob(f'{path.name}.2*'))


def test_nothing_arrives_and_the_old_map_stays(ros, saved):
    before = saved.read_bytes()
    mapper = ros.mapper({'map.path': str(saved), 'map.save': True}).ready()
    assert 'moves it aside' in mapper.output and '-p map.load:=true' in mapper.output
    done, said = mapper.call('save_map')
    assert not done and 'the map is empty' in said
    assert mapper.stop() == 0, mapper.output
    assert 'nothing was mapped' in mapper.output
    assert saved.read_bytes() == before and not asides(saved)


@pytest.mark.parametrize('ending', [signal.SIGINT, signal.SIGTERM])
def test_a_map_that_began_without_the_file_moves_it_aside(ros, tmp_path, saved, ending):
    before = saved.read_bytes()
    mapper = ros.mapper({'map.path': str(saved), 'map.save': True}).ready()
    Player(ros.client, bags.write(tmp_path / 'second', FRAMES + 2)).play()
    mapper.frames(FRAMES + 2)
    for _ in range(2):                  # twice is not worse than once
        mapper.signal(ending)
    assert mapper.wait() == 0, mapper.output
    assert 'Traceback' not in mapper.output and 'context is invalid' not in mapper.output
    assert len(store.load(saved).saved.frames) == FRAMES + 2
    aside, = asides(saved)
    assert aside.read_bytes() == before and aside.name in mapper.output


def test_a_map_that_goes_on_with_the_file_takes_its_place(ros, tmp_path, saved):
    mapper = ros.mapper({'map.path': str(saved), 'map.load': True, 'map.save': True}).ready()
    Player(ros.client, bags.write(tmp_path / 'second', FRAMES)).play()
    mapper.frames(FRAMES)
    assert mapper.call('save_map')[0] and mapper.call('save_map')[0]
    assert not asides(saved)
    assert mapper.call('reset')[0]      # from here on it does not contain the file
    Player(ros.client, bags.write(tmp_path / 'third', 2)).play()
    mapper.frames(FRAMES + 2)
    done, said = mapper.call('save_map')
    aside, = asides(saved)
    assert done and aside.name in said
    assert len(store.load(aside).saved.frames) == 2 * FRAMES
    assert len(store.load(saved).saved.frames) == 2
    assert mapper.stop() == 0 and len(asides(saved)) == 1


def test_a_map_that_has_let_go_of_voxels_moves_the_file_aside(ros, tmp_path, saved):
    held = len(store.load(saved).saved.cell)
    mapper = ros.mapper({'map.path': str(saved), 'map.load': True,
                         'memory.max_voxels': held // 2}).ready()
    Player(ros.client, bags.write(tmp_path / 'second', FRAMES)).play()
    until(lambda: int(mapper.values().get('forgotten voxels', 0)) > 0, mapper.values)
    assert mapper.call('save_map')[0]
    aside, = asides(saved)
    assert len(store.load(aside).saved.cell) == held


def test_two_who_save_at_once_are_both_served(ros, tmp_path):
    path = tmp_path / 'map.persem'
    mapper = ros.mapper({'map.path': str(path)}).ready()
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    voxels = int(mapper.values()['voxels'])
    other = harness.Client(ros.domain)
    try:
        with ThreadPoolExecutor(2) as both:
            for _ in range(4):
                answers = [both.submit(who.call, '/mapper/save_map')
                           for who in (ros.client, other)]
                for answer in answers:
                    assert answer.result().success, answer.result().message
                    assert answer.result().message == f'saved {voxels} voxels to {path}'
                assert len(store.load(path).saved.cell) == voxels
    finally:
        other.close()
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith('map.persem')] == \
        ['map.persem']


@pytest.mark.parametrize('path, words', [
    ('', 'map.save needs a file: -p map.path:='),
    ('/dev/full/map.persem', '/dev/full is not a folder'),
    ('/proc/map.persem', '/proc/map.persem cannot be written'),
    ('/tmp', '/tmp is a folder')])
def test_a_path_that_cannot_be_saved_to_is_refused_at_the_start(ros, path, words):
    mapper = ros.mapper({'map.path': path, 'map.save': True})
    assert mapper.wait() == 1
    assert words in mapper.output and 'Traceback' not in mapper.output


def test_a_failed_save_at_the_end_is_status_1(ros, tmp_path):
    folder = tmp_path / 'maps'
    folder.mkdir()
    mapper = ros.mapper({'map.path': str(folder / 'map.persem'), 'map.save': True}).ready()
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    folder.rmdir()
    folder.write_text('a file in place of the folder')
    assert mapper.stop() == 1
    assert str(folder) in mapper.output and 'Traceback' not in mapper.output


def test_an_unusable_path_is_refused_while_it_runs(ros, tmp_path):
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters
    ros.mapper({'map.path': str(tmp_path / 'map.persem'), 'map.save': True}).ready()
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value='/dev/full/x')
    request = SetParameters.Request(parameters=[Parameter(name='map.path', value=value)])
    result, = ros.client.call('/mapper/set_parameters', SetParameters, request).results
    assert not result.successful and '/dev/full is not a folder' in result.reason
    set_path(ros.client, tmp_path / 'other.persem')


def test_histories_that_would_be_cut_are_kept_in_the_file_aside(ros, tmp_path):
    path = bags.write(tmp_path / 'first', 30)
    replayed(path, tmp_path / 'replay', **{'memory.max_history': 0})
    saved = tmp_path / 'replay' / 'map.persem'
    longest = int(np.diff(store.load(saved).saved.history_start).max())
    mapper = ros.mapper({'map.path': str(saved), 'map.load': True,
                         'memory.max_history': longest - 1}).ready()
    assert mapper.call('save_map')[0]
    assert len(asides(saved)) == 1
