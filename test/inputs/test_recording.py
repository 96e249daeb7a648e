"""Recordings to frames: storages, topics, order, companions, several cameras."""

from concurrent.futures import ThreadPoolExecutor
import contextlib
import shutil
import sqlite3

import bags
import numpy as np
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.frames import pinhole
from persem_ros.inputs.recording.recording import Recording
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config, updated
import pytest
import yaml


def read(path, values=None, **wanted):
    """Return (frames, recording) of one reading."""
    with Recording(path, updated(Config(), values or {})) as recording:
        return list(recording.frames(**wanted)), recording


@pytest.mark.parametrize('storage, compress', [('mcap', False), ('mcap', True),
                                               ('sqlite3', False), ('sqlite3', True)])
def test_a_recording_becomes_frames(tmp_path, storage, compress):
    frames, recording = read(bags.write(tmp_path / 'bag', storage=storage, compress=compress))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(5)]
    assert recording.expected == 5 and not recording.dropped and not recording.notes
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.labels, bags.labels(i))
        np.testing.assert_array_equal(frame.depth, bags.depth(i).astype(np.float64))
        np.testing.assert_allclose(frame.T_map_camera, bags.pose(i), atol=1e-12)
        assert (frame.labels.dtype, frame.encoding, frame.frame_id, frame.sensor) == (
            np.int32, 'mono16', 'camera', '')
        assert frame.truth is None and frame.color is None
    rays = pinhole(bags.WIDTH, bags.HEIGHT, 20.0, 20.0, 7.5, 5.5).rays
    np.testing.assert_array_equal(frames[0].camera.rays, rays)
    assert frames[0].camera is frames[4].camera     # made once


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_folder_may_be_called_anything(tmp_path, storage):
    path = bags.write(tmp_path / 'bag', storage=storage)
    for name in ('run.mcap', 'run #5 100%', 'a?b', 'aufnahme ä', 'x.db3', '.bag'):
        path = path.rename(tmp_path / name)
        frames, recording = read(path)
        assert len(frames) == 5 and not recording.notes


@pytest.mark.parametrize('storage, suffix', [('mcap', 'mcap'), ('sqlite3', 'db3')])
@pytest.mark.parametrize('compress', [False, True])
def test_a_single_file_is_a_recording(tmp_path, storage, suffix, compress):
    folder = bags.write(tmp_path / 'bag', storage=storage, compress=compress)
    frames, recording = read(folder / f'bag.{suffix}')
    assert len(frames) == 5 and recording.expected == 5 and not recording.notes


def test_several_readings_are_the_same(tmp_path):
    with Recording(bags.write(tmp_path / 'bag'), Config()) as recording:
        first, second = list(recording.frames()), list(recording.frames())
    assert [f.stamp for f in first] == [f.stamp for f in second]
    for a, b in zip(first, second):
        np.testing.assert_array_equal(a.T_map_camera, b.T_map_camera)


def test_a_reading_may_be_left_early(tmp_path):
    with Recording(bags.write(tmp_path / 'bag'), Config()) as recording:
        frames = recording.frames()
        assert next(frames).stamp == bags.stamp(0)
        frames.close()
        assert len(list(recording.frames())) == 5


