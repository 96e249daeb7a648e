"""Recordings: whole or absent, readable by rosbags, right in every field."""

import errno
from pathlib import Path
import re
import signal
import subprocess
import sys

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.outputs.recording.writer import RecordingWriter
import pytest
import quick_yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
import yaml

STAMP = 1_658_137_057_641_204_937
T = np.array([[0.0, -1, 0, 1.5], [1, 0, 0, -2], [0, 0, 1, 3], [0, 0, 0, 1]])


def read(path):
    """Return [(topic, log time, message)] of a recording, in order of log time."""
    with AnyReader([Path(path)]) as reader:
        return [(c.topic, stamp, reader.deserialize(raw, c.msgtype))
                for c, stamp, raw in reader.messages()]


@pytest.fixture(params=[('mcap', False), ('mcap', True), ('sqlite3', False), ('sqlite3', True)],
                ids=lambda p: f'{p[0]}{"-zstd" if p[1] else ""}')
def kind(request):
    """Return storage and compression."""
    return dict(zip(('storage', 'compress'), request.param, strict=True))


@pytest.mark.parametrize('encoding, dtype, shape', [
    ('mono8', 'u1', (3, 5)), ('8UC1', 'u1', (3, 5)), ('mono16', 'u2', (3, 5)),
    ('16UC1', '>u2', (3, 5)), ('16SC1', 'i2', (3, 5)), ('32SC1', 'i4', (3, 5)),
    ('32FC1', 'f4', (3, 5)), ('rgb8', 'u1', (3, 5, 3)), ('bgr8', 'u1', (3, 5, 3))])
def test_images_come_back(tmp_path, kind, encoding, dtype, shape):
    array = (np.arange(np.prod(shape)) * 7 - 3).astype('i4').astype(dtype).reshape(shape)
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.image('depth/image', STAMP, 'camera', array[:, ::-1], encoding)
    (topic, log_time, image), = read(tmp_path / 'r')
    assert (topic, log_time) == ('/depth/image', STAMP)
    assert (image.header.stamp.sec, image.header.stamp.nanosec) == (1_658_137_057, 641_204_937)
    assert (image.header.frame_id, image.encoding) == ('camera', encoding)
    assert (image.height, image.width, image.is_bigendian) == (3, 5, 0)
    native = np.dtype(dtype).newbyteorder('<')
    assert image.step == 5 * native.itemsize * (3 if len(shape) == 3 else 1)
    np.testing.assert_array_equal(image.data.view(native).reshape(shape), array[:, ::-1])


@pytest.mark.parametrize('array, encoding', [
    (np.zeros((2, 2)), '32FC1'), (np.zeros((2, 2, 3), 'u1'), 'mono8'),
    (np.zeros((2, 2), 'u1'), 'rgb8'), (np.zeros((2, 2, 4), 'u1'), 'rgb8'),
    (np.zeros((2, 2), 'u1'), 'yuv422')])
def test_an_array_that_is_not_of_the_encoding_is_refused(tmp_path, array, encoding):
    with pytest.raises(PersemError, match=encoding), RecordingWriter(tmp_path / 'r') as out:
        out.image('a', STAMP, 'camera', array, encoding)
    assert list(tmp_path.iterdir()) == []


