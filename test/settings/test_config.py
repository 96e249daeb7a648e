"""Settings: files in ROS form, options, refusals, generated documents."""

from pathlib import Path

from persem_ros.errors import PersemError
from persem_ros.settings import config_file
from persem_ros.settings.config import Config, settings, topics_of, updated
import pytest
import yaml

ROOT = Path(__file__).parents[2]


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a settings file and gives its path."""
    def write(text):
        path = tmp_path / 'some.yaml'
        path.write_text(text)
        return path
    return write


def refusal(call, *args):
    """Return the sentence with which a call is refused."""
    with pytest.raises(PersemError) as caught:
        call(*args)
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_default_types_fit_ros():
    for name, value, meta in settings():
        assert value is not None and value != (), f'{name}: ROS cannot type it'
        assert meta['help']
        assert updated(Config(), {name: value}) == Config()


def test_yaml_there_and_back(write):
    odd = updated(Config(), {
        'memory.voxel_size': 1e-2, 'memory.max_depth': 1e5, 'memory.ignore_labels': [7],
        'map.path': "it's # a: 'path'", 'frames.map': '1', 'labels.legend': 'no',
        'camera.rectified': True, 'map.origin': [500000.0, -1.5, 0.1 + 0.2]})
    for config in (Config(), odd):
        assert config_file.from_file(write(config_file.to_yaml(config))) == config


def test_odd_strings_and_empty_lists(write):
    config = updated(Config(), {'map.path': 'a\nb\tc\x00', 'memory.dynamic_labels': [],
                                'cameras': []})
    text = config_file.to_yaml(config)
    assert 'dynamic_labels: [-1]' in text and "cameras: ['']" in text
    again = config_file.from_file(write(text))
    assert again == updated(Config(), {'map.path': 'a\nb\tc\x00'})


def test_yaml_is_what_ros_reads(write):
    parameters = yaml.safe_load(config_file.to_yaml(Config()))['/**']['ros__parameters']
    assert parameters['memory']['voxel_size'] == 0.5
    assert parameters['memory']['ignore_labels'] == [255, 65535]
    assert parameters['topics']['labels'] == 'semantic/image'


def test_several_cameras(write):
    config = config_file.from_file(write("""
