"""Every service; a map that outlives kill -9."""

import bags
from harness import Player, until
import numpy as np
from persem_ros.outputs.map import store
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from test_live_equals_replay import replayed

FRAMES = 12


def test_each_service_says_what_happened(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper().ready()
    assert mapper.call('refine') == (False, 'the map is empty, there is nothing to refine')
    done, said = mapper.call('save_map')
    assert not done and 'map.path is empty' in said
    done, said = mapper.call('load_map')
    assert not done and 'map.path is empty' in said
    player = Player(ros.client, path)
    player.play()
    mapper.frames(FRAMES)
    voxels = int(mapper.values()['voxels'])
    assert voxels > 100
    assert mapper.call('pause') == (True, f'paused, {voxels} voxels')
    assert mapper.call('pause') == (True, f'paused already, {voxels} voxels')
    assert mapper.call('resume') == (True, f'mapping, {voxels} voxels')
    done, said = mapper.call('refine')
    assert done and said.startswith(f'refined {voxels} voxels in ')
    assert mapper.call('reset') == (True, f'forgot {voxels} voxels')
    until(lambda: mapper.values()['voxels'] == '0', mapper.values)


def test_paused_frames_are_rendered_and_not_integrated(ros, tmp_path):
    from sensor_msgs.msg import Image
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper().ready()
    images = ros.client.listen(Image, '/mapper/labels')
    player = Player(ros.client, path)
    assert mapper.call('pause') == (True, 'paused, 0 voxels')
    player.play()
    until(lambda: len(images) == FRAMES, lambda: f'{len(images)} images: {mapper.output}')
    assert mapper.call('resume') == (True, 'mapping, 0 voxels')


def test_a_full_disk_and_a_bad_path(ros, tmp_path):
    path = bags.write(tmp_path / 'bag', FRAMES)
    mapper = ros.mapper({'map.path': '/dev/full/map.persem'}).ready()
    Player(ros.client, path).play()
    mapper.frames(FRAMES)
    done, said = mapper.call('save_map')
    assert not done and '/dev/full' in said
    missing = tmp_path / 'missing.persem'
    set_path(ros.client, missing)
    done, said = mapper.call('load_map')
    assert not done and str(missing) in said
    (tmp_path / 'map.persem').write_text('nonsense')
    set_path(ros.client, tmp_path / 'map.persem')
    done, said = mapper.call('load_map')
    assert not done and 'not a map file' in said
    assert mapper.running and int(mapper.values()['voxels']) > 0


def test_save_kill_restart_load_and_go_on(ros, tmp_path):
    first = bags.write(tmp_path / 'first', FRAMES)
    saved = tmp_path / 'map.persem'
    mapper = ros.mapper({'map.path': str(saved)}).ready()
    Player(ros.client, first).play()
    mapper.frames(FRAMES)
    assert mapper.call('refine')[0]
    done, said = mapper.call('save_map')
    before = store.load(saved).saved
    assert done and said == f'saved {len(before.cell)} voxels to {saved}'
    mapper.kill()

    again = ros.mapper({'map.path': str(saved), 'map.load': True, 'map.save': True}).ready()
    assert int(again.values()['voxels']) == len(before.cell)
    done, said = again.call('load_map')
    assert done and said == f'loaded {len(before.cell)} voxels from {saved}'
    Player(ros.client, first).play()
    again.frames(FRAMES)
    assert again.stop() == 0, again.output
    after = store.load(saved).saved
    assert len(after.cell) == len(before.cell)
    assert np.array_equal(after.observations, 2 * before.observations)
    assert len(after.frames) == 2 * FRAMES


def test_a_map_of_other_voxels_is_refused_at_the_start(ros, tmp_path):
    replayed(bags.write(tmp_path / 'bag', FRAMES), tmp_path / 'replay')
    mapper = ros.mapper({'map.path': str(tmp_path / 'replay' / 'map.persem'), 'map.load': True,
                         'memory.voxel_size': 0.2})
    assert mapper.wait() == 1
    assert 'memory.voxel_size' in mapper.output and 'Traceback' not in mapper.output


def set_path(client, path):
    """Set the parameter map.path."""
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
    request = SetParameters.Request(parameters=[Parameter(name='map.path', value=value)])
    assert client.call('/mapper/set_parameters', SetParameters, request).results[0].successful
