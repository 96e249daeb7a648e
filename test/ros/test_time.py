"""Time that goes back: recordings that loop, single bad stamps, a simulated clock that stops."""

import bags
from harness import Player, RELIABLE, until
import pytest
from rosgraph_msgs.msg import Clock

FRAMES = 30         # 3 s
SHORT = {'sync.max_wait': 0.5, 'sync.hold': 0.1}


def shifted(player, seconds):
    """Let a player's messages be of other stamps (whole seconds)."""
    def later(data):
        sec = int.from_bytes(data[4:8], 'little') + seconds
        return data[:4] + sec.to_bytes(4, 'little') + data[8:]
    player.messages = [(topic, kind, at, later(data)) for topic, kind, at, data in player.messages]
    return player


@pytest.mark.parametrize('policy', ['keep', 'reset'])
def test_a_recording_that_loops(ros, tmp_path, policy):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper({**SHORT, 'map.on_time_jump': policy}).ready()
    player = Player(ros.client, path)
    player.play()
    mapper.frames(FRAMES - 1)
    once = int(mapper.values()['observations'])
    player.play()
    until(lambda: mapper.values()['time jumps'] == '1', mapper.values)
    mapper.frames(2 * FRAMES - 4)
    until(lambda: mapper.values()['queue messages'] == '0', mapper.values)
    values = mapper.values()
    assert 'time went back' in mapper.output
    if policy == 'keep':
        assert values['sessions'] == '2' and int(values['observations']) > 1.7 * once
    else:
        assert values['sessions'] == '1' and int(values['observations']) <= once


def test_one_bad_stamp_changes_nothing(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper({**SHORT, 'map.on_time_jump': 'reset'}).ready()
    player = Player(ros.client, path)
    half = len(player.messages) // 2
    whole = player.messages
    player.messages = whole[:half]
    player.play()
    mapper.frames(FRAMES // 2 - 2)
    for seconds in (-1_000_000_000, 1_000_000_000):
        player.messages = [m for m in whole[half:half + 8] if m[0] == '/pose'][:1] + \
            [m for m in whole[half:half + 8] if m[0] == '/semantic/image'][:1]
        shifted(player, seconds).play()
    player.messages = whole[half:]
    player.play()
    mapper.frames(FRAMES - 2)
    values = mapper.values()
    assert values['time jumps'] == '0' and values['sessions'] == '1'
    assert int(values['voxels']) > 100


def test_a_clock_that_stands_still(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper({'use_sim_time': True}).ready()
    clock = ros.client.publisher(Clock, '/clock', RELIABLE)
    clock.publish(Clock())                          # and never again
    mapper.says('no complete set of messages')      # the watchdog goes on
    Player(ros.client, path).play()
    mapper.frames(FRAMES)                           # and so does everything else
    assert mapper.call('refine')[0]
