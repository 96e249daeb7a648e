"""Replays that cannot go well: one clear line and exit 1, or dropped, counted and done."""

import json
import os
from pathlib import Path
import shutil
import subprocess
import sys

import bad_bags as bad
import bags
import numpy as np
from persem_ros.cli import main
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.outputs.results.rundir import FILES
from persem_ros.replay import compile_kernels
import pytest
import replays
import worlds

ROOT = Path(__file__).resolve().parents[2]
MAP = {'config.yaml', 'map.ply', 'map.persem'}
ALL = set(FILES)


@pytest.fixture(scope='module', autouse=True)
def compiled():
    """Compile all kernels, lest a line say so when the first replay does."""
    compile_kernels(('geometry',))


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    legend = 'classes:\n' + ''.join(f'- {{id: {c}, name: c{c}}}\n' for c in (1, 3, 7, 9, 255))
    return worlds.write(tmp_path_factory.mktemp('recording') / 'wall', legend=legend)


@pytest.fixture
def persem(tmp_path, capsys):
    """Return a function that replays: (exit status, lines on standard error, folder)."""
    def persem(bag, *arguments, out=tmp_path / 'out'):
        status = main(['replay', str(bag), '--out', str(out), *arguments])
        return status, capsys.readouterr().err.splitlines(), Path(out)
    return persem


def refused(result, *words):
    """Fail unless a replay was refused with one line that has all the words, after a warning."""
    status, lines, out = result
    assert status == 1
    assert 1 <= len(lines) <= 2 and all(line.startswith('persem: ') for line in lines)
    for word in words:
        assert word in lines[-1]
    assert 'internal error' not in lines[-1]
    return out


def nothing_in(out):
    """Fail if there is anything in a folder."""
    assert not out.exists() or not any(out.iterdir())


# ---- recordings


def spoiled_all(kind, **fields):
    """Return a change for bad.written that spoils all messages of a kind."""
    def change(found, i, message):
        if found == kind:
            for name, value in fields.items():
                setattr(message, name, value)
        return message
    return change


def unchanged(kind, i, message):
    """Change nothing."""
    return message


def truncated(path, storage='mcap', share=0.1):
    """Write a recording and keep a *share* of its file."""
    bag = bad.written(path, unchanged, frames=40, storage=storage)
    file, = (f for f in bag.iterdir() if f.suffix in ('.mcap', '.db3'))
    file.write_bytes(file.read_bytes()[:int(share * file.stat().st_size)])
    return bag


def turned(path, q):
    """Write a recording all of whose poses have the quaternion *q*."""
    with RecordingWriter(path) as out:
        for i in range(4):
            message = out.make.pose(bags.stamp(i), 'map', np.eye(4), 'PoseStamped', '')
            rotation = message[1].pose.orientation
            rotation.x, rotation.y, rotation.z, rotation.w = q
            out.message('pose', bags.stamp(i), *message)
            bags.write_images(out, i)
    return path


UNUSABLE = {
    'nothing there': (lambda path: path, ['does not exist']),
    'not a recording': (lambda path: path.write_text('hello') and path, ['no recording']),
    'an empty file': (lambda path: path.with_suffix('.mcap').touch() or path.with_suffix('.mcap'),
                      ['cannot be read']),
    'a tenth of sqlite3': (lambda path: truncated(path, 'sqlite3', 0.01), ['cannot be read']),
    'labels of an encoding': (
        lambda path: bad.written(path, spoiled_all('labels', encoding='yuv422')),
        ["'yuv422'", 'expected one of', 'mono8']),
    'depth of an encoding': (
        lambda path: bad.written(path, spoiled_all('depth', encoding='yuv422')),
        ["'yuv422'", '16UC1', '32FC1']),
    'short data': (lambda path: bad.written(path, spoiled_all(
        'depth', data=np.zeros(7, np.uint8))), ['7 bytes', 'height x step']),
    'zero size': (lambda path: bad.written(path, spoiled_all('labels', height=0)), ['16 x 0']),
    'another shape': (lambda path: bad.written(path, spoiled_all(
        'labels', height=6, data=np.zeros(6 * 32, np.uint8))), ['16 x 6', 'aspect']),
    'K with zeros': (lambda path: bad.written(path, spoiled_all('info', k=np.zeros(9))),
                     ['camera_info']),
    'K with NaN': (lambda path: bad.written(path, spoiled_all('info', k=np.full(9, np.nan))),
                   ['camera_info']),
    'no poses': (lambda path: bad.written(path, unchanged, poses=False), ['pose']),
    'zero quaternions': (lambda path: turned(path, (0.0, 0.0, 0.0, 0.0)), ['quaternion']),
    'long quaternions': (lambda path: turned(path, (0.0, 0.0, 0.0, 1.5)), ['quaternion']),
    'NaN quaternions': (lambda path: turned(path, (0.0, 0.0, 0.0, np.nan)), ['quaternion']),
    'poses at another time': (lambda path: bags.write(path, poses=[1000, 1001]), ['pose']),
}


