"""Messages are paired by header stamp, whatever their log times and wherever they lie."""

import bags
from hypothesis import given, settings, strategies as st
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.stamps import stamp_of
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.settings.config import Config, updated
import pytest

IMAGE = 'sensor_msgs/msg/Image'
DAY = 86_400 * 10**9


def read(path, excerpt=Excerpt(), values=None, **wanted):
    """Return (frames, dropped, notes) of an input."""
    with Recording(path, updated(Config(), values or {}), excerpt=excerpt) as recording:
        return list(recording.frames(**wanted)), recording.dropped, recording.notes


def numbers(frames):
    """Return the numbers of frames by their stamps."""
    return [(f.stamp - bags.START) / bags.STEP for f in frames]


def put(out, topic, i, array, encoding, log):
    """Write an image of frame *i* that was recorded at *log*, ns."""
    out.message(topic, log, IMAGE, out.make.image(bags.stamp(i), 'camera', array, encoding))


def drive(out, frames, log=lambda i: bags.stamp(i)):
    """Write poses, depth and camera infos."""
    for i in range(frames):
        out.message('pose', log(i), *out.make.pose(bags.stamp(i), 'map', bags.pose(i)))
        put(out, 'depth/image', i, bags.depth(i), '32FC1', log(i))
        out.message('depth/camera_info', log(i), 'sensor_msgs/msg/CameraInfo',
                    out.make.camera_info(bags.stamp(i), 'camera', 16, 12, bags.K))


def labelled(out, frames, log):
    """Write label images of frames in the given order."""
    for i in frames:
        put(out, 'semantic/image', i, bags.labels(i), 'mono16', log(i))


def check(frames, count):
    """Fail unless frames 0 to *count* - 1 are there, each with its own labels, depth and pose."""
    assert numbers(frames) == list(range(count))
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.labels, bags.labels(i))
        np.testing.assert_array_equal(frame.depth, bags.depth(i).astype(float))
        np.testing.assert_allclose(frame.T_map_camera, bags.pose(i), atol=1e-12)


@pytest.mark.parametrize('storage, compress', [('mcap', False), ('mcap', True),
                                               ('sqlite3', False), ('sqlite3', True)])
def test_labels_recorded_a_day_later_in_the_same_file(tmp_path, storage, compress):
    with RecordingWriter(tmp_path / 'bag', storage=storage, compress=compress) as out:
        drive(out, 60)
        labelled(out, range(60), lambda i: bags.stamp(i) + DAY)
    frames, dropped, notes = read(tmp_path / 'bag')
    check(frames, 60)
    assert not dropped and not notes


def test_two_recordings_as_one_input(tmp_path):
    with RecordingWriter(tmp_path / 'drive') as out:
        drive(out, 40)
    with RecordingWriter(tmp_path / 'labels', storage='sqlite3') as out:
        labelled(out, range(40), lambda i: bags.stamp(i) + DAY)
    frames, dropped, notes = read(f'{tmp_path / "drive"}+{tmp_path / "labels"}')
    check(frames, 40)
    assert not dropped and not notes
    frames, *_ = read(f'{tmp_path / "labels"}+{tmp_path / "drive"}')
    check(frames, 40)


def test_poses_computed_later(tmp_path):
    """As SLAM over a recording gives them: one after the other, stamped as the images are."""
    bags.write(tmp_path / 'drive', frames=20, poses=[])
    with RecordingWriter(tmp_path / 'slam') as out:
        for i in reversed(range(20)):
            out.message('pose', bags.stamp(19 - i) + DAY,
                        *out.make.pose(bags.stamp(i), 'map', bags.pose(i)))
    frames, dropped, _ = read(f'{tmp_path / "drive"}+{tmp_path / "slam"}')
    check(frames, 20)
    assert not dropped


