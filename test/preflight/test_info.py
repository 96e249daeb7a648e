"""persem info: what is in a recording, what would be used, what is missing."""

import subprocess
import sys

import bags
import cv2
import numpy as np
from persem_ros.cli import main
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest


def report(capsys, *arguments):
    """Return (exit status, standard output) of persem info."""
    status = main(['info', *map(str, arguments)])
    return status, capsys.readouterr().out


def row(out, topic):
    """Return the words of the table's line for *topic*."""
    return next(line.split() for line in out.splitlines() if line.startswith(f'{topic} '))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_table(tmp_path, capsys, storage):
    def extra(out):
        out.tf(bags.stamp(0), 'base_link', 'gimbal', np.eye(4), static=True)
        out.tf(bags.stamp(0), 'gimbal', 'camera', np.eye(4), static=True)
        out.pose('odometry', bags.stamp(1), 'map', np.eye(4), 'Odometry', 'base_link')

    status, out = report(capsys, bags.write(tmp_path / 'bag', storage=storage, extra=extra))
    assert status == 0
    assert f'{storage}, ' in out and '2023-11-14 22:13:19 UTC' in out and '(0.6 s)' in out
    assert row(out, '/depth/image') == ['/depth/image', 'Image', '5', '10.0', '32FC1', '16x12',
                                        'camera', '+0.050', '+0.450']
    assert row(out, '/semantic/image')[2:6] == ['5', '10.0', 'mono16', '16x12']
    assert row(out, '/pose')[:5] == ['/pose', 'PoseStamped', '7', '10.0', 'map']
    assert row(out, '/depth/camera_info')[4:7] == ['plumb_bob', '16x12', 'camera']
    assert row(out, '/odometry')[2:6] == ['1', 'map', '->', 'base_link']
    assert row(out, '/tf_static')[2:] == ['2', 'base_link', '->', 'gimbal', '+0.050', '+0.050']
    assert '  labels       /semantic/image (Image)' in out
    assert '  tf_static    /tf_static' in out and 'missing' not in out
    assert f'usable: persem replay {tmp_path / "bag"}' in out
    assert report(capsys, tmp_path / 'bag', '--set', 'topics.pose=odometry')[0] == 0


@pytest.mark.parametrize('words', [(), ('--set', 'labels.legend=FILE')])
def test_ids_are_printed_with_their_names_in_the_recording(tmp_path, capsys, words):
    ids = np.unique([bags.labels(i) for i in (0, 1, 2)]).tolist()
    text = f'classes: [{{id: {ids[0]}, name: tree}}, {{id: 900, name: roof}}]'
    (tmp_path / 'file').write_text('classes: [{id: 77, name: tree}]')
    bags.write(tmp_path / 'bag', extra=lambda out: out.text('semantic/legend', text, latched=True))
    status, out = report(capsys, tmp_path / 'bag',
                         *(word.replace('FILE', str(tmp_path / 'file')) for word in words))
    line, = [line for line in out.splitlines() if line.startswith('ids in ')]
    assert status == 0 and f'label images on /semantic/image: {ids[0]} tree, {ids[1]}, ' in line