@pytest.mark.parametrize('name', UNUSABLE)
def test_a_recording_that_is_of_no_use_is_refused_in_one_line(persem, tmp_path, name):
    write, words = UNUSABLE[name]
    nothing_in(refused(persem(write(tmp_path / 'bag')), *words))


@pytest.mark.parametrize('arguments, words', [
    (['--set', 'topics.labels=/semantic/imag'], ['/semantic/imag', '/semantic/image', '--set']),
    (['--set', 'topics.depth=/pose'], ['/pose', 'PoseStamped', '--set topics.depth=/depth/image']),
    (['--set', 'labels.topic=/names'], [
        "no names of classes on '/names' (--set labels.topic=/semantic/legend)"]),
    (['--set', 'labels.topic=/pose'], [
        "no names of classes on '/pose', which is of type geometry_msgs/msg/PoseStamped (--set "
        'labels.topic=/semantic/legend)']),
    (['--set', 'pose.source=tf'], ['/tf'])])
def test_topics_that_are_not_there_or_something_else(persem, recording, arguments, words):
    nothing_in(refused(persem(recording, *arguments), *words))


def labels_as(array, encoding):
    """Return a change that gives the first frame's labels other pixels."""
    def change(kind, i, message):
        if (kind, i) == ('labels', 0):
            message.encoding, message.step = encoding, array.strides[0]
            message.data = array.reshape(-1).view(np.uint8)
        return message
    return change


def odd_depth(kind, i, message):
    """Put in what is no measurement."""
    if kind == 'depth':
        depth = message.data.view('<f4').copy()
        depth[:5] = np.nan, np.inf, -np.inf, -1.0, 0.0
        message.data = depth.view(np.uint8)
    return message


USABLE = {
    'half an mcap': (lambda path: truncated(path, share=0.5), None, {}, 'cut off'),
    'one encoding': (lambda path: bad.written(path, bad.spoiled(encoding='yuv422')), 3,
                     {"labels: encoding 'yuv422'": 1, "depth: encoding 'yuv422'": 1}, ''),
    'depths of all kinds': (lambda path: bad.written(path, odd_depth), 5, {}, ''),
    'ids of all kinds': (lambda path: bad.written(path, labels_as(
        np.resize(np.array([-1, 65536, 1 << 30, 3], np.int32), (12, 16)), '32SC1')), 5, {},
        '144 pixels in 1 frames have ids below 0 or above 65534'),
    'poses for some frames': (lambda path: bags.write(path, frames=6, poses=[0, 1, 2, 3]), 4,
                              {'no pose': 2}, 'have no pose'),
    'stamps that repeat': (lambda path: bad.sequence(path, [0, 1, 1, 2]), 3, {}, ''),
    'stamps that go back': (lambda path: bad.sequence(path, [0, 2, 1, 3]), 4, {}, ''),
    'a stamp hours ahead': (lambda path: bad.sequence(path, [0, 1, 100_000, 2, 3]), 5, {}, ''),
}