def test_camera_info_poses_and_transforms(tmp_path, kind):
    K = np.array([[100.0, 0, 50], [0, 110, 40], [0, 0, 1]])
    kinds = ['PoseStamped', 'PoseWithCovarianceStamped', 'Odometry', 'TransformStamped']
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.camera_info('info', STAMP, 'camera', 101, 81, K, [0.1, 0.2, 0, 0, 0.3])
        out.camera_info('info', STAMP + 1, 'camera', 101, 81, K, P=np.eye(3, 4))
        for i, name in enumerate(kinds):
            out.pose(name, STAMP + 2 + i, 'map', T, name, 'camera')
        out.tf(STAMP + 9, 'map', 'base', T)
        out.tf(STAMP + 10, 'base', 'camera', T, static=True)
    messages = [message for _, _, message in read(tmp_path / 'r')]
    first, second = messages[:2]
    assert (first.width, first.height, first.distortion_model) == (101, 81, 'plumb_bob')
    assert first.k.tolist() == K.ravel().tolist()
    assert first.d.tolist() == [0.1, 0.2, 0, 0, 0.3]
    assert first.r.tolist() == np.eye(3).ravel().tolist()
    assert first.p.reshape(3, 4)[:, :3].tolist() == K.tolist()
    assert second.p.tolist() == np.eye(3, 4).ravel().tolist() and len(second.d) == 0
    stamped, covariance, odometry, transform, tf, static = messages[2:]
    for position, rotation in (
            (stamped.pose.position, stamped.pose.orientation),
            (covariance.pose.pose.position, covariance.pose.pose.orientation),
            (odometry.pose.pose.position, odometry.pose.pose.orientation),
            (transform.transform.translation, transform.transform.rotation),
            (tf.transforms[0].transform.translation, tf.transforms[0].transform.rotation),
            (static.transforms[0].transform.translation, static.transforms[0].transform.rotation)):
        assert (position.x, position.y, position.z) == (1.5, -2, 3)
        assert np.allclose([rotation.x, rotation.y, rotation.z, rotation.w],
                           [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert odometry.child_frame_id == transform.child_frame_id == 'camera'
    assert static.transforms[0].header.frame_id == 'base'


def test_clouds_and_compressed_images(tmp_path, kind):
    dtype = np.dtype({'names': ['x', 'label', 'source'], 'formats': ['<f4', '<u2', 'u1'],
                      'offsets': [0, 8, 12], 'itemsize': 16})
    points = np.zeros(3, dtype)
    points['x'], points['label'], points['source'] = [1.5, -2, 0], [0, 65534, 7], [1, 2, 3]
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.cloud('map', STAMP, 'map', points, latched=True)
        out.compressed('labels', STAMP + 1, 'camera', 'png', b'abc')
    (_, _, cloud), (_, _, compressed) = read(tmp_path / 'r')
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ('x', 0, 7, 1), ('label', 8, 4, 1), ('source', 12, 2, 1)]
    assert (cloud.point_step, cloud.row_step, cloud.width, cloud.height) == (16, 48, 3, 1)
    np.testing.assert_array_equal(cloud.data.view(dtype), points)
    assert (compressed.format, compressed.data.tobytes()) == ('png', b'abc')


def test_latched_topics_say_so(tmp_path, kind):
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.text('legend', 'text', latched=True)
        out.tf(None, 'base', 'camera', T, static=True)
        out.tf(STAMP, 'map', 'base', T)
    with AnyReader([tmp_path / 'r']) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
    for topic in ('/legend', '/tf_static'):
        assert qos[topic].durability is QosDurability.TRANSIENT_LOCAL
        assert qos[topic].reliability is QosReliability.RELIABLE
    assert qos['/tf'].durability is QosDurability.VOLATILE


@pytest.fixture
def ruamel():
    """Give rosbags its own YAML back for a test."""
    quick_yaml.use(quick_yaml.RUAMEL)
    yield
    quick_yaml.use(quick_yaml.Yaml)


def test_the_yaml_of_tests_says_what_that_of_users_says(tmp_path, kind, ruamel):
    def look(path, by):
        quick_yaml.use(by)
        with AnyReader([path]) as reader:
            return [(c.topic, c.msgtype, c.digest, c.msgcount, c.ext) for c in reader.connections]

    found = []
    for by in (quick_yaml.RUAMEL, quick_yaml.Yaml):
        quick_yaml.use(by)
        with RecordingWriter(tmp_path / by.__module__ / 'r', **kind) as out:
            out.text('legend', 'text', latched=True)
            out.tf(STAMP, 'map', 'base', T)
        text = (tmp_path / by.__module__ / 'r' / 'metadata.yaml').read_text()
        values = yaml.safe_load(text)
        for topic in values['rosbag2_bagfile_information']['topics_with_message_count']:
            profiles = topic['topic_metadata'].pop('offered_qos_profiles')
            topic['qos'] = yaml.safe_load(profiles)
        found.append((values, [look(tmp_path / by.__module__ / 'r', reader)
                               for reader in (quick_yaml.RUAMEL, quick_yaml.Yaml)]))
    assert found[0] == found[1] and found[0][1][0] == found[0][1][1]


def test_what_has_no_stamp_does_not_stretch_the_recording(tmp_path, kind):
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.text('legend', 'text', latched=True)
        out.pose('pose', STAMP, 'map', T)
        out.pose('pose', STAMP + 5, 'map', T)
    assert {(topic, stamp) for topic, stamp, _ in read(tmp_path / 'r')} == {
        ('/legend', STAMP), ('/pose', STAMP), ('/pose', STAMP + 5)}


def test_metadata_as_ros_reads_it(tmp_path, kind):
    with RecordingWriter(tmp_path / 'r', **kind) as out:
        out.pose('pose', STAMP, 'map', T)
        out.pose('pose', STAMP + 5, 'map', T)
    info = yaml.safe_load((tmp_path / 'r/metadata.yaml').read_text())
    info = info['rosbag2_bagfile_information']
    assert info['storage_identifier'] == kind['storage']
    assert info['relative_file_paths'] == ['r.mcap' if kind['storage'] == 'mcap' else 'r.db3']
    assert (tmp_path / 'r' / info['relative_file_paths'][0]).is_file()
    assert info['starting_time']['nanoseconds_since_epoch'] == STAMP
    assert info['duration']['nanoseconds'] == 5
    assert info['message_count'] == 2
    # rosbag2 knows message compression from here; chunks of an mcap speak for themselves.
    by_message = kind == {'storage': 'sqlite3', 'compress': True}
    assert info['compression_mode'] == ('message' if by_message else '')
    topic, = info['topics_with_message_count']
    assert topic['topic_metadata']['type_description_hash'].startswith('RIHS01_')


def test_nothing_remains_of_a_failure(tmp_path, kind):
    with pytest.raises(KeyboardInterrupt), RecordingWriter(tmp_path / 'r', **kind) as out:
        out.pose('pose', STAMP, 'map', T)
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_killed_writer_leaves_nothing_under_the_name(tmp_path):
    code = ('import sys, time\nimport numpy as np\n'
            'from persem_ros.outputs.recording.writer import RecordingWriter\n'
            'with RecordingWriter(sys.argv[1]) as out:\n'
            "    out.pose('pose', 1, 'map', np.eye(4))\n"
            "    print('writing', flush=True)\n    time.sleep(60)\n")
    process = subprocess.Popen([sys.executable, '-c', code, str(tmp_path / 'r')],
                               stdout=subprocess.PIPE, cwd=Path(__file__).parents[2])
    assert process.stdout.readline() == b'writing\n'
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert not (tmp_path / 'r').exists()


def test_a_full_folder_is_refused_and_force_replaces_recordings_only(tmp_path):
    target = tmp_path / 'r'
    for _ in range(2):
        with RecordingWriter(target, force=True) as out:
            out.pose('pose', STAMP, 'map', T)
    with pytest.raises(PersemError, match='not empty; give another name, or --force'):
        RecordingWriter(target)
    with RecordingWriter(target, storage='sqlite3', force=True) as out:
        out.pose('other', STAMP, 'map', T)
    assert [topic for topic, _, _ in read(target)] == ['/other']
    assert sorted(p.name for p in tmp_path.iterdir()) == ['r']
    (tmp_path / 'papers').mkdir()
    (tmp_path / 'papers/thesis.tex').write_text('x')
    with pytest.raises(PersemError, match='not a recording'):
        RecordingWriter(tmp_path / 'papers', force=True)
    with pytest.raises(PersemError, match='is a file'):
        RecordingWriter(tmp_path / 'papers/thesis.tex', force=True)


@pytest.mark.parametrize('extra, said', [
    (('notes.txt', 'other_flight.mcap'),
     'r also holds notes.txt, other_flight.mcap, which are not of the recording; --force does not '
     'delete them; give another name'),
    (('.notes',), 'r also holds .notes, which is not of the recording; --force does not delete '
     'it; give'),
    (('sub/a.mcap',), 'r also holds sub/, which is not of the recording'),
    (tuple(f'{i}.txt' for i in range(7)), '0.txt, 1.txt, 2.txt, 3.txt, 4.txt, …, which are')])
def test_force_deletes_nothing_that_is_not_of_the_recording(tmp_path, kind, extra, said):
    target = tmp_path / 'r'
    with RecordingWriter(target, **kind) as out:
        out.pose('old', STAMP, 'map', T)
    for name in extra:
        (target / name).parent.mkdir(exist_ok=True)
        (target / name).write_text('mine')
    before = {p: p.read_bytes() for p in target.rglob('*') if p.is_file()}
    with pytest.raises(PersemError, match=re.escape(said)):
        RecordingWriter(target, force=True)
    assert {p: p.read_bytes() for p in target.rglob('*') if p.is_file()} == before
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize('metadata', [
    None, '', '[', 'a: 1', 'rosbag2_bagfile_information: 3',
    'rosbag2_bagfile_information: {relative_file_paths: []}',
    'rosbag2_bagfile_information: {relative_file_paths: a.mcap}'])
def test_a_folder_without_metadata_that_lists_files_is_no_recording(tmp_path, metadata):
    (tmp_path / 'r').mkdir()
    (tmp_path / 'r/a.mcap').write_bytes(b'x')
    if metadata is not None:
        (tmp_path / 'r/metadata.yaml').write_text(metadata)
    with pytest.raises(PersemError, match='not a recording'):
        RecordingWriter(tmp_path / 'r', force=True)
    assert (tmp_path / 'r/a.mcap').read_bytes() == b'x'


def test_what_comes_into_the_folder_while_the_new_one_is_written_stays(tmp_path):
    target = tmp_path / 'r'
    with RecordingWriter(target) as out:
        out.pose('old', STAMP, 'map', T)
    with pytest.raises(PersemError, match='also holds notes.txt'), \
            RecordingWriter(target, force=True) as out:
        out.pose('new', STAMP, 'map', T)
        (target / 'notes.txt').write_text('mine')
    assert (target / 'notes.txt').read_text() == 'mine'
    assert [topic for topic, _, _ in read(target)] == ['/old']


@pytest.mark.parametrize('error', [KeyboardInterrupt, OSError(errno.EIO, 'Input/output error')])
def test_an_error_while_the_new_one_takes_the_place_keeps_the_old_one(
        tmp_path, monkeypatch, error):
    """Renaming fails once, when the old recording is out of the way."""
    target = tmp_path / 'replaced'
    with RecordingWriter(target) as out:
        out.pose('old', STAMP, 'map', T)
    rename, calls = Path.rename, []

    def failing(self, to):
        calls.append(self)
        if len(calls) == 2:
            raise error
        return rename(self, to)

    monkeypatch.setattr(Path, 'rename', failing)
    with pytest.raises((KeyboardInterrupt, PersemError)), \
            RecordingWriter(target, force=True) as out:
        out.pose('new', STAMP, 'map', T)
    assert [topic for topic, _, _ in read(target)] == ['/old']
    assert list(tmp_path.iterdir()) == [target]
    monkeypatch.undo()
    with RecordingWriter(target, force=True) as out:        # whatever the folder is called
        out.pose('new', STAMP, 'map', T)
    assert [topic for topic, _, _ in read(target)] == ['/new']


def test_force_keeps_the_old_recording_when_the_new_one_fails(tmp_path):
    with RecordingWriter(tmp_path / 'r') as out:
        out.pose('old', STAMP, 'map', T)
    with pytest.raises(ZeroDivisionError), RecordingWriter(tmp_path / 'r', force=True) as out:
        out.pose('new', STAMP, 'map', T)
        raise ZeroDivisionError
    assert [topic for topic, _, _ in read(tmp_path / 'r')] == ['/old']


def test_an_empty_folder_is_used_and_missing_parents_are_made(tmp_path):
    (tmp_path / 'empty').mkdir()
    for target in (tmp_path / 'empty', tmp_path / 'a/b/c'):
        with RecordingWriter(target) as out:
            out.pose('pose', STAMP, 'map', T)
        assert len(read(target)) == 1


def test_a_disk_that_fills_up_is_one_sentence(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    with pytest.raises(PersemError, match='cannot write .*/r: No space left on device'), \
            RecordingWriter(tmp_path / 'r') as out:
        out.pose('pose', STAMP, 'map', T)
        monkeypatch.setattr(out._writer.storage, 'write', full)
        out.pose('pose', STAMP, 'map', T)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_below_a_file_cannot_be_written(tmp_path):
    (tmp_path / 'file').write_text('x')
    with pytest.raises(PersemError, match='cannot write'), RecordingWriter(tmp_path / 'file/r'):
        pass


def test_an_unknown_storage_names_the_known_ones(tmp_path):
    with pytest.raises(PersemError, match='expected one of mcap, sqlite3'):
        RecordingWriter(tmp_path / 'r', storage='bag')


def test_an_unknown_pose_type_names_the_known_ones(tmp_path):
    with pytest.raises(PersemError, match='expected PoseStamped'), \
            RecordingWriter(tmp_path / 'r') as out:
        out.pose('pose', STAMP, 'map', T, 'Pose')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_metadata_is_of_a_form_that_humble_reads(tmp_path, storage):
    """Before Jazzy, QoS profiles are one text of numbers: a YAML list ends the reader there."""
    with RecordingWriter(tmp_path / 'bag', storage=storage) as out:
        out.text('legend', 'x', latched=True, stamp=5)
    info = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    info = info['rosbag2_bagfile_information']
    profiles = info['topics_with_message_count'][0]['topic_metadata']['offered_qos_profiles']
    assert info['version'] == 8 and isinstance(profiles, str)
    assert yaml.safe_load(profiles)[0]['durability'] == 1       # transient local