@settings(max_examples=8, deadline=None)
@given(order=st.permutations(range(12)), seed=st.integers(0, 9))
def test_any_order_in_the_file_gives_the_same_frames(tmp_path_factory, order, seed):
    path, rng = tmp_path_factory.mktemp('order') / 'bag', np.random.default_rng(seed)
    with RecordingWriter(path) as out:
        drive(out, 12, lambda i: bags.START + int(rng.integers(0, 10**12)))
        labelled(out, order, lambda i: bags.START + int(rng.integers(0, 10**12)))
    frames, dropped, _ = read(path)
    check(frames, 12)
    assert not dropped


def test_images_held_do_not_grow_with_the_recording(tmp_path, monkeypatch):
    """Labels at the end of the file, more depth before them than a queue may hold."""
    monkeypatch.setattr('persem_ros.inputs.intake.QUEUE_BYTES', 4000)
    monkeypatch.setattr('persem_ros.inputs.recording.mcap_chunks.KEPT', 4000)
    with RecordingWriter(tmp_path / 'bag', compress=True) as out:
        drive(out, 150)
        labelled(out, range(150), lambda i: bags.stamp(i) + DAY)
    frames, dropped, _ = read(tmp_path / 'bag', values={'sync.max_wait': 600.0})
    check(frames, 150)
    assert not dropped


@pytest.mark.parametrize('start, end, expected', [
    ('0.2', '', [2, 3, 4, 5, 6, 7]), ('', '0.3', [0, 1, 2, 3]), ('0.2', '0.4', [2, 3, 4]),
    ('1700000000.2', '', [2, 3, 4, 5, 6, 7]), ('', '1700000000300000000', [0, 1, 2, 3]),
    ('1700000000.35', '0.55', [4, 5])])
def test_start_and_end(tmp_path, start, end, expected):
    path = bags.write(tmp_path / 'bag', frames=8)
    with Recording(path, Config(), excerpt=Excerpt(start, end)) as recording:
        assert numbers(recording.frames()) == expected
        assert numbers(recording.frames()) == expected
        assert recording.expected == len(expected) and not recording.dropped


def test_seconds_count_from_the_first_complete_frame(tmp_path):
    path = bags.write(tmp_path / 'bag', frames=8, poses=np.arange(3, 9) - 0.5)
    with Recording(path, Config(), excerpt=Excerpt(start='0.2')) as recording:
        assert numbers(recording.frames()) == [5, 6, 7]
        assert 'from 1700000000.500000000 s (--start 0.2, seconds after the first frame)' in \
            recording.excerpt.sentence(recording.bounds)


def test_what_comes_before_the_start_counts(tmp_path):
    """Static transforms, the last pose before, and the camera info."""
    with RecordingWriter(tmp_path / 'bag') as out:
        out.tf(bags.stamp(0), 'base_link', 'camera', bags.pose(30), static=True)
        out.camera_info('depth/camera_info', bags.stamp(0), 'camera', 16, 12, bags.K)
        for i in range(10):
            out.pose('pose', bags.stamp(i - 0.5), 'map', np.eye(4), 'Odometry', 'base_link')
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
        out.pose('pose', bags.stamp(9.5), 'map', np.eye(4), 'Odometry', 'base_link')
    frames, dropped, _ = read(tmp_path / 'bag', Excerpt(start='0.7'))
    assert numbers(frames) == [7, 8, 9] and not dropped
    np.testing.assert_allclose(frames[0].T_map_camera, bags.pose(30), atol=1e-12)


def test_every_third_complete_frame(tmp_path):
    path = bags.write(tmp_path / 'bag', frames=12, poses=np.arange(1, 13) - 0.5)
    assert numbers(read(path, Excerpt(every=3))[0]) == [1, 4, 7, 10]
    assert numbers(read(path, Excerpt(start='0.1', end='0.9', every=3))[0]) == [2, 5, 8]


