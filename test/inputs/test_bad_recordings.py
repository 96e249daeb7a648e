"""Bad input: one clear line where nothing can be done, otherwise dropped and counted."""

from contextlib import closing

from bad_bags import IMAGE, sequence, spoiled, written
import bags
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.inputs.decode import messages
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.sqlite_file import SqliteFile
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config, updated
import pytest


def read(path, values=None, **wanted):
    """Return (frames, recording) of one reading."""
    with Recording(path, updated(Config(), values or {})) as recording:
        return list(recording.frames(**wanted)), recording


def refused(path, values=None):
    """Return the sentence with which a recording is refused."""
    with pytest.raises(PersemError) as caught:
        read(path, values)
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_what_is_no_recording(tmp_path):
    assert 'does not exist' in refused(tmp_path / 'nothing')
    (tmp_path / 'folder').mkdir()
    assert 'no recording' in refused(tmp_path / 'folder')
    assert 'persem convert' not in refused(tmp_path / 'folder')
    (tmp_path / 'folder' / 'depth').mkdir()
    (tmp_path / 'folder' / 'depth' / '0.png').touch()
    assert refused(tmp_path / 'folder').endswith(
        f'; to make one of its images: persem convert frames {tmp_path / "folder"} OUT')
    (tmp_path / 'a.txt').write_text('hello')
    assert 'no recording' in refused(tmp_path / 'a.txt')
    (tmp_path / 'old.bag').write_text('#ROSBAG V2.0')
    assert 'rosbags-convert' in refused(tmp_path / 'old.bag')
    for name in ('empty.mcap', 'empty.db3'):
        (tmp_path / name).touch()
        assert 'cannot be read' in refused(tmp_path / name)
    for name in ('noise.mcap', 'noise.db3'):
        (tmp_path / name).write_bytes(np.random.default_rng(0).bytes(5000))
        assert 'cannot be read' in refused(tmp_path / name)
    (tmp_path / 'meta').mkdir()
    (tmp_path / 'meta' / 'metadata.yaml').write_text('rosbag2_bagfile_information: [')
    assert 'cannot be read' in refused(tmp_path / 'meta')


@pytest.mark.parametrize('storage, compress', [('mcap', False), ('mcap', True),
                                               ('sqlite3', False), ('sqlite3', True)])
def test_a_recording_that_was_cut_off(tmp_path, storage, compress):
    """What is readable is used, the longer the file the more, and that is said."""
    rng = np.random.default_rng(3)

    def noise(out):     # so that compressed chunks are many
        for i in range(40):
            out.image('noise', bags.stamp(i), '', rng.integers(0, 256, (400, 400), np.uint8),
                      'mono8')

    path = bags.write(tmp_path / 'bag', frames=40, storage=storage, compress=compress,
                      extra=noise)
    file = next(f for f in path.iterdir() if f.suffix in ('.mcap', '.db3'))
    whole = file.read_bytes()
    counts = []
    for share in (0.95, 0.6, 0.3):
        file.write_bytes(whole[:int(len(whole) * share)])
        frames, recording = read(path)
        assert any('cut off' in note for note in recording.notes), recording.notes
        assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(len(frames))]
        np.testing.assert_array_equal(frames[-1].depth, bags.depth(len(frames) - 1))
        counts.append(len(frames))
    assert counts == sorted(counts, reverse=True) and counts[0] > 10, counts
    file.write_bytes(whole[:100])
    refused(path)


@pytest.mark.parametrize(('storage', 'least'), [('mcap', 60), ('sqlite3', 60)])
def test_flipped_bytes_cost_little(tmp_path, storage, least):
    path = bags.write(tmp_path / 'bag', storage=storage)
    file = next(f for f in path.iterdir() if f.suffix in ('.mcap', '.db3'))
    whole = np.frombuffer(file.read_bytes(), np.uint8)
    rng, kept = np.random.default_rng(4), []
    for _ in range(25):
        broken = whole.copy()
        broken[rng.integers(0, broken.size, 5)] ^= rng.integers(1, 256, 5).astype(np.uint8)
        file.write_bytes(broken.tobytes())
        try:
            kept.append(len(read(path)[0]))
        except PersemError as error:
            assert '\n' not in str(error)
            kept.append(0)
    assert max(kept) == 5 and sum(kept) > least, kept


