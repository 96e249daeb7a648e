"""What the first images of a recording say: depth that is none, ids that are no classes."""

from contextlib import closing

import bags
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.outputs.recording.writer import RecordingWriter
from persem_ros.preflight.look import opened
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend_files import load_legend
import pytest


def written(path, labels=None, depth=None, encodings=('mono16', '32FC1'), info=(16, 12)):
    """Write five frames; labels(i) and depth(i) replace the images."""
    with RecordingWriter(path) as out:
        for i in range(5):
            at = bags.stamp(i)
            out.pose('pose', at, 'map', bags.pose(i))
            out.camera_info('depth/camera_info', at, 'camera', *info, bags.K)
            out.image('depth/image', at, 'camera', (depth or bags.depth)(i), encodings[1])
            out.image('semantic/image', at, 'camera', (labels or bags.labels)(i), encodings[0])
    return path


def looked(path, **values):
    """Open a recording and read a frame; dots in names are double underscores."""
    config = updated(Config(), {k.replace('__', '.'): v for k, v in values.items()})
    with closing(opened(path, config)) as recording:
        return next(recording.frames())


def half(value, dtype):
    """Return a function that gives the depth image of a frame whose left half is *value*."""
    def depth(i):
        image = (bags.depth(i) * (1000 if dtype == np.uint16 else 1)).astype(dtype)
        image[:, :8] = value
        return image
    return depth


@pytest.mark.parametrize('value, dtype, encoding, flag', [
    (65535, np.uint16, '16UC1', 'memory.max_depth=64.9'),
    (100.0, np.float32, '32FC1', 'memory.max_depth=99')])
def test_a_number_for_nothing_is_noticed(tmp_path, caplog, value, dtype, encoding, flag):
    path = written(tmp_path / 'bag', depth=half(value, dtype), encodings=('mono16', encoding))
    looked(path)
    assert f'--set {flag} leaves them out' in caplog.text and '50.0 %' in caplog.text
    caplog.clear()
    looked(path, memory__max_depth=float(flag.partition('=')[2]))
    assert 'leaves them out' not in caplog.text


def test_a_wall_behind_is_no_far_plane(tmp_path, caplog):
    looked(written(tmp_path / 'bag', depth=half(2.5, np.float32)))
    assert not caplog.text


def test_a_camera_info_of_another_shape_is_refused_at_once(tmp_path):
    with pytest.raises(PersemError, match='16 x 12, its camera info 32 x 18.*topics.camera_info'):
        opened(written(tmp_path / 'bag', info=(32, 18)), Config())


