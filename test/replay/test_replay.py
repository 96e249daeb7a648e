"""A replay from end to end: what lies in the folder, and that the plain reference agrees."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import fcntl
import json
import logging
import os
from pathlib import Path
import re
import struct
import sys
import termios

import bags
import numpy as np
from persem_ros import passes, replay as replay_module
from persem_ros.cli import main
from persem_ros.core import jit
from persem_ros.errors import PersemError
from persem_ros.frames import pinhole
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import Source
from persem_ros.outputs.map import store
from persem_ros.outputs.map.lock import WriterLock
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.outputs.results.rundir import FILES
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.recorded import FIRSTS
from persem_ros.rendering import Renderer
from persem_ros.replay import compile_kernels, replay
from persem_ros.settings import config_file
from persem_ros.settings.config import IMAGE_METHODS, METHODS as VOXEL_METHODS
from persem_ros.settings.legend import Legend
import pytest
import replays
from replays import config_of, recorded, refined_images
import worlds

METHODS = ('raw2d', 'ema2d', 'majority', 'context', 'persem')
LEGEND = Legend.from_yaml("""
classes:
- {id: 1, name: strange}
- {id: 3, name: left}
- {id: 7, name: right, color: [10, 20, 30]}
- {id: 9, name: moving, dynamic: true}
- {id: 255, name: nothing, ignored: true}
""")


@pytest.fixture(scope='module', autouse=True)
def compiled():
    """Compile all kernels, lest a line say so when the first replay does."""
    compile_kernels(('geometry',))


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    return worlds.write(tmp_path_factory.mktemp('recording') / 'wall', legend=LEGEND.to_yaml())


def run(path, out, config, methods=METHODS, **options):
    """Replay without the report, which has tests of its own."""
    return replay(path, out, config, methods, report=False, **options)


def close(a, b):
    """Return whether two trees of dicts agree, numbers to 1e-9."""
    if isinstance(b, dict):
        return a.keys() == b.keys() and all(close(a[key], b[key]) for key in b)
    return a == (None if b is None else pytest.approx(b, abs=1e-9))


def same_labels(found, frames, images):
    """Fail unless refined images are those of *frames* with the labels *images*."""
    assert len(found) == len(frames)
    for (stamp, frame_id, encoding, labels), frame, image in zip(found, frames, images):
        assert (stamp, frame_id, encoding) == (frame.stamp, frame.frame_id, frame.encoding)
        assert labels.tolist() == np.asarray(image).tolist()


# ---- what is left behind


@pytest.fixture(scope='module')
def finished(recording, tmp_path_factory):
    """Return (folder, status) of a replay by the command line, with the truth."""
    out = tmp_path_factory.mktemp('finished') / 'result'
    return out, main(['replay', str(recording), '--out', str(out), '--set',
                      'memory.voxel_size=0.2', '--set', 'memory.dynamic_labels=9',
                      '--methods', 'raw2d, majority'])


def test_everything_is_left_behind_whole(finished):
    out, status = finished
    assert status == 0
    assert replays.check_whole(out) == set(FILES) == {p.name for p in out.iterdir()}


def test_metrics_have_the_shape_that_others_rely_on(finished):
    found = json.loads((finished[0] / 'metrics.json').read_text())
    assert list(found) == ['frames', 'voxels', 'observations', 'truth_flicker', 'methods',
                           'regions']
    assert found['frames'] == {'used': 12, 'dropped': {}}
    assert list(found['methods']) == ['raw2d', 'majority', 'persem']
    for row in found['methods'].values():
        assert list(row) == ['pixel_accuracy', 'miou', 'flicker', 'iou']
        assert list(row['iou']) == ['3', '7', '9']
    assert set(found['regions']) == {'all', 'boundary', 'high_switch', 'difficult_core'}


def test_settings_can_be_given_back(finished, recording, tmp_path):
    config = config_file.from_file(finished[0] / 'config.yaml')
    assert config == config_of({'memory.dynamic_labels': [9]})
    assert main(['replay', str(recording), '--out', str(tmp_path / 'again'), '--config',
                 str(finished[0] / 'config.yaml'), '--storage', 'sqlite3']) == 0
    for name in ('map.ply', 'map.persem', 'metrics.json', 'config.yaml'):
        assert (finished[0] / name).read_bytes() == (tmp_path / 'again' / name).read_bytes()
    # What every ROS 2 from Humble on opens without a plugin holds the same.
    assert (tmp_path / 'again' / 'refined' / 'refined.db3').exists()
    assert 'version: 8' in (tmp_path / 'again' / 'refined' / 'metadata.yaml').read_text()
    for one, other in zip(refined_images(finished[0]), refined_images(tmp_path / 'again')):
        assert one[:3] == other[:3] and np.array_equal(one[3], other[3])


def test_timing_says_what_took_how_long_on_what(finished):
    found = json.loads((finished[0] / 'timing.json').read_text())
    assert {'read', 'integrate', 'refine', 'render', 'measure', 'write'} <= set(found['stages'])
    assert found['stages']['integrate']['calls'] == found['frames'] == 12
    assert found['frames_per_s'] > 0 and found['versions']['numpy'] and found['hardware']


def test_refined_has_the_map_latched_and_the_colours_of_the_legend(finished):
    found, qos = recorded(finished[0] / 'refined')
    assert set(found) == {'/mapper/labels', '/mapper/labels_color', '/mapper/map',
                          '/mapper/legend'}
    assert qos['/mapper/map'].durability.name == 'TRANSIENT_LOCAL'
    assert qos['/mapper/map'].depth == 1
    assert qos['/mapper/labels'].durability.name == 'VOLATILE'
    assert Legend.from_yaml(found['/mapper/legend'][0].data) == LEGEND
    cloud, = found['/mapper/map']
    assert cloud.header.frame_id == 'map' and cloud.point_step == 32
    assert len(cloud.data) == 32 * json.loads(
        (finished[0] / 'metrics.json').read_text())['voxels']
    for (_, _, _, labels), color in zip(refined_images(finished[0]),
                                        found['/mapper/labels_color']):
        assert (color.encoding, color.height, color.width) == ('rgb8', 12, 16)
        assert color.data.reshape(12, 16, 3).tolist() == LEGEND.colors(labels).tolist()


def test_without_truth_only_flicker_is_known(tmp_path):
    path = worlds.write(tmp_path / 'wall', with_truth=False)
    result = run(path, tmp_path / 'out', config_of())
    assert result['truth_flicker'] is None
    for row in result['methods'].values():
        assert row['pixel_accuracy'] is None and row['miou'] is None and row['iou'] == {}
        assert 0 <= row['flicker'] <= 100
    assert 'NaN' not in (tmp_path / 'out' / 'metrics.json').read_text()


def test_one_frame_is_a_recording(tmp_path):
    path = worlds.write(tmp_path / 'wall', frames=1)
    result = run(path, tmp_path / 'out', config_of())
    assert result['frames']['used'] == 1
    assert result['methods']['persem']['flicker'] is None
    assert result['methods']['persem']['pixel_accuracy'] > 0
    replays.check_whole(tmp_path / 'out')


def test_methods_with_spaces_or_all(monkeypatch):
    given = []
    monkeypatch.setattr(replay_module, 'replay', lambda *a, **_: given.append(a[3]) or (1 / 0))
    for text in (' raw2d , majority,', 'all', ' all '):
        assert main(['replay', 'bag', '--out', 'x', '--methods', text]) == 1
    assert given == [['raw2d', 'majority'], ['all'], ['all']]
    config = config_of()
    assert set(replay_module.chosen_methods(['all'], config)) == {*IMAGE_METHODS, *VOXEL_METHODS}
    assert replay_module.chosen_methods([], config) == ('raw2d', 'majority', 'persem')


def test_help_names_the_methods(capsys):
    assert main(['replay', '--help']) == 0
    words = capsys.readouterr().out.replace(',', ' ').split()
    assert {*IMAGE_METHODS, *VOXEL_METHODS, 'all:'} <= set(words)


# ---- the reference agrees


@pytest.mark.parametrize('values', [
    {},
    {'memory.dynamic_labels': [9], 'render.fill': 'unknown', 'refine.neighbours': 6},
    {'memory.stride': 3, 'memory.min_pixels': 2, 'memory.voxel_size': 0.7,
     'refine.method': 'context_history', 'refine.neighbours': 18,
     'memory.ignore_labels': [1, 255], 'render.fill': 'unknown'},
    {'map.origin': [0.31, -0.2, 0.77], 'memory.max_depth': 2.06, 'refine.min_observations': 5,
     'refine.method': 'probabilistic', 'memory.voxel_size': 0.4}])
def test_refined_images_and_metrics_are_those_of_the_reference(recording, tmp_path, values):
    config = config_of(values)
    frames = replays.frames_of(recording, config)
    methods = tuple(dict.fromkeys((*METHODS, config.refine.method)))
    expected = replays.Expected(frames, config, methods)
    result = run(recording, tmp_path / 'out', config, METHODS)
    same_labels(refined_images(tmp_path / 'out'), frames, expected.published())
    assert close({key: result[key] for key in ('truth_flicker', 'methods', 'regions')},
                 expected.metrics())
    assert result['voxels'] == len(expected.memory.histories)
    assert result['observations'] == sum(map(len, expected.memory.histories.values()))
    found, labels = replays.histories(tmp_path / 'out' / 'map.persem')
    assert found == expected.memory.histories
    assert labels == expected.labels[config.refine.method]


@pytest.mark.parametrize('factor', [2, 0.5])
def test_labels_of_another_size_than_the_depth(tmp_path, factor):
    rng, shape = np.random.default_rng(3), (int(12 * factor), int(16 * factor))

    def images(out, i, at):
        depth = bags.depth(i) + rng.random((12, 16), np.float32)
        out.image('depth/image', at, 'camera', depth, '32FC1')
        for topic in ('semantic/truth', 'semantic/image'):
            out.image(topic, at, 'eye', rng.integers(1, 5, shape).astype(np.uint8), 'mono8')

    path = written(tmp_path / 'sizes', images)
    config = config_of({'memory.dynamic_labels': [4]})
    frames = replays.frames_of(path, config)
    assert frames[0].labels.shape == shape != frames[0].depth.shape
    expected = replays.Expected(frames, config, METHODS)
    result = run(path, tmp_path / 'out', config)
    same_labels(refined_images(tmp_path / 'out'), frames, expected.published())
    assert close(result['methods'], expected.metrics()['methods'])


def test_the_strides_that_auto_took_are_said(recording, tmp_path, capsys):
    assert main(['replay', str(recording), '--out', str(tmp_path / 'out'),
                 '--set', 'memory.stride=0', '--set', 'memory.voxel_size=50']) == 0
    frames = json.loads((tmp_path / 'out/metrics.json').read_text())['frames']
    strides = sorted(int(s) for s, n in frames['strides'].items() for _ in range(n))
    assert len(strides) == frames['used'] and strides[0] > 1
    assert (f'memory.stride 0 came to {strides[(len(strides) - 1) // 2]} (median; {strides[0]} to '
            f'{strides[-1]})') in capsys.readouterr().out


def test_several_cameras_share_one_map(tmp_path):
    rng = np.random.default_rng(4)

    def images(out, i, at):
        for number, name in enumerate(('front', 'down')):
            when = at + number * 30_000_000
            out.camera_info(f'{name}/depth/camera_info', when, name, 16, 12, bags.K)
            out.image(f'{name}/depth/image', when, name, bags.depth(i), '32FC1')
            for topic in ('truth', 'image'):
                out.image(f'{name}/semantic/{topic}', when, name,
                          rng.integers(1, 4, (12, 16)).astype(np.uint16), 'mono16')

    path = written(tmp_path / 'two', images)
    config = config_of({'cameras': ['front', 'down'], 'pose.child_frame': 'rig',
                        'pose.extrinsic': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]})
    frames = replays.frames_of(path, config)
    assert [f.sensor for f in frames[:2]] == ['front', 'down']
    methods = ('raw2d', 'majority', 'persem')
    expected = replays.Expected(frames, config, methods)
    result = run(path, tmp_path / 'out', config, methods)
    published = expected.published()
    for number, name in enumerate(('front', 'down')):
        same_labels(refined_images(tmp_path / 'out', f'/mapper/{name}/labels'),
                    frames[number::2], published[number::2])
    assert close(result['methods'], expected.metrics()['methods'])
    assert result['frames']['used'] == 16


def written(path, images, frames=8):
    """Write a recording whose images(out, i, stamp) writes, with poses and camera infos."""
    with RecordingWriter(path) as out:
        for i in range(frames):
            out.pose('pose', bags.stamp(i - 0.5), 'map', bags.pose(i - 0.5))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            images(out, i, bags.stamp(i))
        out.pose('pose', bags.stamp(frames - 0.5), 'map', bags.pose(frames - 0.5))
    return path


@pytest.mark.parametrize('encoding, kind', [
    ('mono8', 'u1'), ('8UC1', 'u1'), ('mono16', 'u2'), ('16UC1', 'u2'), ('16SC1', 'i2'),
    ('32SC1', 'i4')])
def test_refined_images_keep_encoding_size_and_strange_ids(tmp_path, encoding, kind):
    strange = {'u1': [0, 255], 'u2': [0, 65534], 'i2': [-5, 0], 'i4': [-70000, 70000]}[kind]

    def images(out, i, at):
        depth = bags.depth(i)
        depth[:, 8:] = np.nan
        out.image('depth/image', at, 'camera', depth, '32FC1')
        ids = np.resize(np.array([*strange, 3, 4], kind), (12, 16))
        out.image('semantic/image', at, 'eye', ids, encoding)

    path = written(tmp_path / 'ids', images, frames=3)
    config = config_of()
    frames = replays.frames_of(path, config)
    expected = replays.Expected(frames, config, ['persem'])
    run(path, tmp_path / 'out', config)
    found = refined_images(tmp_path / 'out')
    same_labels(found, frames, expected.published())
    assert found[0][:3] == (bags.stamp(0), 'eye', encoding)
    assert set(strange) <= set(np.unique(found[0][3]).tolist())      # where nothing is known


def test_causal_equals_a_loop_by_hand(recording, tmp_path):
    config = config_of({'refine.period': 0.4, 'refine.eta': 1.0, 'refine.min_observations': 1,
                        'memory.dynamic_labels': [9]})
    frames = replays.frames_of(recording, config)
    pipeline, refined_at, images = Pipeline(config), frames[0].stamp, []
    for frame in frames:
        pipeline.add(frame)
        if frame.stamp - refined_at >= 400_000_000:
            pipeline.refine_next()
            refined_at = frame.stamp
        images.append(pipeline.render(frame))
    pipeline.refine()
    result = run(recording, tmp_path / 'causal', config, causal=True)
    same_labels(refined_images(tmp_path / 'causal'), frames, images)
    labels = replays.histories(tmp_path / 'causal' / 'map.persem')[1]
    columns = pipeline.memory.voxels()
    assert list(labels.values()) == columns['label'].tolist()
    assert result['regions'] == {}
    assert replays.check_whole(tmp_path / 'causal') == set(FILES) - {'report.html'}

    whole = run(recording, tmp_path / 'whole', config)
    assert (whole['voxels'], whole['observations']) == (result['voxels'], result['observations'])
    assert whole['methods']['raw2d'] == result['methods']['raw2d']
    assert whole['methods']['majority'] != result['methods']['majority']
    assert replays.histories(tmp_path / 'whole' / 'map.persem') == \
        replays.histories(tmp_path / 'causal' / 'map.persem')


def test_a_map_renders_every_method_as_it_labels(recording):
    config, methods = config_of(), [name for name in METHODS if name != 'ema2d']
    frames = replays.frames_of(recording, config)
    expected = replays.Expected(frames, config, methods)
    pipeline = Pipeline(config)
    renderer = Renderer(pipeline, methods)
    for frame in frames:
        pipeline.add(frame)
        renderer.render(frame)      # which must not be remembered
    pipeline.refine()
    renderer.relabel()
    for i, frame in enumerate(frames):
        rendering = renderer.render(frame)
        for name in methods:
            assert replays.flat(rendering.images[name]) == expected.images[name][i]
        assert rendering.voxels.shape == rendering.valid.shape == frame.depth.shape


# ---- how it is read and repeated


@pytest.mark.parametrize('causal, readings', [(False, 2), (True, 1)])
def test_the_recording_is_opened_once_and_read_at_most_twice(recording, tmp_path, monkeypatch,
                                                             causal, readings):
    opened, read = [], []
    monkeypatch.setattr(Source, '__init__', noted(Source.__init__, opened))
    monkeypatch.setattr(Recording, 'frames', noted(Recording.frames, read))
    places, original = Counter(), Source.read

    def counting(self, file, place):
        places[place] += 1
        return original(self, file, place)

    monkeypatch.setattr(Source, 'read', counting)
    run(recording, tmp_path / 'out', config_of(), causal=causal)
    assert len(opened) == 1 and len(read) == readings
    monkeypatch.undo()
    with Source(recording) as source:
        found = {name: [places[head.place] for head in source.heads({name})]
                 for name in ('/semantic/image', '/semantic/truth')}
    assert len(found['/semantic/image']) == 12
    # The look before reads a few images once more.
    assert sum(found['/semantic/image']) == 12 * readings + FIRSTS + 3
    assert found['/semantic/truth'] == [1] * 12


def noted(function, calls):
    """Return *function* with a note of each call."""
    def noting(*arguments, **options):
        calls.append(arguments)
        return function(*arguments, **options)
    return noting


def test_the_same_input_gives_the_same_bytes_with_any_threads(tmp_path):
    path = tmp_path / 'big'
    rng = np.random.default_rng(5)
    with RecordingWriter(path) as out:      # large enough for every kernel to be split
        view = pinhole(320, 240, 300.0, 300.0, 159.5, 119.5)
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 320, 240, view.K)
            out.image('depth/image', bags.stamp(i), 'camera',
                      2 + 8 * rng.random((240, 320), np.float32), '32FC1')
            for topic in ('semantic/image', 'semantic/truth'):
                ids = rng.integers(1, 5, (24, 32)).astype(np.uint8)
                out.image(topic, bags.stamp(i), 'camera', np.kron(ids, np.ones((10, 10), 'u1')),
                          'mono8')
    config = config_of({'memory.voxel_size': 0.1, 'refine.min_observations': 1})
    contents, before = [], jit.threads()
    try:
        for number, threads in enumerate((1, 2, 2)):
            jit.set_threads(threads)
            out = tmp_path / f'out{number}'
            run(path, out, config, (*METHODS, 'trust', 'recency'))
            contents.append({str(p.relative_to(out)): p.read_bytes() for p in out.rglob('*')
                             if p.is_file() and p.name != 'timing.json'})
    finally:
        jit.set_threads(before)
    assert {'map.ply', 'map.persem', 'metrics.json', 'config.yaml', 'refined/refined.mcap',
            'refined/metadata.yaml'} == set(contents[0])
    for name, content in contents[0].items():
        assert content == contents[1][name] == contents[2][name], name


def test_two_halves_make_the_whole_in_two_sessions(recording, tmp_path):
    config = config_of()
    paths = [tmp_path / 'first', tmp_path / 'second']
    for path, (begin, end) in zip(paths, ((0, 6), (6, 12))):
        half(recording, path, begin, end)
    run(recording, tmp_path / 'whole', config)
    run(paths[0], tmp_path / 'a', config)
    going_on = config_of({'map.path': str(tmp_path / 'a' / 'map.persem')})
    result = run(paths[1], tmp_path / 'b', going_on)
    assert result['frames']['used'] == 6
    assert replays.histories(tmp_path / 'b' / 'map.persem') == \
        replays.histories(tmp_path / 'whole' / 'map.persem')
    one, two = (replays.store.load(tmp_path / name / 'map.persem').memory()
                for name in ('whole', 'b'))
    assert [(f.t, f.stamp) for f in one.frames] == [(f.t, f.stamp) for f in two.frames]
    assert [f.session for f in two.frames] == 6 * [0] + 6 * [1]
    assert (one.volatility() == two.volatility()).all()
    # The other half's frames look the same from either map.
    assert [image.tolist() for *_, image in refined_images(tmp_path / 'b')] == \
        [image.tolist() for *_, image in refined_images(tmp_path / 'whole')[6:]]


def test_an_attached_map_takes_a_session_whole_or_not_at_all(recording, tmp_path):
    path = tmp_path / 'map.persem'
    config = config_of({'map.path': str(path), 'map.attached': True, 'memory.max_history': 2})
    for n in (1, 2):
        run(recording, tmp_path / f'out{n}', config)
        saved = replays.store.load(path).saved
        assert saved.frames.session.tolist() == [s for s in range(n) for _ in range(12)]
        assert len(saved.history_frame) == saved.observations.sum()     # nothing was dropped
    before = path.read_bytes()
    with pytest.raises(PersemError):
        run(recording, tmp_path / 'out1', config)           # not empty
    lock = WriterLock(path)
    with pytest.raises(PersemError, match='is being written by'):
        run(recording, tmp_path / 'out3', config)
    lock.close()
    assert path.read_bytes() == before


def half(recording, path, begin, end):
    """Copy the frames begin .. end of a recording, with the poses around them."""
    low, high = bags.stamp(begin - 0.5), bags.stamp(end - 0.5)
    with Source(recording) as source, RecordingWriter(path) as out:
        for topic, kind, time, data in source.messages({t.name for t in source.topics}):
            if low <= time <= high:
                out.message(topic, time, kind, source.decode(data, kind))


def test_a_map_that_is_read_is_never_replaced(recording, tmp_path, capsys):
    out = tmp_path / 'out'
    run(recording, out, config_of())
    kept = (out / 'map.persem').read_bytes()
    for values, bag in (({'map.path': str(out / 'map.persem')}, recording),
                        ({'topics.labels': '/mapper/labels'}, out / 'refined')):
        arguments = [f'--set={name}={value}' for name, value in values.items()]
        assert main(['replay', str(bag), '--out', str(out), '--force', *arguments,
                     '--set=memory.voxel_size=0.2']) == 1
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert (out / 'map.persem').read_bytes() == kept
    with pytest.raises(PersemError, match='lies in .*another folder with --out'):
        run(recording, out, config_of({'map.path': str(out / 'map.persem')}), force=True)


# ---- what a user is told


def test_far_places_are_warned_about_once_with_an_origin_that_helps(tmp_path, caplog):
    def images(out, i, at):
        out.pose('utm', at, 'map', utm(i))
        out.image('depth/image', at, 'camera', bags.depth(i), '32FC1')
        out.image('semantic/image', at, 'camera', bags.labels(i), 'mono16')

    def utm(i):
        T = bags.pose(i)
        T[:3, 3] += 500_321.5, 5_400_123.25, 431.0
        return T

    path = written(tmp_path / 'utm', images)
    config = config_of({'topics.pose': 'utm'})
    run(path, tmp_path / 'far', config)
    said = [r.getMessage() for r in caplog.records if 'origin' in r.getMessage()]
    assert len(said) == 1
    caplog.clear()
    proposal = re.search(r'--set (map\.origin=\S+)', said[0]).group(1)
    assert proposal == 'map.origin=500000,5400000,0'
    near = config_file.from_values(dict([config_file.parse_item(proposal)]), config)
    run(path, tmp_path / 'near', near)
    assert not caplog.records
    far = replays.Expected(replays.frames_of(path, config), near, ['persem'])
    assert replays.histories(tmp_path / 'near' / 'map.persem')[0] == far.memory.histories


def test_flags_of_the_legend_are_proposed_and_never_applied(recording, tmp_path, caplog):
    run(recording, tmp_path / 'a', config_of())
    said = [r.getMessage() for r in caplog.records]
    assert len(said) == 1 and '9 (moving) as dynamic' in said[0]
    assert said[0].endswith('--set memory.dynamic_labels=9')
    histories = replays.histories(tmp_path / 'a' / 'map.persem')[0]
    assert any(c == 9 for history in histories.values() for c, _, _ in history)

    caplog.clear()
    run(recording, tmp_path / 'b', config_of({'memory.dynamic_labels': [9],
                                              'memory.ignore_labels': [65535]}))
    said = [r.getMessage() for r in caplog.records]
    assert len(said) == 1 and '255 (nothing) as ignored' in said[0]
    assert said[0].endswith('--set memory.ignore_labels=65535,255')

    caplog.clear()
    run(recording, tmp_path / 'c', config_of({'memory.dynamic_labels': [9]}))
    assert not caplog.records


def test_ids_of_things_that_move_that_never_occur_are_said(recording, tmp_path, caplog):
    run(recording, tmp_path / 'a', config_of({'memory.dynamic_labels': [77]}))
    never, flag = [r.getMessage() for r in caplog.records]
    assert never.startswith('memory.dynamic_labels 77: no label image has such ids and no legend '
                            'knows them; expected ids that occur: ') and '9 (moving)' in never
    assert flag.endswith('--set memory.dynamic_labels=9')


def test_heights_that_the_legend_gives_count_as_if_they_were_set(recording, tmp_path):
    told = Legend.from_yaml(LEGEND.to_yaml().replace('id: 3,', 'id: 3, height: [1, 10],'))
    own = worlds.write(tmp_path / 'wall', legend=told.to_yaml())
    values, maps = {'refine.method': 'geometry'}, []
    for out, path, more in (('none', recording, {}), ('own', own, {}),
                            ('set', recording, {'refine.geometry.heights': '3 5 50'})):
        run(path, tmp_path / out, config_of({**values, **more}), ('geometry',))
        maps.append(store.load(tmp_path / out / 'map.persem').saved)
    none, own, given = maps
    assert own.fitted_by == given.fitted_by == (*none.fitted_by, '3 5 50')
    assert own.label.tolist() == given.label.tolist()
    assert all(np.array_equal(a, given.habits[name]) for name, a in own.habits.items())
    assert not np.array_equal(own.habits['theta'], none.habits['theta'])


def test_heights_that_the_votes_contradict_are_said(tmp_path, caplog, monkeypatch):
    """A wall that begins on the ground, said to be far above it."""
    monkeypatch.setattr('persem_ros.core.geometry.overruled.FEW', 10)
    told = Legend.from_yaml(LEGEND.to_yaml().replace('id: 3,', 'id: 3, height: [60, 70],'))
    path = worlds.write(tmp_path / 'wall', legend=told.to_yaml())
    replay(path, tmp_path / 'row', config_of(), ['geometry'], report=False)
    assert 'the votes contradict the heights of' in caplog.text     # by a row of the table
    caplog.clear()
    replay(path, tmp_path / 'out', config_of({'refine.method': 'geometry'}))
    assert 'the votes contradict the heights of' in caplog.text
    assert ('60 to 70 m above the ground: 100.0% of its' in
            (tmp_path / 'out' / 'report.html').read_text('utf-8'))


def test_ids_out_of_range_are_ignored_and_counted(tmp_path, caplog):
    def images(out, i, at):
        ids = np.full((12, 16), 3, np.int32)
        ids[0, :5] = -1, -70000, 65536, 65535, 255     # the last two are ignore_labels
        out.image('depth/image', at, 'camera', bags.depth(i), '32FC1')
        out.image('semantic/image', at, 'camera', ids, '32SC1')

    result = run(written(tmp_path / 'ids', images, frames=4), tmp_path / 'out', config_of())
    advice, counted = [r.getMessage() for r in caplog.records]
    assert 'above 65534' in advice and '--set labels.divisor=1000' in advice
    assert counted == (
        '12 pixels in 4 frames have ids below 0 or above 65534; they were ignored')
    assert result['frames'] == {'used': 4, 'dropped': {}}
    histories = replays.histories(tmp_path / 'out' / 'map.persem')[0]
    assert {c for history in histories.values() for c, _, _ in history} == {3}


def test_numpy_values_are_settings_like_any_other(recording, tmp_path):
    values = {'memory.stride': np.int64(2), 'memory.voxel_size': np.float32(0.25),
              'memory.dynamic_labels': np.array([9]), 'camera.rectified': np.bool_(False),
              'map.origin': np.zeros(3), 'refine.method': np.str_('trust')}
    config = config_of(values)
    plain = config_of({name: value.tolist() for name, value in values.items()})
    assert config == plain
    results = [run(recording, tmp_path / name, c) for name, c in (('a', config), ('b', plain))]
    assert results[0] == results[1]
    assert config_file.from_file(tmp_path / 'a' / 'config.yaml') == plain


def on_terminal(recording, out, monkeypatch):
    """Run the command line with a terminal for standard error; return what that showed."""
    parent, child = os.openpty()
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 100, 0, 0))
    with ThreadPoolExecutor(1) as pool, os.fdopen(child, 'w') as terminal:
        shown = pool.submit(everything, parent)
        with monkeypatch.context() as patch:
            patch.setattr(sys, 'stderr', terminal)
            assert main(['replay', str(recording), '--out', str(out), '--force',
                         '--set=memory.voxel_size=0.2', '--set=memory.dynamic_labels=9']) == 0
        terminal.close()
        return shown.result(20).decode()


def everything(terminal):
    """Read from a terminal until its other end is closed."""
    shown = b''
    with suppress(OSError):
        while part := os.read(terminal, 65536):
            shown += part
    os.close(terminal)
    return shown


def test_bars_on_a_terminal_and_log_lines_above_them(recording, tmp_path, monkeypatch):
    class Talking(passes.Advice):

        def frame(self, frame):
            if frame.stamp == bags.stamp(5):
                logging.getLogger('persem_ros.some.where').warning('by the %s', 'way')

    monkeypatch.setattr(passes, 'Advice', Talking)
    shown = on_terminal(recording, tmp_path / 'out', monkeypatch)
    assert 'integrating:' in shown and 'rendering:' in shown and 'frames/s' in shown
    line, = (line for line in re.split('[\r\n]+', shown) if 'by the way' in line)
    assert line == 'persem: by the way'
    # Nothing of the bars stays: what the terminal shows in the end are the log lines.
    assert 'frames/s' not in shown.rpartition('\r')[2]


def test_no_bars_without_a_terminal(recording, tmp_path, capfd):
    assert main(['replay', str(recording), '--out', str(tmp_path / 'out'),
                 '--set=memory.dynamic_labels=9']) == 0
    out, err = capfd.readouterr()
    assert err == ''
    assert '12 frames used, 0 dropped' in out and str(Path(tmp_path / 'out')) in out


def test_logging_handlers_are_those_of_before(recording, tmp_path, monkeypatch):
    logger = logging.getLogger('persem_ros')
    before = list(logger.handlers)
    on_terminal(recording, tmp_path / 'out', monkeypatch)
    assert logger.handlers == before