def test_what_warnings_propose_is_printed_as_a_command(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            bags.write_images(out, i)
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.image('large', bags.stamp(i), 'camera', 1000 * bags.labels(i) + np.arange(
                16, dtype='u2'), 'mono16')
    status, out = report(capsys, tmp_path / 'bag', '--set', 'topics.labels=/large')
    command = f'persem replay {tmp_path / "bag"} --out DIR --set topics.labels=/large'
    assert status == 0 and out.splitlines()[-2:] == [
        f'usable: {command}',
        f'or, where the warnings are right: {command} --set labels.divisor=1000']


def test_images_that_begin_late_are_described(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(2500):
            out.pose('pose', bags.START + i * 10_000_000, 'map', np.eye(4))
        out.text('never', '')
        bags.write_images(out, 0, bags.START + 24_900_000_000)
    status, out = report(capsys, tmp_path / 'bag')
    assert status == 0 and row(out, '/depth/image')[3] == '32FC1'


def test_the_recorder_may_have_another_clock(tmp_path, capsys):
    """What has no header is shown on the recorder's clock, each beside its like."""
    later = 3 * 10 ** 16
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            for topic, kind, msg in (
                    ('semantic/image', 'sensor_msgs/msg/Image',
                     out.make.image(bags.stamp(i), 'camera', bags.labels(i), 'mono16')),
                    ('note', 'std_msgs/msg/String', out.make.make('std_msgs/msg/String', 'x')),
                    ('tf', 'tf2_msgs/msg/TFMessage', out.make.make('tf2_msgs/msg/TFMessage', [
                        out.make.transform(bags.stamp(i), 'map', 'camera', np.eye(4))])),
                    ('empty', 'tf2_msgs/msg/TFMessage', out.make.make(
                        'tf2_msgs/msg/TFMessage', []))):
                out.message(topic, bags.stamp(i) + later, kind, msg)
    out = report(capsys, tmp_path / 'bag')[1]
    assert row(out, '/semantic/image')[-2:] == row(out, '/tf')[-2:] == ['+0.000', '+0.200']
    assert row(out, '/note')[-2:] == ['+0.000', '+0.200'] and '(0.2 s)' in out


def test_compressed_images_have_a_size(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            png = cv2.imencode('.png', bags.labels(i))[1].tobytes()
            out.compressed('semantic/image/compressed', bags.stamp(i), 'camera', 'png', png)
            deep = bytes(12) + cv2.imencode('.png', np.full((12, 16), 1500, np.uint16))[
                1].tobytes()
            out.compressed('depth/image/compressedDepth', bags.stamp(i), 'camera',
                           '16UC1; compressedDepth png', deep)
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
    status, out = report(capsys, tmp_path / 'bag')
    assert status == 0
    assert row(out, '/semantic/image/compressed')[4:6] == ['png', '16x12']
    assert row(out, '/depth/image/compressedDepth')[4:8] == ['16UC1;', 'compressedDepth', 'png',
                                                             '16x12']
    assert '  depth        /depth/image/compressedDepth (CompressedImage)' in out


def test_what_is_missing_is_said_as_flags_to_paste(tmp_path, capsys):
    path = bags.write(tmp_path / 'bag')
    status, out = report(capsys, path, '--set', 'topics.depth=nothing', '--set',
                         'topics.pose=nowhere')
    assert status == 1 and 'not usable as it is' in out
    assert "missing: no depth images on 'nothing' (--set topics.depth=/depth/image)" in out
    assert "missing: no poses on 'nowhere' (--set topics.pose=/pose)" in out


def test_topics_that_are_there_and_cannot_be_used(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        at = bags.stamp(0)
        out.camera_info('depth/camera_info', at, 'camera', 16, 12, np.zeros((3, 3)))
        out.image('depth/image', at, 'camera', bags.labels(0, 12, 16), '16UC1')
        out.image('semantic/image', at, 'camera', bags.depth(0), '32FC1')
        out.pose('pose', at, 'map', np.eye(4), 'Odometry', 'base_link')
    status, out = report(capsys, tmp_path / 'bag')
    assert status == 1
    assert "label images on /semantic/image: a label image has the encoding '32FC1'" in out
    assert 'camera infos on /depth/camera_info: a camera info has fx, fy, cx, cy = 0' in out
    assert '--set pose.extrinsic=' in out
    with RecordingWriter(tmp_path / 'shape') as out:
        bags.write_images(out, 0)
        out.image('tall', bags.stamp(0), 'camera', bags.labels(0, 12, 16), 'mono16')
        out.pose('pose', bags.stamp(0), 'map', np.eye(4))
    status, out = report(capsys, tmp_path / 'shape', '--set', 'topics.labels=tall')
    assert status == 1 and 'size 12 x 16, its depth image 16 x 12' in out


def test_odd_stamps_and_damage_are_shown(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in (0, 1, 1, 0, 2):
            bags.write_images(out, i)
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
        out.message('pose', bags.stamp(3), *out.make.pose(bags.stamp(1), 'map', np.eye(4)))
    out = report(capsys, tmp_path / 'bag')[1]
    assert row(out, '/depth/image')[-3:] == ['1', 'stamps', 'repeat']
    assert '2 stamps go back, 1 stamps repeat' in out
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    file = tmp_path / 'bag' / 'bag.mcap'
    file.write_bytes(file.read_bytes()[:-2500])
    status, out = report(capsys, tmp_path / 'bag')
    assert 'note: bag.mcap is cut off' in out and 'no metadata.yaml' in out


def test_the_exit_status_of_what_is_no_recording(tmp_path, capsys):
    assert main(['info', str(tmp_path / 'nothing')]) == 1
    assert 'does not exist' in capsys.readouterr().err


def test_several_cameras(tmp_path, capsys):
    path = bags.write(tmp_path / 'bag')
    topics = [f'cameras.front.topics.{kind}=/{name}' for kind, name in (
        ('labels', 'semantic/image'), ('depth', 'depth/image'),
        ('camera_info', 'depth/camera_info'))]
    flags = [word for topic in topics for word in ('--set', topic)]
    status, out = report(capsys, path, '--set', 'cameras=[front]', *flags)
    assert status == 0 and 'a replay would use for camera front:' in out


def test_standard_error_is_quiet(tmp_path):
    path = bags.write(tmp_path / 'bag')
    done = subprocess.run([sys.executable, '-m', 'persem_ros', 'info', str(path)],
                          capture_output=True, text=True, check=True)
    assert done.stderr == '' and 'usable' in done.stdout


def test_a_part_of_a_recording(tmp_path, capsys):
    path = bags.write(tmp_path / 'bag')
    status, out = report(capsys, path, '--start', '0.2', '--every', '2')
    assert status == 0 and 'from 1700000000.200000000 s (--start 0.2, seconds after' in out
    assert ': 2 label images' in out
    assert f'usable: persem replay {path} --out DIR --start 0.2 --every 2' in out
    status, out = report(capsys, path, '--start', '9')
    assert status == 1 and 'no label image lies within --start 9' in out


def test_two_recordings_that_are_one_input(tmp_path, capsys):
    with RecordingWriter(tmp_path / 'drive') as out:
        for i in range(4):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
    with RecordingWriter(tmp_path / 'labels') as out:
        for i in range(4):
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
    both = [str(tmp_path / name) for name in ('drive', 'labels')]
    status, out = report(capsys, *both)
    assert status == 1 and f'{"+".join(both)} is one input' in out
    assert out.count('not usable as it is') == 2
    assert main(['replay', *both, '--out', str(tmp_path / 'out')]) == 1
    assert f'{"+".join(both)} is one input' in capsys.readouterr().err
    assert report(capsys, '+'.join(both))[0] == 0


def test_labels_stamped_a_day_later_are_brought_back(tmp_path, capsys):
    day = 86_400 * 10**9
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(9):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i) + day, 'camera', bags.labels(i), 'mono16')
    status, out = report(capsys, tmp_path / 'bag')
    assert status == 1 and '--set sync.offset_labels=-86400.000' in out and 'chrony' not in out
    status, out = report(capsys, tmp_path / 'bag', '--set', 'sync.offset_labels=-86400')
    assert status == 0 and '9 of 9 label images' in out