/**:
  ros__parameters:
    cameras.down.topics.depth: /below/depth
    cameras: [front, down]
    topics: {labels: seg}
"""))
    assert config.cameras == ('front', 'down')
    assert topics_of(config, 'front').labels == 'front/seg'
    assert topics_of(config, 'down').depth == '/below/depth'
    assert topics_of(config, 'down').pose == 'pose'
    assert config_file.from_file(write(config_file.to_yaml(config))) == config


def test_an_option_reaches_cameras_of_the_file(write):
    path = write('/**:\n  ros__parameters:\n    cameras: [front]\n')
    config = config_file.from_args(path, ['topics.labels=seg'])
    assert topics_of(config, 'front').labels == 'front/seg'


@pytest.mark.parametrize('head', ['/**:', 'mapper:', '/mapper:', '/robot/mapper:', '/*:',
                                  'robot:\n mapper:'])
def test_node_names_that_mean_the_mapper(write, head):
    config = config_file.from_file(write(
        f'{head}\n  ros__parameters:\n    memory.voxel_size: 2e-1\n    use_sim_time: true\n'
        f'camera_driver:\n  ros__parameters:\n    fps: 30\n'))
    assert config.memory.voxel_size == 0.2


def test_the_named_node_wins_over_the_wildcard(write):
    config = config_file.from_file(write(
        'mapper:\n  ros__parameters: {memory: {voxel_size: 0.1, stride: 2}}\n'
        '/**:\n  ros__parameters: {memory: {voxel_size: 0.2, min_pixels: 3}}\n'))
    memory = config.memory
    assert (memory.voxel_size, memory.stride, memory.min_pixels) == (0.1, 2, 3)


@pytest.mark.parametrize(('text', 'words'), [
    ('a: [', ['line 1', 'not YAML']),
    ('', ["'/**:'", 'ros__parameters']),
    ('memory:\n  voxel_size: 1.0\n', ['ros__parameters']),
    ('/other:\n  ros__parameters: {a: 1}\n', ['/other', "'mapper'"]),
    ('/**:\n  ros__parameters: 5\n', ['line 2', 'below ros__parameters']),
    ('/**:\n  ros__parameters:\n    memory:\n      voxel_sise: 1.0\n',
     ['line 4', 'memory.voxel_sise', "did you mean 'memory.voxel_size'"]),
    ('/**:\n  ros__parameters:\n    refine: {method: persen}\n',
     ['line 3', 'refine.method', "did you mean 'persem'"]),
    ('/**:\n  ros__parameters:\n    memory: {stride: 1.5}\n',
     ['line 3', 'expected a whole number (pixels), for example 1, got 1.5']),
    ('/**:\n  ros__parameters:\n    memory: {stride: 1, stride: 2}\n', ['given twice']),
    ('/**:\n  ros__parameters:\n    memory.stride: 1\n    memory: {stride: 2}\n',
     ['line 4', 'given twice, first in line 3']),
    ('/**:\n  ros__parameters:\n    map: {origin: [1.0, 2.0]}\n', ['expected 3 numbers, got 2']),
    ('/**:\n  ros__parameters:\n    map: {path: !!python/name:os.system }\n',
     ['line 3', 'map.path']),
    ('/**:\n  ros__parameters:\n    memory: {min_depth: 5.0, max_depth: 4.0}\n',
     ['less than memory.max_depth'])])
def test_bad_files(write, text, words):
    path = write(text)
    sentence = refusal(config_file.from_file, path)
    assert sentence.startswith(str(path))
    for word in words:
        assert word in sentence


def test_files_that_cannot_be_read(tmp_path):
    assert 'No such file' in refusal(config_file.from_file, tmp_path / 'none.yaml')
    assert 'cannot be read' in refusal(config_file.from_file, tmp_path)
    (tmp_path / 'binary').write_bytes(b'\xff\xfe\x00')
    assert 'not YAML' in refusal(config_file.from_file, tmp_path / 'binary')


@pytest.mark.parametrize(('item', 'name', 'value'), [
    ('memory.voxel_size=0.2', 'memory.voxel_size', 0.2),
    ('memory.voxel_size = 1e-1', 'memory.voxel_size', 0.1),
    ('memory.stride=2', 'memory.stride', 2),
    ('memory.voxel_size=2', 'memory.voxel_size', 2.0),
    ('memory.ignore_labels=[0, 255]', 'memory.ignore_labels', (0, 255)),
    ('memory.ignore_labels=0,255', 'memory.ignore_labels', (0, 255)),
    ('memory.dynamic_labels=7', 'memory.dynamic_labels', (7,)),
    ('map.origin=[1,2,3]', 'map.origin', (1.0, 2.0, 3.0)),
    ('frames.map=1', 'frames.map', '1'),
    ('topics.pose=/a=b', 'topics.pose', '/a=b'),
    ('map.path=', 'map.path', ''),
    ('camera.rectified=true', 'camera.rectified', True)])
def test_options(item, name, value):
    config = config_file.from_args(None, [item])
    assert {n: v for n, v, _ in settings(config)}[name] == value


@pytest.mark.parametrize(('item', 'words'), [
    ('memory.voxel_size', ['expected name=value, with =', 'memory.voxel_size=0.5']),
    ('=3', ['expected name=value']),
    ('voxel_size=3', ["did you mean 'memory.voxel_size'"]),
    ('memory.voxel_size=5cm', ['--set memory.voxel_size: expected a number (m), for example 0.5, '
                               "got '5cm'"]),
    ('refine.eta=high', ["expected a number, for example 0.3, got 'high'"]),
    ('memory.ignore_labels=sky', ["expected a whole number, for example 255, got 'sky'"]),
    ('camera.rectified=5', ['expected true or false, got 5']),
    ('refine.method=raw2d', ['raw2d and ema2d need no map', '--methods raw2d', 'persem']),
    ('memory.voxel_size=-1', ['0.001 to 1000.0 m']),
    ('memory.voxel_size=.nan', ['expected a number (m)']),
    ('memory.ignore_labels=[1', ['cannot be read']),
    ('cameras.front.topics.labels=x', ['unknown setting'])])
def test_bad_options(item, words):
    sentence = refusal(config_file.from_args, None, [item])
    for word in words:
        assert word in sentence


def test_options_win_over_the_file_and_later_over_earlier(write):
    path = write('/**:\n  ros__parameters:\n    memory: {voxel_size: 1.0, stride: 4}\n')
    config = config_file.from_args(path, ['memory.voxel_size=2.0', 'memory.voxel_size=3.0'])
    assert (config.memory.voxel_size, config.memory.stride) == (3.0, 4)


def test_the_node_bounds_its_histories():
    assert config_file.from_args().memory.max_history == 0
    assert config_file.from_args(node=True).memory.max_history == 128
    shipped = ROOT / 'config' / 'persem.yaml'
    assert config_file.from_args(shipped).memory.max_history == 0
    assert config_file.from_args(shipped, node=True).memory.max_history == 128


def test_shipped_file_and_table_are_current(capsys):
    from persem_ros.cli import main
    assert main(['config']) == 0
    assert capsys.readouterr().out == (ROOT / 'config' / 'persem.yaml').read_text(), \
        'run: persem config > config/persem.yaml'
    assert main(['config', '--markdown']) == 0
    assert capsys.readouterr().out == (ROOT / 'docs' / 'parameters.md').read_text(), \
        'run: persem config --markdown > docs/parameters.md'


def test_config_prints_what_is_in_force(capsys, write):
    from persem_ros.cli import main
    assert main(['config', '--set', 'memory.max_history=5', '--set', 'refine.eta=0.5']) == 0
    config = config_file.from_file(write(capsys.readouterr().out))
    assert (config.memory.max_history, config.refine.eta) == (5, 0.5)
    assert main(['config', '--defaults-node']) == 0
    assert config_file.from_file(write(capsys.readouterr().out)).memory.max_history == 128
