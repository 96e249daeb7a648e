"""Settings by file, by command line and while it runs."""

import subprocess

import bags
from harness import Player, SETTINGS, until
from persem_ros.settings.config import settings
import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from sensor_msgs.msg import Image


def param(ros, *words):
    """Run `ros2 param ...` for the node; return what it prints."""
    done = subprocess.run(['ros2', 'param', words[0], '/mapper', *words[1:]], env=ros.env,
                          capture_output=True, text=True, timeout=120)
    return (done.stdout + done.stderr).strip()


def test_file_and_command_line(ros, tmp_path):
    path = tmp_path / 'settings.yaml'
    path.write_text('/**:\n  ros__parameters:\n    refine:\n      eta: 0.4\n      gama: 0.9\n'
                    '    memory:\n      max_depth: 50\n      ignore_labels: [255]\n'
                    '    memory.dynamic_labels: [7, 8]\n')
    mapper = ros.mapper({'refine.gamma': 0.8}, ['--params-file', str(path)]).ready()
    assert "'refine.gama' is not known, did you mean 'refine.gamma'?" in mapper.output
    assert mapper.output.count('is not known') == 1
    names = ['refine.eta', 'refine.gamma', 'memory.max_depth', 'memory.ignore_labels',
             'memory.dynamic_labels', 'memory.max_history']
    values = ros.client.call('/mapper/get_parameters', GetParameters,
                             GetParameters.Request(names=names)).values
    assert [values[0].double_value, values[1].double_value, values[2].double_value] == \
        [0.4, 0.8, 50.0]
    assert list(values[3].integer_array_value) == [255]
    assert list(values[4].integer_array_value) == [7, 8]
    assert values[5].integer_value == 128


def test_the_shipped_file_is_taken(ros, tmp_path):
    from harness import ROOT
    mapper = ros.mapper(arguments=['--params-file', str(ROOT / 'config' / 'persem.yaml')]).ready()
    assert 'is not known' not in mapper.output


def test_every_setting_is_described(ros):
    ros.mapper().ready()
    listed = ros.client.call('/mapper/list_parameters', ListParameters,
                             ListParameters.Request(depth=0)).result.names
    known = {name: (value, meta) for name, value, meta in settings()}
    assert set(known) <= set(listed)
    request = DescribeParameters.Request(names=list(known))
    described = ros.client.call('/mapper/describe_parameters', DescribeParameters, request)
    for one in described.descriptors:
        value, meta = known[one.name]
        assert meta['help'] in one.description and meta['unit'] in one.description
        assert one.read_only == (not meta['live'])
        if isinstance(value, float) and meta['low'] is not None:
            bounds = one.floating_point_range[0]
            assert (bounds.from_value, bounds.to_value) == (meta['low'], meta['high'])
        if isinstance(value, int) and meta['low'] is not None:
            assert one.integer_range[0].from_value == meta['low']
        assert one.type != ParameterType.PARAMETER_NOT_SET


def test_bad_values_are_refused_and_others_take_effect(ros, tmp_path):
    mapper = ros.mapper({'render.fill': 'input'}).ready()
    assert 'Set parameter successful' in param(ros, 'set', 'refine.eta', '0.5')
    assert 'Set parameter successful' not in param(ros, 'set', 'refine.eta', '1.5')
    answer = param(ros, 'set', 'refine.method', 'persen')
    assert "did you mean 'persem'" in answer
    assert 'read-only' in param(ros, 'set', 'memory.voxel_size', '0.2')
    answer = param(ros, 'set', 'memory.min_depth', '500.0')
    assert 'less than memory.max_depth' in answer
    assert '0.5' in param(ros, 'get', 'refine.eta')
    images = ros.client.listen(Image, '/mapper/labels')
    # Nothing is near enough any more, so every pixel is unknown and filled with the ignored id.
    assert 'successful' in param(ros, 'set', 'memory.max_depth', '0.5')
    assert 'successful' in param(ros, 'set', 'render.fill', 'unknown')
    Player(ros.client, bags.write(tmp_path / 'bag', 3)).play()
    until(lambda: len(images) == 3, mapper.values)
    assert {value for image in images for value in bytes(image.data)[::2]} == {255}


@pytest.mark.parametrize('name, value, words', [
    ('memory.voxel_size', -1.0, 'memory.voxel_size: expected'),
    ('refine.neighbours', 7, '6, 18 or 26'),
    ('refine.method', 'best', 'refine.method: expected one of'),
    ('topics.depth', 'semantic/image', 'expected two topics')])
def test_bad_values_at_the_start(ros, name, value, words):
    mapper = ros.mapper({**SETTINGS, name: value})
    assert mapper.wait() == 1
    assert words in mapper.output and 'Traceback' not in mapper.output