def test_every_second_frame_of_each_camera(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in np.arange(-1, 9) / 2:
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
        for i in range(4):
            for name, shift in (('front', 0.0), ('down', 0.3)):
                at = bags.stamp(i + shift)
                out.camera_info(f'{name}/depth/camera_info', at, name, 16, 12, bags.K)
                out.image(f'{name}/depth/image', at, name, bags.depth(i), '32FC1')
                out.image(f'{name}/semantic/image', at, name, bags.labels(i), 'mono16')
    frames, *_ = read(tmp_path / 'bag', Excerpt(every=2), {'cameras': ['front', 'down']})
    assert [f.sensor for f in frames] == ['front', 'down'] * 2
    assert numbers(frames) == [0, 0.3, 2, 2.3]


@pytest.mark.parametrize('given, word', [
    ({'start': 'soon'}, '--start soon'), ({'end': '-3'}, '--end -3'), ({'every': 0}, '--every 0'),
    ({'start': '9', 'end': '3'}, '--end 3 is before --start 9'), ({'start': 'nan'}, 'nan')])
def test_options_that_mean_nothing(given, word):
    with pytest.raises(PersemError, match=word):
        Excerpt(**given)


def test_an_excerpt_outside_of_the_recording_is_refused_with_its_span(tmp_path):
    path = bags.write(tmp_path / 'bag')
    with pytest.raises(PersemError, match='no label image lies within --start 50: they run from '
                                          '1700000000.000000000 s to 1700000000.400000000 s'):
        read(path, Excerpt(start='50'))


@pytest.mark.parametrize('later', [0, DAY])
@pytest.mark.parametrize('late', [0, 3])
def test_a_legend_that_changes_counts_for_the_labels_recorded_after_it(tmp_path, late, later):
    """Also where labels are recorded some frames after the depth of their stamp."""
    def legend(*names):
        return 'classes:\n' + ''.join(f'- {{id: {i + 1}, name: {name}}}\n'
                                      for i, name in enumerate(names))

    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(12):
            drive_log = bags.stamp(i)
            out.message('pose', drive_log, *out.make.pose(bags.stamp(i), 'map', bags.pose(i)))
            put(out, 'depth/image', i, bags.depth(i), '32FC1', drive_log)
            out.message('depth/camera_info', drive_log, 'sensor_msgs/msg/CameraInfo',
                        out.make.camera_info(bags.stamp(i), 'camera', 16, 12, bags.K))
            if not later and i >= late:
                changing(out, i - late, bags.stamp(i) + 1, legend)
        for i in range(12) if later else ():
            changing(out, i, bags.stamp(i) + later, legend)
    with Recording(tmp_path / 'bag', Config()) as recording:
        frames = list(recording.frames())
    assert numbers(frames) == list(range(12 if later else 12 - late))
    first = frames[0].labels[0, 0]
    assert all((f.labels == first).all() for f in frames)


def changing(out, i, log, legend):
    """Write the label image of frame *i*, all tree, whose id changes with frame 5."""
    if i in (0, 5):
        out.text('semantic/legend', legend(*(('tree', 'road') if i < 5 else ('road', 'tree'))),
                 stamp=log)
    put(out, 'semantic/image', i, np.full((12, 16), 1 if i < 5 else 2, np.uint16), 'mono16',
        log + 1)


def test_the_stamp_of_a_message_is_in_its_first_bytes():
    with_header = bytes([0, 1, 0, 0]) + (7).to_bytes(4, 'little') + (9).to_bytes(4, 'little')
    assert stamp_of(IMAGE, with_header) == 7_000_000_009
    assert stamp_of('nav_msgs/msg/Odometry', bytes([0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 9])) == \
        7_000_000_009
    assert stamp_of(IMAGE, with_header[:11]) is None
    assert stamp_of('std_msgs/msg/String', with_header) is None
    tf = bytes([0, 1, 0, 0, 1, 0, 0, 0]) + with_header[4:]
    assert stamp_of('tf2_msgs/msg/TFMessage', tf) == 7_000_000_009
    assert stamp_of('tf2_msgs/msg/TFMessage', bytes([0, 1, 0, 0]) + bytes(30)) is None
    assert stamp_of('foreign_msgs/msg/Thing', with_header) is None