def test_a_recording_without_camera_infos_says_what_to_give(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(3):
            bags.write_images(out, i)
    with RecordingWriter(tmp_path / 'bare') as out:
        for i in range(3):
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
    with pytest.raises(PersemError, match=r'no camera infos .*: /.*/bare\+OTHER'):
        opened(tmp_path / 'bare', Config())
    with RecordingWriter(tmp_path / 'other') as out:        # a day later, with its stamp
        at = bags.stamp(10**6)
        out.camera_info('depth/camera_info', at, 'camera', bags.WIDTH, bags.HEIGHT, bags.K)
    with closing(opened(f'{tmp_path / "bare"}+{tmp_path / "other"}', Config())) as recording:
        assert len(list(recording.frames())) == 3


def test_a_drive_without_labels_says_where_they_may_be(tmp_path):
    """A depth image in 16 bits might be labels, but not one that is called depth."""
    with RecordingWriter(tmp_path / 'drive') as out:
        for i in range(3):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('camera/depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.image('camera/depth/image_rect_raw', bags.stamp(i), 'camera',
                      (bags.depth(i) * 1000).astype('u2'), '16UC1')
    with pytest.raises(PersemError) as refused:
        opened(tmp_path / 'drive', Config())
    assert f'recorded later: {tmp_path / "drive"}+OTHER' in str(refused.value)
    assert 'topics.labels=/camera/depth' not in str(refused.value)
    assert '--set topics.depth=/camera/depth/image_rect_raw' in str(refused.value)


def test_one_channel_of_colours_is_refused(tmp_path):
    town = load_legend('town')
    path = written(tmp_path / 'bag', lambda i: town.colors(bags.labels(i)), encodings=(
        'rgb8', '32FC1'))
    with pytest.raises(PersemError, match='--set labels.channel=legend --set labels.legend=town'):
        looked(path, labels__channel='r')
    assert looked(path, labels__legend='town').labels.max() == 4


@pytest.mark.parametrize('factor, refused', [(1000, False), (100000, True)])
def test_ids_of_instances_are_recognised(tmp_path, caplog, factor, refused):
    def labels(i):
        return (bags.labels(i).astype(np.int32) % 2 + 1) * factor + np.arange(16, dtype=np.int32)

    path = written(tmp_path / 'bag', labels, encodings=('32SC1', '32FC1'))
    if refused:
        with pytest.raises(PersemError, match='--set labels.divisor=1000'):
            looked(path)
    else:
        looked(path)
        assert '--set labels.divisor=1000' in caplog.text
    caplog.clear()
    looked(path, labels__divisor=factor)
    assert not caplog.text


def test_ids_that_are_classes_only_when_divided_are_refused(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: bags.labels(i) * 1000 + np.arange(16, dtype='u2'))
    with pytest.raises(PersemError, match='none of them is in the legend: --set labels.divisor'):
        looked(path, labels__legend='town')
    looked(path, labels__legend='town', labels__divisor=1000)
    assert not caplog.text


def test_ids_in_one_channel_beside_numbers_of_instances_are_told_from_colours(tmp_path):
    def labels(i):
        ids = bags.labels(i).astype('u1')
        return np.stack([ids, 40 + 3 * ids, np.arange(16, dtype='u1') + 0 * ids], -1)

    path = written(tmp_path / 'bag', labels, encodings=('rgb8', '32FC1'))
    with pytest.raises(PersemError, match='channel r holds ids .*--set labels.channel=r') as said:
        looked(path, labels__legend='town')
    assert 'labels.channel=legend' not in str(said.value)
    assert looked(path, labels__legend='town', labels__channel='r').labels.max() == 4


def test_an_axis_that_misses_the_image_is_said(tmp_path, caplog):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            bags.write_images(out, i)
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('other/camera_info', bags.stamp(i), 'camera', 16, 12,
                            np.diag([4.0, 4.0, 1.0]) @ bags.K)
    looked(tmp_path / 'bag', topics__camera_info='/other/camera_info')
    assert '/other/camera_info: the optical axis' in caplog.text and '=TOPIC' in caplog.text
    caplog.clear()
    looked(tmp_path / 'bag')
    assert 'optical axis' not in caplog.text


def test_a_mask_of_0_and_255_is_recognised(tmp_path, caplog):
    path = written(tmp_path / 'bag', lambda i: np.where(bags.labels(i) > 2, 255, 0).astype('u1'),
                   encodings=('mono8', '32FC1'))
    looked(path)
    assert "--set 'memory.ignore_labels=[65535]' counts it" in caplog.text
    caplog.clear()
    looked(path, memory__ignore_labels=[65535])
    assert not caplog.text


def test_a_grey_image_is_no_label_image(tmp_path, caplog):
    looked(written(tmp_path / 'bag', lambda i: np.arange(192, dtype='u1').reshape(12, 16),
                   encodings=('mono8', '32FC1')))
    assert 'is it a grey image?' in caplog.text


def test_labels_always_beside_their_depth_are_said(tmp_path, caplog):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(10):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', 16, 12, bags.K)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i) + 12_000_000, 'camera', bags.labels(i),
                      'mono16')
        out.pose('pose', bags.stamp(10), 'map', bags.pose(10))
    looked(tmp_path / 'bag')
    assert 'all label images are 12 ms behind' in caplog.text
    assert '--set sync.offset_labels=-0.012' in caplog.text
    caplog.clear()
    looked(tmp_path / 'bag', sync__offset_labels=-0.012)
    assert not caplog.text