def test_rows_of_a_damaged_database_that_come_again_are_left_out(tmp_path):
    path = bags.write(tmp_path / 'bag', 3, storage='sqlite3')
    file = next(path.glob('*.db3'))
    whole = file.read_bytes()
    page = next(k for k in range(0, len(whole), 4096)       # the first leaf of messages
                if whole[k] == 13 and whole[k:k + 4096].count(b'camera') > 3)
    # Bytes left out in the midst: what follows lies elsewhere, and SQLite goes round in circles.
    cut = page + 1400
    file.write_bytes(whole[:cut] + whole[cut + 93:])
    with closing(SqliteFile(file)) as opened:
        heads = list(opened.heads({channel.number for channel in opened.channels}))
        assert len(heads) == sum(channel.count for channel in opened.channels) < 20
        assert 'damaged' in opened.damage


def test_a_missing_topic_is_refused_with_flags_to_paste(tmp_path):
    path = bags.write(tmp_path / 'bag', extra=lambda out: out.image(
        'color/image', bags.stamp(9), '', np.zeros((12, 16, 3), np.uint8), 'rgb8'))
    text = refused(path, {'topics.labels': 'nothing', 'topics.pose': 'nowhere'})
    assert "no label images on 'nothing' (--set topics.labels=/semantic/image)" in text
    assert "no poses on 'nowhere' (--set topics.pose=/pose)" in text
    assert 'color' not in text and 'persem info' in text
    assert '--set topics.depth=/depth/image)' in refused(path, {'topics.depth': 'nothing'})
    assert '--set topics.camera_info=/depth/camera_info)' in refused(
        path, {'topics.camera_info': 'nothing'})
    assert 'cameras.left.topics.labels=/semantic/image' in refused(path, {'cameras': ['left']})


def test_an_optional_topic_that_somebody_typed_has_to_exist(tmp_path):
    path = bags.write(tmp_path / 'bag')
    assert "no true label images on '/gt'" in refused(path, {'topics.truth': '/gt'})
    assert "no colour images on 'rgb'" in refused(path, {'topics.color': 'rgb'})


def test_a_topic_of_the_wrong_type_is_refused(tmp_path):
    path = bags.write(tmp_path / 'bag')
    text = refused(path, {'topics.labels': 'pose'})
    assert 'PoseStamped' in text and '--set topics.labels=/semantic/image' in text
    assert 'PoseStamped' in refused(path, {'pose.type': 'Odometry'})
    assert 'Image' in refused(path, {'topics.camera_info': '/depth/image'})


def test_tf_that_is_not_there_and_tf_that_is(tmp_path):
    path = bags.write(tmp_path / 'bag')
    assert '--set topics.pose=/pose' in refused(path, {'pose.source': 'tf'})
    path = bags.write(tmp_path / 'tf', extra=lambda out: out.tf(
        bags.stamp(1), 'map', 'camera', np.eye(4)))
    assert '--set pose.source=tf' in refused(path, {'topics.pose': 'nothing'})


def test_one_topic_for_two_kinds_of_images_is_refused(tmp_path):
    path = written(tmp_path / 'bag', lambda kind, i, message: message)
    for values, words in (
            ({'topics.labels': '/depth/image'},
             ['topics.depth and topics.labels are the same topic, /depth/image (',
              '--set topics.labels=/semantic/image']),
            ({'topics.depth': '/semantic/image'},
             ['the same topic, /semantic/image (--set topics.depth=/depth/image']),
            ({'topics.truth': '/semantic/image'},
             ['topics.labels and topics.truth are the same topic'])):
        text = refused(path, values)
        for word in words:
            assert word in text


def test_of_two_kinds_on_one_topic_the_one_that_was_typed_is_offered(tmp_path):
    path = bags.write(tmp_path / 'bag', extra=lambda out: out.image(
        'color/image', bags.stamp(1), 'camera', np.zeros((12, 16, 3), 'u1'), 'rgb8'))
    assert 'the same topic, /color/image (--set topics.labels=/semantic/image); "persem' in \
        refused(path, {'topics.labels': '/color/image'})