@pytest.mark.parametrize('name', USABLE)
def test_what_is_of_use_is_used_and_the_rest_counted(persem, tmp_path, name):
    write, used, dropped, note = USABLE[name]
    status, lines, out = persem(write(tmp_path / 'bag'))
    assert status == 0 and replays.check_whole(out) == ALL
    assert not [p for p in out.iterdir() if p.name.startswith('.')]
    frames = json.loads((out / 'metrics.json').read_text())['frames']
    assert frames['used'] == used if used else 0 < frames['used'] < 40
    for reason, n in dropped.items():
        assert sum(m for key, m in frames['dropped'].items() if key.startswith(reason)) == n
    assert note in '\n'.join(lines)
    assert note or not lines


def scaled_depth(factor):
    """Return a change for bad.written that multiplies every depth."""
    def change(kind, i, message):
        if kind == 'depth':
            message.data = (message.data.view('<f4') * np.float32(factor)).view(np.uint8)
        return message
    return change


# What depth alone tells is refused by the look at the images, the rest when all is mapped.
LOOKED, MAPPED = '/depth/image: no pixel was between', 'nothing went into the map'
EMPTY = {
    'millimetres': (scaled_depth(1000), [],
                    [LOOKED, '2000 to 2040 m', 'memory.max_depth 200 m', 'unit',
                     '--set depth.scale=0.001']),
    'far': (scaled_depth(150.3), [], [LOOKED, '300.6 to 306.6 m', '--set memory.max_depth=310']),
    'kilometres': (scaled_depth(0.001), [], [LOOKED, '0.002 to 0.00204 m',
                                             '--set memory.min_depth=0.00']),
    'near and far': (unchanged, ['--set=memory.min_depth=2.5', '--set=memory.max_depth=3'],
                     [LOOKED, '2 to 2.04 m', 'memory.min_depth 2.5 m',
                      '--set memory.min_depth=2']),
    'no depth': (scaled_depth(np.nan), [], ['/depth/image: no pixel has a depth']),
    'ignored': (unchanged, ['--set=memory.ignore_labels=1,2', '--set=memory.dynamic_labels=3,4'],
                [MAPPED, 'ids are 1, 2, 3, 4,', 'memory.ignore_labels [1, 2]',
                 'memory.dynamic_labels [3, 4]']),
    'too few pixels': (unchanged, ['--set=memory.min_pixels=300'],
                       [MAPPED, 'memory.min_pixels 300']),
}


@pytest.mark.parametrize('causal', [(), ('--causal',)], ids=['', 'causal'])
@pytest.mark.parametrize('name', EMPTY)
def test_a_recording_of_which_nothing_goes_into_the_map(persem, tmp_path, name, causal):
    change, arguments, words = EMPTY[name]
    bag = bad.written(tmp_path / 'bag', change)
    nothing_in(refused(persem(bag, *arguments, *causal), *words))


def test_a_map_to_which_nothing_comes_is_no_success(persem, tmp_path):
    bag = bad.written(tmp_path / 'bag', unchanged)
    assert persem(bag, out=tmp_path / 'first')[0] == 0
    goes_on = f'--set=map.path={tmp_path / "first" / "map.persem"}'
    far = bad.written(tmp_path / 'far', scaled_depth(1000))
    nothing_in(refused(persem(far, goes_on), LOOKED))
    nothing_in(refused(persem(bag, goes_on, *EMPTY['ignored'][1]), MAPPED))


def sweep_of(path, frames, step, scale=1.0):
    """Write a flight along a wall 2 m ahead, *step* metres a frame, focal length times *scale*."""
    with RecordingWriter(path) as out:
        for i in range(frames):
            pose = np.eye(4)
            pose[0, 3] = step * i
            out.pose('pose', bags.stamp(i), 'map', pose)
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', bags.WIDTH,
                            bags.HEIGHT, bags.K * [[scale, 1, 1], [1, scale, 1], [1, 1, 1]])
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(0), '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
    return path