def stereo(out, i, D=()):
    """Write frame i with a disparity image, focal length x baseline = 2.4, in place of depth."""
    types, at = out.typestore.types, bags.stamp(i)
    image = out.make.image(at, 'camera', (2.4 / bags.depth(i)).astype(np.float32), '32FC1')
    roi = types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
    out.message('stereo/disparity', at, 'stereo_msgs/msg/DisparityImage',
                types['stereo_msgs/msg/DisparityImage'](image.header, image, 20.0, 0.12, roi, 0.0,
                                                        64.0, 0.125))
    out.message('disparity/image', at, 'sensor_msgs/msg/Image', image)
    out.pose('pose', at, 'map', bags.pose(i))
    out.camera_info('depth/camera_info', at, 'camera', 16, 12, bags.K, D,
                    P=np.hstack([bags.K, [[0], [0], [0]]]))
    out.camera_info('right/camera_info', at, 'right', 16, 12, bags.K,
                    P=np.hstack([bags.K, [[-2.4], [0], [0]]]))
    out.image('semantic/image', at, 'camera', bags.labels(i), 'mono16')


def test_a_disparity_image_is_depth(tmp_path, caplog):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            stereo(out, i, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(PersemError, match='--set topics.depth=/stereo/disparity'):
        looked(tmp_path / 'bag')
    frame = looked(tmp_path / 'bag', topics__depth='stereo/disparity')
    np.testing.assert_allclose(frame.depth, bags.depth(0), rtol=1e-6)
    np.testing.assert_allclose(frame.camera.rays[0, 0], [-0.375, -0.275])      # by P, without D
    assert 'disparities are of rectified images' in caplog.text


def test_disparities_without_a_baseline_are_refused_with_what_to_type(tmp_path):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(5):
            stereo(out, i)
    with pytest.raises(PersemError) as refused:
        looked(tmp_path / 'bag', topics__depth='disparity/image')
    flags = '--set depth.kind=disparity --set depth.scale=2.4'
    assert flags in str(refused.value) and '/right/camera_info' in str(refused.value)
    frame = looked(tmp_path / 'bag', topics__depth='disparity/image', depth__kind='disparity',
                   depth__scale=2.4)
    np.testing.assert_allclose(frame.depth, bags.depth(0), rtol=1e-6)
    with pytest.raises(PersemError, match='disparity needs depth.scale'):
        looked(tmp_path / 'bag', depth__kind='disparity')


@pytest.mark.parametrize('value, said', [
    (np.nan, 'no pixel has a depth'), (-2.0, 'no pixel has a depth'),
    (1000.0, 'depth.scale=0.001, if they are centimetres: --set depth.scale=0.01')])
def test_depth_of_which_nothing_is_in_range_is_refused(tmp_path, value, said):
    def depth(i):
        return np.full((12, 16), value, np.float32)

    with pytest.raises(PersemError, match=said):
        looked(written(tmp_path / 'bag', depth=depth))


def test_depth_that_comes_late_is_no_reason_to_refuse(tmp_path):
    looked(written(tmp_path / 'bag', depth=lambda i: bags.depth(i) * (i > 3)))


def test_camera_infos_of_which_some_do_not_fit_are_said(tmp_path, caplog):
    with RecordingWriter(tmp_path / 'bag') as out:
        for i in range(9):
            out.pose('pose', bags.stamp(i), 'map', bags.pose(i))
            out.camera_info('depth/camera_info', bags.stamp(i), 'camera', *(
                (8, 12) if i < 3 else (16, 12)), bags.K)
            out.image('depth/image', bags.stamp(i), 'camera', bags.depth(i), '32FC1')
            out.image('semantic/image', bags.stamp(i), 'camera', bags.labels(i), 'mono16')
    looked(tmp_path / 'bag')
    assert 'some images on /depth/image cannot be used' in caplog.text
    caplog.clear()
    with closing(opened(tmp_path / 'bag', Config(), excerpt=Excerpt(str(bags.stamp(3)), '', 1))):
        assert 'some images' not in caplog.text     # they are not of the part