def test_what_a_replay_left_is_no_input(tmp_path):
    path = tmp_path / 'refined'
    with RecordingWriter(path) as out:
        out.cloud('/mapper/map', bags.stamp(1), 'map', np.zeros(3, [
            ('x', 'f4'), ('y', 'f4'), ('z', 'f4'), ('label', 'u2')]))
    told = refused(path, {})
    assert 'mapper/map' not in told and f'recorded later: {path}+OTHER' in told
    (tmp_path / 'map.persem').write_bytes(b'SQLite format 3\0' + bytes(100))
    with pytest.raises(PersemError, match="is a map, no recording: 'persem map info .*map.pers"):
        Recording(tmp_path / 'map.persem', Config())


def test_a_topic_that_is_used_is_not_offered_for_something_else(tmp_path):
    # 16UC1 may be both: depth in millimetres, and ids
    with RecordingWriter(tmp_path / 'bag') as out:
        bags.write_images(out, 0)
        out.pose('pose', bags.stamp(0), 'map', bags.pose(0))
        for name in ('other', 'depth/raw'):
            out.image(name, bags.stamp(0), 'camera', bags.labels(0), '16UC1')
    text = refused(tmp_path / 'bag', {'topics.labels': 'nothing', 'topics.depth': '/depth/raw'})
    assert '--set topics.labels=/other' in text and 'topics.labels=/depth/raw' not in text
    text = refused(tmp_path / 'bag', {'topics.depth': 'nothing', 'topics.labels': '/other'})
    assert '--set topics.depth=/depth/image' in text and 'topics.depth=/other' not in text
    text = refused(bags.write(tmp_path / 'few'), {'topics.truth': 'nothing'})
    assert 'no other topic of that kind' in text


def test_colours_that_are_named_as_labels_are_offered_where_no_ids_are(tmp_path):
    def images(path, *names):
        with RecordingWriter(path) as out:
            out.image('/depth/image', bags.stamp(0), 'camera', bags.depth(0), '32FC1')
            for name, encoding, image in names:
                out.image(name, bags.stamp(0), 'camera', image, encoding)
        return refused(path)

    colours = np.zeros((12, 16, 3), np.uint8)
    text = images(tmp_path / 'a', ('/segmenter/colours', 'rgb8', colours),
                  ('/camera/color/image_raw', 'rgb8', colours))
    assert '--set topics.labels=/segmenter/colours' in text and 'color/image_raw' not in text
    text = images(tmp_path / 'b', ('/segmenter/colours', 'rgb8', colours),
                  ('/net/ids', 'mono8', colours[:, :, 0]))
    assert '--set topics.labels=/net/ids' in text and '/segmenter/' not in text


def test_a_topic_without_messages_is_refused(tmp_path):
    path = written(tmp_path / 'bag', lambda kind, i, msg: None if kind == 'depth' else msg)
    assert 'no depth images' in refused(path)


@pytest.mark.parametrize('change, reason', [
    (spoiled(encoding='yuv422'), "encoding 'yuv422'"),
    (spoiled(data=lambda msg: msg.data[:-1]), 'data too short'),
    (spoiled(data=lambda msg: msg.data[:0]), 'data too short'),
    (spoiled(width=0), 'zero size'),
    (spoiled(height=0, data=np.zeros(0, np.uint8)), 'zero size'),
    (spoiled(step=3), 'row shorter than width')])
def test_single_bad_images_are_dropped_and_counted(tmp_path, change, reason):
    frames, recording = read(written(tmp_path / 'bag', change))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in (0, 2, 4)]
    assert recording.dropped == {f'labels: {reason}': 1, f'depth: {reason}': 1}
    assert set(recording.examples) == set(recording.dropped)


def test_bad_truth_costs_the_truth_only(tmp_path):
    def change(kind, i, msg):
        if kind == 'truth' and i == 1:
            msg.encoding = 'yuv422'
        if kind == 'truth' and i == 2:
            msg.width, msg.height = msg.height, msg.width
            msg.step = msg.width * 2
        return msg

    frames, recording = read(written(tmp_path / 'bag', change), truth=True)
    assert [f.truth is None for f in frames] == [False, True, True, False, False]
    assert recording.dropped == {"truth: encoding 'yuv422'": 1,
                                 'truth: shape differs from the labels': 1}


def test_images_that_are_all_bad_end_in_one_sentence(tmp_path):
    def change(kind, i, msg):
        if kind == 'labels':
            msg.encoding = 'yuv422'
        return msg

    text = refused(written(tmp_path / 'bag', change))
    assert "labels: encoding 'yuv422' (5)" in text and 'expected one of mono8' in text