@pytest.mark.parametrize('frames, step, scale, said', [
    (12, 0.1, 1.0, ''), (12, 0.0, 10.0, ''),
    (12, 0.1, 30.0, 'spans about 150 pixels at the median depth of 2 m'),
    (12, 5.0, 1.0, 'hardly any voxel was seen twice: 1.0 observations per voxel in 12 frames'),
    (8, 5.0, 1.0, '')])
def test_voxels_that_do_not_suit_are_spoken_of(persem, tmp_path, frames, step, scale, said):
    status, lines, _ = persem(sweep_of(tmp_path / 'bag', frames, step, scale))
    assert status == 0 and len(lines) == bool(said)
    if said:
        assert said in lines[0]
        size = 0.03 if scale > 1 else 1
        assert f'--set memory.voxel_size={size}' in lines[0]


# ---- arguments and settings


@pytest.mark.parametrize('arguments, words', [
    (['--set', 'memory.voxelsize=0.2'], ["'memory.voxel_size'", 'did you mean']),
    (['--set', 'voxel_size=0.2'], ["'memory.voxel_size'"]),
    (['--set', 'memory.voxel_size=huge'], ['memory.voxel_size', 'a number (m)', "'huge'"]),
    (['--set', 'memory.voxel_size=-1'], ['0.001 to 1000.0 m', '-1']),
    (['--set', 'refine.method=ema2d'], ['need no map', '--methods ema2d']),
    (['--set', 'refine.method=persen'], ["'persem'", 'did you mean']),
    (['--set', 'render.fill=inputs'], ["'input'"]),
    (['--set', 'memory.voxel_size'], ['name=value']),
    (['--methods', 'raw2d,magority'], ["'magority'", "'majority'"]),
    (['--config', '/no/such/file.yaml'], ['/no/such/file.yaml']),
    (['--set', 'labels.legend=twon'], ["'twon'", "'town'"]),
    (['--set', 'map.path=/no/such.persem'], ['/no/such.persem'])])
def test_settings_and_methods_that_do_not_exist(persem, recording, arguments, words):
    nothing_in(refused(persem(recording, *arguments), *words))


def test_a_map_of_other_voxels_is_not_gone_on_with(persem, recording, tmp_path):
    assert persem(recording, out=tmp_path / 'first')[0] == 0
    result = persem(recording, f'--set=map.path={tmp_path / "first" / "map.persem"}',
                    '--set=memory.voxel_size=0.3')
    nothing_in(refused(result, 'memory.voxel_size 0.5', '0.3'))


# ---- the folder of the results


def test_a_folder_that_is_not_empty_needs_force(persem, recording, tmp_path):
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'mine.txt').write_text('mine')
    (out / 'metrics.json').write_text('{}')
    refused(persem(recording), 'not empty', '--force', '--out')
    assert {p.name for p in out.iterdir()} == {'mine.txt', 'metrics.json'}
    assert persem(recording, '--force')[0] == 0
    assert {p.name for p in out.iterdir()} == ALL | {'mine.txt'}
    assert json.loads((out / 'metrics.json').read_text())['frames']['used'] == 12
    (out / 'mine.txt').rename(tmp_path / 'mine.txt')
    assert persem(recording, '--force')[0] == 0     # its own files it replaces as well
    assert replays.check_whole(out) == ALL


def test_force_does_not_take_a_folder_that_no_replay_made(persem, recording, tmp_path):
    mine = tmp_path / 'out' / 'refined' / 'mine.txt'
    mine.parent.mkdir(parents=True)
    mine.write_text('mine')
    refused(persem(recording, '--force'), 'refined', 'not a recording', '--force')
    assert mine.read_text() == 'mine'


def test_force_spares_the_old_results_until_there_are_new_ones(persem, recording, tmp_path):
    status, _, out = persem(recording)
    assert status == 0
    before = {p.name: p.stat().st_mtime_ns for p in out.iterdir()}
    refused(persem(turned(tmp_path / 'bad', (0.0, 0.0, 0.0, 0.0)), '--force'))
    assert {p.name: p.stat().st_mtime_ns for p in out.iterdir()} == before