def test_header_stamps_order_what_the_log_does_not(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in np.arange(-1, 6) + 0.5:
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
        for i in (1, 0, 3, 4, 2):       # recorded in this order, labels long after their depth
            msg = out.make.image(bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.message('depth/image', bags.stamp(5), 'sensor_msgs/msg/Image', msg)
        out.camera_info('depth/camera_info', bags.stamp(5), 'camera', 16, 12, bags.K)
        for i in (4, 2, 0, 1, 3):
            msg = out.make.image(bags.stamp(i), 'camera', bags.labels(i), 'mono16')
            out.message('semantic/image', bags.stamp(9), 'sensor_msgs/msg/Image', msg)
    frames, recording = read(tmp_path / 'bag')
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(5)]
    assert not recording.dropped


def test_labels_recorded_long_after_their_depth(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(120):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            if i >= 100:
                msg = out.make.image(bags.stamp(i - 100), 'camera', bags.labels(i), 'mono16')
                out.message('semantic/image', bags.stamp(i), 'sensor_msgs/msg/Image', msg)
    frames, recording = read(tmp_path / 'bag')
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(20)]
    assert recording.dropped == {'depth: no labels': 100}


def test_a_recording_of_an_older_ros(tmp_path):
    """Before Iron, SQLite recordings held no message definitions and no type hashes."""
    path = bags.write(tmp_path / 'bag', storage='sqlite3')
    with contextlib.closing(sqlite3.connect(path / 'bag.db3')) as base:
        base.executescript('DROP TABLE schema; DROP TABLE metadata; '
                           'DROP TABLE message_definitions; '
                           'ALTER TABLE topics DROP COLUMN type_description_hash')
    meta = yaml.safe_load((path / 'metadata.yaml').read_text())
    info = meta['rosbag2_bagfile_information']
    info['version'] = 4
    for name in ('custom_data', 'ros_distro', 'files'):
        info.pop(name, None)
    for topic in info['topics_with_message_count']:
        topic['topic_metadata'].pop('type_description_hash')
        profiles = topic['topic_metadata']['offered_qos_profiles']
        topic['topic_metadata']['offered_qos_profiles'] = yaml.safe_dump(profiles)
    (path / 'metadata.yaml').write_text(yaml.safe_dump(meta))
    frames, recording = read(path)
    assert len(frames) == 5 and not recording.notes


def test_poses_recorded_late_are_waited_for(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            bags.write_images(out, i)
        for i in np.arange(-1, 6) + 0.5:
            msg = out.make.pose(bags.stamp(i), 'map', bags.pose(i))
            out.message('pose', bags.stamp(i + 100), *msg)
    assert len(read(tmp_path / 'bag')[0]) == 5


def test_static_transforms_and_legend_come_first_wherever_they_are(tmp_path):
    mount = transform([0.1, 0.2, 0.3], np.array([0.5, -0.5, 0.5, -0.5]))
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(4):
            out.pose('odometry', bags.stamp(i - 0.5), 'map', bags.pose(i - 0.5), 'Odometry',
                     'base_link')
            if i < 3:
                bags.write_images(out, i)
        out.tf(bags.stamp(50), 'base_link', 'camera', mount, static=True)
        out.text('/semantic/legend', 'classes: [{id: 1, name: x}]', latched=True,
                 stamp=bags.stamp(60))
    frames, recording = read(tmp_path / 'bag', {'topics.pose': 'odometry'})
    assert len(frames) == 3 and recording.legend.name(1) == 'x'
    np.testing.assert_allclose(frames[1].T_map_camera, bags.pose(1) @ mount, atol=1e-12)


@pytest.mark.parametrize('kind', ['PoseStamped', 'PoseWithCovarianceStamped', 'Odometry',
                                  'TransformStamped'])
@pytest.mark.parametrize('setting', ['auto', None])
def test_poses_of_every_type(tmp_path, kind, setting):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i), kind)
            bags.write_images(out, i)
    frames, _ = read(tmp_path / 'bag', {'pose.type': setting or kind})
    assert len(frames) == 3
    np.testing.assert_allclose(frames[2].T_map_camera, bags.pose(2), atol=1e-12)


def test_poses_from_tf(tmp_path):
    with RecordingWriter(tmp_path / 'bag', storage='sqlite3') as out:
        out.tf(bags.stamp(-1), 'base_link', 'camera', bags.pose(30), static=True)
        for i in range(4):
            out.tf(bags.stamp(i - 0.5), 'map', 'odom', np.eye(4))
            out.tf(bags.stamp(i - 0.5), 'odom', 'base_link', bags.pose(i - 0.5))
            if i < 3:
                bags.write_images(out, i)
    frames, _ = read(tmp_path / 'bag', {'pose.source': 'tf'})
    assert len(frames) == 3
    np.testing.assert_allclose(frames[1].T_map_camera, bags.pose(1) @ bags.pose(30), atol=1e-12)


def renamed(path, names):
    """Write the usual recording with other topic names."""
    class Renaming(RecordingWriter):

        def message(self, topic, *args, **kwargs):
            super().message(names.get(topic, topic), *args, **kwargs)

    with Renaming(path) as out:
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            bags.write_images(out, i)
    return path


USUAL = ('semantic/image', 'depth/image', 'depth/camera_info', 'pose')


def test_a_namespace_is_found(tmp_path):
    path = renamed(tmp_path / 'bag', {name: f'/robot/front/{name}' for name in USUAL})
    frames, recording = read(path)
    assert len(frames) == 3
    assert recording.topics['']['depth'].name == '/robot/front/depth/image'


@pytest.mark.parametrize('name', ['/cam/depth', 'cam/depth', 'depth'])
def test_names_match_with_and_without_slash(tmp_path, name):
    path = renamed(tmp_path / 'bag', {'depth/image': '/cam/depth'})
    assert len(read(path, {'topics.depth': name})[0]) == 3


def test_an_absolute_name_is_taken_literally(tmp_path):
    path = renamed(tmp_path / 'bag', {'depth/image': '/cam/depth'})
    with pytest.raises(PersemError, match="'/depth'.*--set topics.depth=/cam/depth"):
        read(path, {'topics.depth': '/depth'})