def test_sizes_of_another_shape(tmp_path):
    def change(kind, i, msg):
        if kind == 'labels':
            msg.width, msg.height, msg.step = 12, 16, 24
        return msg

    assert '12 x 16, its depth image 16 x 12' in refused(written(tmp_path / 'bag', change))

    def other(kind, i, msg):
        if kind == 'info':
            msg.width, msg.height = 640, 360
        return msg

    assert '640 x 360' in refused(written(tmp_path / 'other', other))


@pytest.mark.parametrize('value', [0.0, np.nan])
def test_a_camera_info_that_is_no_camera(tmp_path, value):
    def change(kind, i, msg):
        if kind == 'info':
            msg.k = np.full(9, value)
        return msg

    text = refused(written(tmp_path / 'bag', change))
    assert '/depth/camera_info' in text and 'fx, fy, cx, cy' in text


def test_a_camera_info_that_goes_bad_is_counted_and_the_old_one_kept(tmp_path):
    def change(kind, i, msg):
        if kind == 'info' and i >= 2:
            msg.k = np.zeros(9)
        return msg

    frames, recording = read(written(tmp_path / 'bag', change))
    assert len(frames) == 5 and recording.dropped == {'camera info: bad K': 3}


def test_depths_that_are_no_measurements_survive(tmp_path):
    def change(kind, i, msg):
        if kind == 'depth':
            values = np.array([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30], np.float32)
            msg.data = np.resize(values, 12 * 16).view(np.uint8)
        return msg

    depth = read(written(tmp_path / 'bag', change))[0][0].depth
    np.testing.assert_array_equal(depth[0, :5], [np.nan, np.inf, -np.inf, -1.0, 0.0])


def test_ids_out_of_range_survive(tmp_path):
    def change(kind, i, msg):
        if kind == 'labels':
            msg.encoding, msg.step = '32SC1', 64
            msg.data = np.resize(np.array([-1, -2**31, 65535, 2**31 - 1, 70000, 3], np.int32),
                                 12 * 16).view(np.uint8)
        return msg

    labels = read(written(tmp_path / 'bag', change))[0][0].labels
    np.testing.assert_array_equal(labels[0, :6], [-1, -2**31, 65535, 2**31 - 1, 70000, 3])


@pytest.mark.parametrize('q', [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0),
                               (0.0, 0.0, 0.0, 1.5)])
def test_poses_that_are_no_rotations_are_dropped(tmp_path, q):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            kind, msg = out.make.pose(bags.stamp(i), 'map', bags.pose(i))
            if i in (2, 4):
                msg.pose.orientation = out.make.make('geometry_msgs/msg/Quaternion', *q)
            out.message('pose', bags.stamp(i), kind, msg)
            bags.write_images(out, i)
    frames, recording = read(tmp_path / 'bag')
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(4)]
    np.testing.assert_allclose(frames[2].T_map_camera, bags.pose(2), atol=1e-6)
    assert recording.dropped == {'pose: quaternion not of length 1': 2, 'no pose': 1}


def test_no_pose_for_some_frames(tmp_path):
    path = bags.write(tmp_path / 'bag', frames=30, poses=[2.5, 3.5, 4.5, 20.5, 21.5, 22.5])
    frames, recording = read(path)
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in (3, 4, 21, 22)]
    assert recording.dropped == {'no pose': 3 + 7, 'pose gap': 16}


def test_no_pose_for_any_frame(tmp_path):
    text = refused(bags.write(tmp_path / 'bag', poses=[900]))
    # What the times of both are, the look before a replay says (test_stamps_and_lag).
    assert 'no pose (5)' in text and 'no pose that can be used' in text
    assert 'no poses' in refused(bags.write(tmp_path / 'none', poses=[]))


def test_poses_that_do_not_lead_to_the_camera(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i), 'Odometry', 'base_link')
            bags.write_images(out, i)
    text = refused(tmp_path / 'bag')
    assert "'base_link'" in text and "'camera'" in text and '--set pose.extrinsic=' in text
    mount = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    assert len(read(tmp_path / 'bag', {'pose.extrinsic': mount})[0]) == 3


def test_tf_that_does_not_reach_the_map(tmp_path):
    path = bags.write(tmp_path / 'bag', extra=lambda out: out.tf(
        bags.stamp(0), 'odom', 'base_link', np.eye(4)))
    text = refused(path, {'pose.source': 'tf'})
    assert 'no pose (5)' in text and 'odom -> base_link' in text and "'map'" in text


