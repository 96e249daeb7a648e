"""A node whose map is a database: killed, gone on with, paged, reset, refused."""

import signal

import bags
from harness import Player, until
import numpy as np
from persem_ros.outputs.map import store

FRAMES = 12


def attached(path, **more):
    """Return the settings of a node with an attached map."""
    return {'map.path': str(path), 'map.attached': True, 'map.checkpoint': 0.3,
            **{name.replace('__', '.'): value for name, value in more.items()}}


def frames_in(path):
    """Return how many frames the file holds, 0 where it is not there yet."""
    return len(store.load(path).saved.frames) if path.exists() else 0


def test_a_killed_node_leaves_the_map_and_the_next_one_goes_on(ros, tmp_path):
    path, bag = tmp_path / 'map.persem', bags.write(tmp_path / 'bag', FRAMES)
    first = ros.mapper(attached(path)).ready()
    Player(ros.client, bag).play()
    first.frames(FRAMES)
    until(lambda: frames_in(path) == FRAMES, 'a checkpoint')        # read beside the writer
    whole = store.load(path).saved
    second = ros.mapper(attached(path))
    until(lambda: not second.running, 'the second is refused')
    assert 'is being written by mapper (process' in second.output
    first.kill()
    assert (tmp_path / 'map.persem-wal').exists()
    saved = store.load(path).saved
    assert np.array_equal(saved.history_frame, whole.history_frame)
    third = ros.mapper(attached(path, memory__max_voxels=200, refine__method='geometry',
                                refine__period=0.2)).ready()
    player = Player(ros.client, bag)
    player.play()
    third.frames(FRAMES)
    ok, said = third.call('refine')
    assert ok and said.startswith(f'refined {len(whole.cell)} voxels')
    ok, said = third.call('save_map')
    assert ok and said == f'saved {len(whole.cell)} voxels to {path}'
    until(lambda: int(third.values()['voxels']) <= 200, third.values)
    assert not third.call('load_map')[0]
    assert third.stop() == 0
    saved = store.load(path).saved
    assert saved.frames.session.tolist() == FRAMES * [1] + FRAMES * [2]
    assert saved.observations.sum() == 2 * whole.observations.sum() and not saved.dirty.any()
    assert saved.fitted_by is not None and saved.fitted_by[0] == 'z' and saved.posterior.all()
    assert sorted(p.name for p in tmp_path.glob('*map.persem*')) == ['map.persem']


def test_nodes_killed_in_the_midst_of_a_flight_lose_what_came_last(ros, tmp_path):
    path, bag, before = tmp_path / 'map.persem', bags.write(tmp_path / 'bag', 4 * FRAMES), 0
    for _ in range(3):
        mapper = ros.mapper(attached(path, memory__max_voxels=200, refine__period=0.2)).ready()
        player = Player(ros.client, bag)
        n = len(player.messages) // 2
        player.play(player.messages[:n])
        mapper.frames(2 * FRAMES - 1)       # the last one may wait for a pose
        until(lambda: frames_in(path) >= before + 2 * FRAMES - 1, 'a checkpoint', timeout=10.0)
        player.play(player.messages[n:])
        mapper.kill()
        after = frames_in(path)             # whole, with all that was written
        assert before + 2 * FRAMES - 1 <= after <= before + 4 * FRAMES
        before = after
    assert ros.mapper(attached(path)).ready().stop() == 0 and frames_in(path) == before


def test_a_reset_moves_the_file_aside(ros, tmp_path):
    path = tmp_path / 'map.persem'
    mapper = ros.mapper(attached(path)).ready()
    Player(ros.client, bags.write(tmp_path / 'bag', FRAMES)).play()
    mapper.frames(FRAMES)
    assert mapper.call('reset')[0]
    aside = [p for p in tmp_path.glob('map.persem.*') if 'wal' not in p.name and
             'shm' not in p.name]
    assert len(aside) == 1 and frames_in(aside[0]) == FRAMES
    until(lambda: frames_in(path) == 0, 'an empty file')
    mapper.signal(signal.SIGTERM)
    assert mapper.wait() == 0
    assert frames_in(path) == 0