def test_truth_and_color_join_where_they_are(tmp_path):
    color = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)

    def extra(out):
        for i in (0, 2, 4):
            out.image('semantic/truth', bags.stamp(i), 'camera', bags.labels(i + 1), 'mono16')
            out.image('color/image', bags.stamp(i + 0.1), 'camera', color, 'bgr8')

    path = bags.write(tmp_path / 'bag', extra=extra)
    frames, recording = read(path, truth=True, color=True)
    assert [f.truth is not None for f in frames] == [True, False] * 2 + [True]
    assert [f.color is not None for f in frames] == [True, False] * 2 + [True]
    np.testing.assert_array_equal(frames[2].truth, bags.labels(3))
    np.testing.assert_array_equal(frames[4].color, color[..., ::-1])
    assert recording.has('truth') and recording.has('color') and not recording.dropped
    assert all(f.truth is None and f.color is None for f in read(path)[0])


def test_labels_may_have_another_size_than_depth_and_truth_follows_them(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            bags.write_images(out, i)
            out.image('big', bags.stamp(i), 'camera', bags.labels(i, 32, 24), 'mono16')
            out.image('semantic/truth', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
    frames, _ = read(tmp_path / 'bag', {'topics.labels': 'big'}, truth=True)
    assert frames[0].labels.shape == frames[0].truth.shape == (24, 32)
    assert frames[0].depth.shape == (12, 16)
    np.testing.assert_array_equal(frames[1].truth[::2, ::2], bags.labels(1))


def test_several_cameras_leave_in_one_order(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in np.arange(-1, 8) / 2:
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i), 'Odometry', 'base_link')
        for name, shift in (('front', 0.0), ('down', 0.3)):
            mount = bags.pose(10 if name == 'front' else 20)
            out.tf(bags.stamp(0), 'base_link', name, mount, static=True)
            for i in range(3):
                at = bags.stamp(i + shift)
                out.camera_info(f'{name}/depth/camera_info', at, name, 16, 12, bags.K)
                out.image(f'{name}/depth/image', at, name, bags.depth(i), '32FC1')
                out.image(f'{name}/semantic/image', at, name, bags.labels(i), 'mono16')
    frames, recording = read(tmp_path / 'bag', {'cameras': ['front', 'down']})
    assert [f.sensor for f in frames] == ['front', 'down'] * 3
    assert [f.stamp for f in frames] == sorted(f.stamp for f in frames)
    assert recording.expected == 6 and not recording.dropped
    np.testing.assert_allclose(frames[1].T_map_camera, bags.pose(0.3) @ bags.pose(20), atol=1e-6)


def test_a_camera_info_that_changes(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(4):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            zoomed = bags.K * [[1 + i // 2], [1 + i // 2], [1]]
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, zoomed)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
    frames, _ = read(tmp_path / 'bag', {'sync.max_wait': 0.0})
    assert [f.camera.K[0, 0] for f in frames] == [20, 20, 40, 40]


def test_blind_pixels_of_a_lens_have_no_depth(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        out.pose('pose', bags.stamp(0), 'map', bags.pose(0))
        out.camera_info('depth/camera_info', bags.stamp(0), 'camera', 16, 12, bags.K,
                        D=(-6.0, 0.0, 0.0, 0.0))
        out.image('depth/image', bags.stamp(0), 'camera', bags.depth(0), '32FC1')
        out.image('semantic/image', bags.stamp(0), 'camera', bags.labels(0), 'mono16')
    frame = read(tmp_path / 'bag')[0][0]
    assert np.isnan(frame.depth[0, 0]) and np.isfinite(frame.depth[6, 8])
    assert np.isfinite(frame.camera.rays).all()


def test_a_folder_without_metadata(tmp_path):
    path = bags.write(tmp_path / 'bag')
    (path / 'metadata.yaml').unlink()
    frames, recording = read(path)
    assert len(frames) == 5 and any('metadata.yaml' in note for note in recording.notes)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_frames_may_be_read_in_another_thread(tmp_path, storage):
    path = bags.write(tmp_path / 'bag', storage=storage)
    for _ in range(2):
        with Recording(path, Config()) as recording, ThreadPoolExecutor(1) as pool:
            assert len(pool.submit(lambda: list(recording.frames())).result()) == 5
        (path / 'metadata.yaml').unlink(missing_ok=True)
        path = path.rename(tmp_path / 'run #2')     # which rosbags cannot open as SQLite


def test_a_recording_in_several_files(tmp_path):
    """Halves of one recording in one folder, as the recorder leaves them without metadata."""
    path = tmp_path / 'bag'
    path.mkdir()
    for part in range(2):
        with RecordingWriter(tmp_path / f'part{part}') as out:
            for i in range(3 * part, 3 * part + 3):
                out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
                bags.write_images(out, i)
        shutil.copy(tmp_path / f'part{part}' / f'part{part}.mcap', path / f'bag_{part}.mcap')
    frames, recording = read(path)
    assert len(frames) == recording.expected == 6