def test_stamps_that_repeat(tmp_path):
    frames, recording = read(sequence(tmp_path / 'bag', [0, 1, 1, 2, 2, 2, 3]))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(4)]
    assert recording.dropped['stamp repeated'] == 3


def test_stamps_that_go_back_a_little_are_sorted(tmp_path):
    frames, recording = read(sequence(tmp_path / 'bag', [0, 2, 1, 4, 3, 5]))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(6)]
    assert 'stamp went back' not in recording.dropped


def test_a_recording_that_loops(tmp_path):
    frames, recording = read(sequence(tmp_path / 'bag', [*range(40), *range(40)]))
    assert [f.stamp for f in frames] == [bags.stamp(i) for i in range(40)]
    assert recording.dropped['stamp went back'] + recording.dropped['stamp repeated'] == 40


def test_one_stamp_hours_ahead_or_back_costs_one_frame(tmp_path):
    for name, hours in (('ahead', 36_000), ('back', -36_000)):
        stamps = [*range(20), hours * 3, *range(21, 40)]
        frames, recording = read(sequence(tmp_path / name, stamps))
        kept = [f.stamp for f in frames if abs(f.stamp - bags.START) < 10 ** 12]
        assert kept == [bags.stamp(i) for i in range(40) if i != 20]
        labels = sum(n for reason, n in recording.dropped.items() if ':' not in reason)
        assert len(frames) + labels == 40


def test_a_clock_that_jumps_by_hours(tmp_path):
    frames, recording = read(sequence(tmp_path / 'ahead', [*range(20), *range(90_000, 90_020)]))
    assert len(frames) == 40 and set(recording.dropped) <= {'pose: stamp repeated'}
    frames, recording = read(sequence(tmp_path / 'back', [*range(20), *range(-90_000, -89_980)]))
    assert [f.stamp for f in frames] == sorted(f.stamp for f in frames)
    labels = sum(n for reason, n in recording.dropped.items() if ':' not in reason)
    assert len(frames) >= 20 and len(frames) + labels == 40


def test_a_damaged_message_is_counted(tmp_path):
    class Broken(RecordingWriter):

        def _write(self, connection, stamp, data):
            if connection.topic == '/semantic/image' and stamp == bags.stamp(2):
                data = bytes(data)[:40]
            super()._write(connection, stamp, data)

    with Broken(tmp_path / 'bag') as out:
        for i in range(4):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            bags.write_images(out, i)
    frames, recording = read(tmp_path / 'bag')
    assert len(frames) == 3 and recording.dropped == {'labels: damaged message': 1}


def test_every_label_image_is_used_or_counted(tmp_path):
    """Whatever happens, frames and drops (reasons for label images) add up."""
    rng = np.random.default_rng(5)
    with RecordingWriter(tmp_path / 'bag') as out:
        out.camera_info('depth/camera_info', bags.stamp(0), 'camera', 16, 12, bags.K)
        total = 0
        for i in range(200):
            at = bags.stamp(i) + int(rng.normal(0, 2e7))
            if rng.random() < 0.8:
                out.image('depth/image', at + int(rng.choice([0, 0, 10_000_000])), 'camera',
                          bags.depth(i), '32FC1')
            if rng.random() < 0.9:
                image = out.make.image(at, 'camera', bags.labels(i), 'mono16')
                image.encoding = 'mono16' if rng.random() < 0.95 else 'huh'
                out.message('semantic/image', bags.stamp(i) + int(rng.integers(0, 10 ** 9)),
                            IMAGE, image)
                total += 1
            if rng.random() < 0.5:
                out.pose('pose', at, 'map', bags.pose(i))
    frames, recording = read(tmp_path / 'bag')
    dropped = sum(n for reason, n in recording.dropped.items()
                  if not reason.startswith(('depth: no', 'depth: stamp', 'pose: ')))
    assert len(frames) + dropped == total == recording.expected
    assert len(frames) > 50


def test_the_fault_of_a_message_has_a_reason_and_a_sentence():
    fault = messages.BadMessage('too odd', 'this message is too odd')
    assert isinstance(fault, PersemError)
    assert (fault.reason, str(fault)) == ('too odd', 'this message is too odd')
