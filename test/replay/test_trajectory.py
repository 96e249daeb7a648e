"""Replays by corrected poses: as if the recording had held the right ones."""

import bags
import numpy as np
from persem_ros.cli import main
from persem_ros.core.transforms import matrix_to_quaternion, transform
from persem_ros.outputs.map import store
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest
import replays

FRAMES = 9
KEYS = 0, 3, 4, FRAMES - 1
MOUNT = transform((0.2, 0.0, 0.1), (0.0, 0.0, np.sin(0.4), np.cos(0.4)))


def drift(i):
    """Return what poses are off by: more and more, which is what lerp and slerp give back."""
    return transform((0.0, 0.05 * i, 0.0), (0.0, 0.0, 0.0, 1.0))


def write(path, drifted, first=0, path_topic=''):
    """Write a flight whose poses are those of a body that carries the camera."""
    with RecordingWriter(path) as out:
        out.tf(None, 'body', 'camera', MOUNT, static=True)
        for i in range(first, first + FRAMES):
            for at in (i - 0.5, i):
                T = bags.pose(at - first)
                T = drift(at - first) @ T if drifted else T
                out.pose('pose', bags.stamp(at), 'map', T, 'Odometry', 'body')
            bags.write_images(out, i)
        if path_topic:
            keys = [(bags.stamp(i), bags.pose(i)) for i in KEYS]
            out.trajectory(path_topic, bags.stamp(first + FRAMES), 'map', keys[:1])
            out.trajectory(path_topic, bags.stamp(first + FRAMES + 1), 'map', keys)
    return path


def tum(path, keys=KEYS):
    """Write the true poses of some frames."""
    path.write_text(''.join(
        f'{bags.stamp(i) // 10 ** 9}.{bags.stamp(i) % 10 ** 9:09d} '
        + ' '.join(map(repr, [*bags.pose(i)[:3, 3].tolist(),
                              *matrix_to_quaternion(bags.pose(i)[:3, :3]).tolist()])) + '\n'
        for i in keys))
    return path


@pytest.fixture(scope='module')
def flights(tmp_path_factory):
    """Return a folder with recordings with right and wrong poses, and what the right ones give."""
    folder = tmp_path_factory.mktemp('flights')
    write(folder / 'right', False), write(folder / 'wrong', True, path_topic='slam/path')
    tum(folder / 'slam.tum')
    assert run('right', folder, folder / 'out') == 0
    return folder


def run(name, folder, out, *more):
    """Replay a recording; return the exit status."""
    names = [name] if isinstance(name, str) else name
    return main(['replay', *(str(folder / n) for n in names), '--out', str(out),
                 '--set', 'memory.voxel_size=0.2', '--methods', 'raw2d', *map(str, more)])


@pytest.mark.parametrize('words', [
    ['--trajectory', 'slam.tum'], ['--trajectory', 'wrong'], ['--trajectory', 'wrong:/slam/path'],
    ['--set', 'topics.trajectory=slam/path']])
def test_corrected_is_as_if_recorded_right(tmp_path, flights, words):
    words = [words[0], flights / words[1]] if words[0] == '--trajectory' else words
    assert run('wrong', flights, tmp_path / 'out', *words) == 0
    right, found = (store.load(out / 'map.persem').saved.frames
                    for out in (flights / 'out', tmp_path / 'out'))
    assert np.allclose(found.placed, right.placed, atol=1e-9)
    assert replays.histories(tmp_path / 'out' / 'map.persem') == \
        replays.histories(flights / 'out' / 'map.persem')


def test_the_moved_map_is_the_corrected_one(tmp_path, flights, capsys):
    """What moves frame by frame falls into the voxels that a replay by the right poses fills."""
    assert run('wrong', flights, tmp_path / 'out') == 0
    path = tmp_path / 'out' / 'map.persem'
    assert main(['map', 'move', str(path), '--trajectory', str(flights / 'wrong')]) == 0
    assert '8 of 9 frames of session 0 moved, by up to 0.4 m' in capsys.readouterr().out
    right, found = (store.load(p).memory() for p in (flights / 'out' / 'map.persem', path))
    assert np.allclose(found.frames.best, right.frames.placed, atol=1e-9)
    there = right.find(found.voxels()['voxel']) >= 0
    assert there.mean() > 0.85


def test_the_recording_of_that_time_is_corrected(tmp_path, flights, capsys):
    write(flights / 'later', True, first=100)
    assert run(['later', 'wrong'], flights, tmp_path / 'out', '--trajectory',
               flights / 'slam.tum') == 0
    frames = store.load(tmp_path / 'out' / 'map.persem').saved.frames
    right = store.load(flights / 'out' / 'map.persem').saved.frames
    assert np.allclose(frames.placed[FRAMES:], right.placed, atol=1e-9)
    assert np.allclose(frames.placed[:FRAMES, 1, 3] - right.placed[:, 1, 3],
                       0.05 * np.arange(FRAMES))


@pytest.mark.parametrize('words, said', [
    (['--trajectory', 'later.tum'], '0 of 2 poses lie within the poses of wrong, 1'),
    (['--trajectory', 'right'], r'one topic of type nav_msgs/msg/Path \(none is there\)'),
    (['--trajectory', 'none.tum'], 'none.tum: cannot be read'),
    (['--trajectory', 'slam.tum', '--set', 'pose.max_gap=0.01'], 'within pose.max_gap')])
def test_what_cannot_correct_is_refused(tmp_path, flights, capsys, words, said):
    import re
    tum(flights / 'later.tum', (100, 101))
    more = [words[0], flights / words[1], *words[2:]]
    if 'max_gap' in said:
        tum(flights / 'slam2.tum', (0.1, 1.2))
        more[1] = flights / 'slam2.tum'
    assert run('wrong', flights, tmp_path / 'out', *more) == 1
    assert re.search(said, capsys.readouterr().err) and not (tmp_path / 'out').exists()


def test_a_path_that_is_not_there_is_said(tmp_path, flights, capsys):
    assert run('wrong', flights, tmp_path / 'out', '--set', 'topics.trajectory=other') == 0
    assert "no path on topics.trajectory 'other', poses are taken as recorded; topics of type " \
        'nav_msgs/msg/Path: /slam/path' in capsys.readouterr().err