def test_a_file_in_the_way(persem, recording, tmp_path):
    (tmp_path / 'file').write_text('mine')
    refused(persem(recording, out=tmp_path / 'file'), 'is a file')
    refused(persem(recording, out=tmp_path / 'file' / 'out'), 'cannot write', 'Not a directory')
    assert (tmp_path / 'file').read_text() == 'mine'


def test_a_folder_that_cannot_be_made_leaves_no_parents(persem, recording, tmp_path):
    too_long = 300 * 'x'
    refused(persem(recording, out=tmp_path / 'a' / 'b' / too_long), 'cannot write')
    assert not (tmp_path / 'a').exists()
    (tmp_path / 'a').mkdir()
    refused(persem(recording, out=tmp_path / 'a' / 'b' / too_long), 'cannot write')
    assert list((tmp_path / 'a').iterdir()) == []       # it was there before and stays


def test_a_file_system_that_is_read_only(recording, tmp_path):
    # in a name space of its own, so that root and others may mount
    mount = ['unshare', '-rm', 'sh', '-c', 'mount -t tmpfs tmpfs "$0" && '
             'mount -o remount,ro "$0" && exec "$@"', str(tmp_path)]
    try:
        subprocess.run([*mount, 'true'], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip('nothing can be mounted here: unshare -rm fails')
    done = subprocess.run([*mount, sys.executable, '-m', 'persem_ros', 'replay', str(recording),
                           '--out', str(tmp_path / 'out')], cwd=ROOT, capture_output=True,
                          text=True)
    assert (done.returncode, done.stderr) == (
        1, f'persem: cannot write to {tmp_path / "out"}: Read-only file system\n')


def test_a_file_system_that_takes_no_folders(persem, recording):
    refused(persem(recording, out='/proc/persem'), 'cannot write to /proc/persem')


# ---- processes that end early

# Where a replay is ended. Until all of it is whole nothing lies there under its name.
PHASES = ('opening', 'integrating', 'refining', 'writing map.ply', 'writing map.persem', 'naming',
          'rendering', 'recording', 'closing', 'writing metrics.json', 'finishing',
          'writing report.html')
CAUSAL = ('integrating', 'closing')
FORCE = ('refining', 'rendering', 'writing report.html')    # over the results of an earlier run
ATTACHED = ('integrating', 'refining', 'rendering', 'handing over')     # a session for a map
PAGING = ('--set=map.attached=true', '--set=memory.max_voxels=100', '--set=memory.voxel_size=0.1')
SIZES = {'config.yaml': 2000, 'map.persem': 30_000, 'refined': 400_000}     # bytes a file may have


def jobs(recording, noise, folder):
    """Return {(kind, phase): job}; the folder of each is folder/kind-phase."""
    found, mapped = {}, folder / 'mapped.persem'
    assert main(['replay', str(recording), '--out', str(folder / 'mapped'), *PAGING,
                 f'--set=map.path={mapped}']) == 0
    for kind, phases in (('SIGINT', PHASES), ('SIGKILL', PHASES), ('SIGINT-causal', CAUSAL),
                         ('SIGKILL-causal', CAUSAL), ('SIGINT-force', FORCE),
                         ('SIGKILL-attached', ATTACHED)):
        for phase in phases:
            found[kind, phase] = {'phase': phase, 'signal': kind.partition('-')[0]}
    for name, size in SIZES.items():
        found['full', name] = {'file_size': size}
    for (kind, phase), job in found.items():
        out = folder / f'{kind}-{phase}'
        bag = noise if (kind, phase) == ('full', 'refined') else recording
        job['arguments'] = ['replay', str(bag), '--out', str(out),
                            '--set=memory.voxel_size=0.2', '--set=memory.dynamic_labels=9',
                            *(['--causal'] if 'causal' in kind else []),
                            *(['--force'] if 'force' in kind else [])]
        if 'force' in kind:
            write_results(out)
        if 'attached' in kind:
            shutil.copy(mapped, map_of(out))
            job['arguments'] += [*PAGING, f'--set=map.path={map_of(out)}']
    return {key: {'phase': '', 'signal': '', 'file_size': 0, **job}
            for key, job in found.items()}


def map_of(out):
    """Return the map that the job with these results adds to."""
    return out.with_name(f'{out.name}.persem')


def write_results(out):
    """Write a folder as an earlier run may have left it."""
    bad.written(out / 'refined', unchanged, frames=1)
    for name in ALL - {'refined'}:
        (out / name).write_text('of an earlier run')


def noisy(path):
    """Write a recording whose refined images are large and whose map is small."""
    rng = np.random.default_rng(6)
    with RecordingWriter(path) as out:
        for i in range(4):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 320, 240,
                            20 * bags.K)
            depth = np.zeros((240, 320), np.float32)
            depth[9] = 2
            out.image('depth/image', bags.stamp(i), 'camera', depth, '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera',
                      rng.integers(0, 65535, (240, 320)).astype(np.uint16), 'mono16')
    return path


@pytest.fixture(scope='module')
def ended(recording, tmp_path_factory):
    """Return {(kind, phase): (exit status, standard error, folder)}."""
    folder = tmp_path_factory.mktemp('ended')
    wanted = jobs(recording, noisy(folder / 'noise'), folder)
    result = subprocess.run([sys.executable, str(ROOT / 'test' / 'replay_child.py')], cwd=ROOT,
                            input=json.dumps(list(wanted.values())), capture_output=True,
                            text=True, timeout=120, env={**os.environ, 'PYTHONPATH': str(ROOT),
                                                         'PERSEM_THREADS': '1'})
    assert result.returncode == 0, result.stderr
    return {key: (status, errors, Path(job['arguments'][3]))
            for (key, job), (status, errors) in zip(wanted.items(), json.loads(result.stdout))}


@pytest.mark.parametrize('kind, phase', [('SIGINT', p) for p in PHASES]
                         + [('SIGINT-causal', p) for p in CAUSAL])
def test_interrupted(ended, kind, phase):
    status, errors, out = ended[kind, phase]
    assert (status, errors) == (130, 'persem: interrupted\n')
    assert not out.exists()


@pytest.mark.parametrize('phase', FORCE)
def test_interrupted_over_the_results_of_an_earlier_run(ended, phase):
    status, errors, out = ended['SIGINT-force', phase]
    assert (status, errors) == (130, 'persem: interrupted\n')
    assert {p.name for p in out.iterdir()} == ALL
    assert {(out / name).read_text() for name in ALL - {'refined'}} == {'of an earlier run'}


@pytest.mark.parametrize('kind, phase', [('SIGKILL', p) for p in PHASES]
                         + [('SIGKILL-causal', p) for p in CAUSAL])
def test_killed(ended, kind, phase):
    status, errors, out = ended[kind, phase]
    assert (status, errors) == (-9, '')
    assert not out.exists() or [p for p in out.iterdir() if not p.name.startswith('.')] == []


@pytest.mark.parametrize('phase', ATTACHED)
def test_a_session_that_was_killed_leaves_the_map_as_it_was(ended, phase):
    status, errors, out = ended['SIGKILL-attached', phase]
    assert (status, errors) == (-9, '')
    mapped = out.with_name('mapped.persem').read_bytes()
    assert map_of(out).read_bytes() == mapped
    assert not any(map_of(out).with_name(f'{map_of(out).name}{end}').exists()
                   for end in ('-wal', '-journal'))


@pytest.mark.parametrize('phase', ['writing map.persem', 'recording', 'writing report.html'])
def test_what_a_killed_run_left_is_replaced(ended, persem, recording, phase):
    out = ended['SIGKILL', phase][2]
    assert any(p.name.startswith('.') for p in out.iterdir())
    assert persem(recording, '--set=memory.dynamic_labels=9', out=out)[0] == 0
    assert {p.name for p in out.iterdir()} == ALL == replays.check_whole(out)


@pytest.mark.parametrize('name', SIZES)
def test_no_space(ended, name):
    status, errors, out = ended['full', name]
    assert status == 1 and len(errors.splitlines()) == 1
    assert 'cannot write' in errors and name in errors
    assert not out.exists()
