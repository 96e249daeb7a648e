"""persem convert uavscenes: folders in all forms, LiDAR depth, scales, refusals."""

import json
import logging
from pathlib import Path
import re
import shutil

import cv2
import numpy as np
from persem_ros import cli
from persem_ros.convert.uavscenes import calibration
from persem_ros.convert.uavscenes.convert import convert_uavscenes, NAMED, UavscenesOptions
from persem_ros.convert.uavscenes.layout import find_run
from persem_ros.convert.uavscenes.lidar import depth_of_points, read_scan
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.settings.legend_files import load_legend
import pytest
from rosbags.highlevel import AnyReader

WIDTH, HEIGHT = 40, 32
K = np.array([[25.0, 0, 19.5], [0, 26.0, 15.5], [0, 0, 1]])
RUN = 'AMtown01'
FOLDING = (-0.3, 0.02, 0.001, 0.002, 0.0)
BEGIN = 1_658_137_057_641_204_937
RIG = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, -0.3], [0, 0, 0, 1]])
CALIBRATION = """'''Camera and LiDAR'''
import os
raise SystemExit('this file is read, not run')

AMtown_calibration = {
    'camera_intrinsic': [1530.0, 0.0, 1223.5, 0.0, 1664.0, 1023.5, 0.0, 0.0, 1.0],
    'camera_dist_coeffs': [-0.1, 0.01, 0.001, -0.002, 0.0],  # k1, k2, p1, p2, k3
    'camera_ext_R': [0, -1, 0, 0, 0, -1, 1, 0, 0],
    'camera_ext_t': np.array([0.1, 0.2, -0.3]),
}
Other_calibration = {
    'camera_intrinsic': [1, 0, 0, 0, 1, 0, 0, 0, 1], 'camera_dist_coeffs': [0, 0, 0, 0, 0],
    'camera_ext_R': [0, -1, 0, -0.05, 0, -1, 1, 0, 0], 'camera_ext_t': [0, 0, 0]}
scenename_to_calibration = {'AMtown01': AMtown_calibration, 'HKairport01': Other_calibration}
"""


def stamp_of(i):
    """Return the stamp of image i of the full rate, 10 Hz."""
    return BEGIN + i * 100_000_000


def text_of(ns):
    """Return a stamp as the data set writes it."""
    return f'{ns // 10**9}.{ns % 10**9:09d}'


def place(i):
    """Return T_map_camera: 20 m above flat ground, looking down, flying along x."""
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]
    T[:3, 3] = [0.4 * i, 0.1 * i, 20.0 - 0.02 * i]
    return T


def ids(i):
    """Return true ids: stripes, an unnamed id 7 in one corner."""
    image = np.full((HEIGHT, WIDTH), 13, np.uint8)
    image[:, (i // 5) % WIDTH:] = 1
    image[:3, :4] = 7
    return image


def ground(i):
    """Return the depth of frame i in metres: what the flat ground is away."""
    return np.full((HEIGHT, WIDTH), place(i)[2, 3])


def make(root, interval=5, count=21):
    """Write a run as the archives unpack it; return the stamps as text of its images."""
    cam = root / f'interval{interval}_CAM_LIDAR' / f'interval{interval}_{RUN}'
    label = root / f'interval{interval}_CAM_label' / f'interval{interval}_{RUN}'
    for folder in (cam / f'interval{interval}_CAM', cam / f'interval{interval}_LIDAR',
                   label / f'interval{interval}_CAM_label_id',
                   label / f'interval{interval}_CAM_label_color'):
        folder.mkdir(parents=True)
    infos = [{'OriginalImageName': f'{text_of(stamp_of(i))}.jpg', 'SortedImageID': i,
              'Height': HEIGHT, 'Width': WIDTH, 'P3x3': K.tolist(), 'K1': 0.0, 'K2': 0.0,
              'K3': 0.0, 'P1': 0.0, 'P2': 0.0, 'T4x4': place(i).tolist()} for i in range(count)]
    (cam / 'sampleinfos_interpolated.json').write_text(json.dumps(infos))
    keys = []
    for i in range(0, count, interval):
        key = text_of(stamp_of(i))
        keys.append(key)
        image = np.full((HEIGHT, WIDTH, 3), 10 * i, np.uint8)
        cv2.imwrite(str(cam / f'interval{interval}_CAM/{key}.jpg'), image)
        cv2.imwrite(str(label / f'interval{interval}_CAM_label_id/{key}.png'), ids(i))
        cv2.imwrite(str(label / f'interval{interval}_CAM_label_color/{key}.png'), image)
        scan = f'image{key}_lidar{text_of(stamp_of(i) - 18_000_000)}.txt'
        np.savetxt(cam / f'interval{interval}_LIDAR' / scan, points(i), fmt='%.6f')
    return keys


def points(i):
    """Return a scan of frame i (LiDAR frame): the ground below every fourth pixel."""
    v, u = np.mgrid[:HEIGHT:4, :WIDTH:4].reshape(2, -1)
    d = ground(i)[v, u]
    optical = np.stack([(u - K[0, 2]) / K[0, 0] * d, (v - K[1, 2]) / K[1, 1] * d, d], 1)
    return (optical - RIG[:3, 3]) @ RIG[:3, :3]


@pytest.fixture
def root(tmp_path):
    """Return a data set with one run at interval 5, five frames, and its calibration."""
    root = tmp_path / 'root'
    make(root)
    (root / 'calibration_results.py').write_text(CALIBRATION)
    return root


@pytest.fixture
def extras(root, tmp_path):
    """Return a folder with depth in centimetres and predictions, beside the data set."""
    folder = tmp_path / 'extras'
    for name in ('depth', 'predictions'):
        (folder / name).mkdir(parents=True)
    for i in range(0, 21, 5):
        key = text_of(stamp_of(i))
        centimetres = np.rint(ground(i) * 100).astype(np.uint16)
        centimetres[0, 0] = 0
        cv2.imwrite(str(folder / f'depth/{key}.png'), centimetres)
        prediction = ids(i)
        prediction[-3:, -3:] = 22
        prediction[10:12] = 20
        cv2.imwrite(str(folder / f'predictions/{key}.png'), prediction)
    return folder


def read(path):
    """Return {topic: [(stamp, message)]} of a recording."""
    result = {}
    with AnyReader([Path(path)]) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            result.setdefault(connection.topic, []).append((stamp, message))
    return result


def pixels(message):
    """Return the array of a sensor_msgs/Image."""
    dtype = {'mono8': 'u1', '32FC1': 'f4', '16UC1': 'u2', 'bgr8': 'u1'}[message.encoding]
    return message.data.view(dtype).reshape(message.height, message.width, -1).squeeze()


def refusal(root, tmp_path, text, name=RUN, **options):
    """Check that a conversion is refused with *text*, in one line, and leaves nothing."""
    with pytest.raises(PersemError, match=text) as error:
        convert_uavscenes(root, name, tmp_path / 'out', UavscenesOptions(**options))
    assert '\n' not in str(error.value)
    assert not list(tmp_path.glob('*out*'))


def test_predictions_and_depth_from_folders(root, extras, tmp_path):
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(
        predictions=str(extras / 'predictions'), depth=str(extras / 'depth'), depth_unit='cm'),
        legend=load_legend('uavscenes'))
    topics = read(tmp_path / 'out')
    assert set(topics) == {
        '/semantic/image', '/semantic/truth', '/semantic/legend', '/depth/image',
        '/depth/camera_info', '/color/image', '/pose', '/tf'}
    stamps = [stamp_of(i) for i in range(0, 21, 5)]
    for topic in ('/semantic/image', '/semantic/truth', '/depth/image', '/color/image'):
        assert [stamp for stamp, _ in topics[topic]] == stamps
    # The poses of all images of the full rate, so that interpolation has near neighbours.
    assert [stamp for stamp, _ in topics['/pose']] == [stamp_of(i) for i in range(21)]
    for n, i in enumerate(range(0, 21, 5)):
        truth = ids(i)
        truth[truth == 7] = 255
        np.testing.assert_array_equal(pixels(topics['/semantic/truth'][n][1]), truth)
        truth[-3:, -3:] = 255
        truth[10:12] = 20
        np.testing.assert_array_equal(pixels(topics['/semantic/image'][n][1]), truth)
        depth = pixels(topics['/depth/image'][n][1])
        assert depth[0, 0] == 0
        assert np.allclose(depth.ravel()[1:], ground(i).ravel()[1:], atol=0.0051)
        pose = topics['/pose'][i][1].pose
        p, q = pose.position, pose.orientation
        assert np.allclose(transform([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]), place(i), atol=1e-12)
    info = topics['/depth/camera_info'][2][1]
    assert (info.width, info.height) == (WIDTH, HEIGHT)
    assert info.k.tolist() == K.ravel().tolist() and not np.any(info.d)
    assert 'transparent_roof' in topics['/semantic/legend'][0][1].data


def test_without_predictions_the_truth_is_the_input_and_it_says_so(root, tmp_path, caplog):
    convert_uavscenes(root, RUN, tmp_path / 'out')
    assert 'the true labels are the label input' in caplog.text
    topics = read(tmp_path / 'out')
    for (_, label), (_, truth) in zip(topics['/semantic/image'], topics['/semantic/truth'],
                                      strict=True):
        np.testing.assert_array_equal(label.data, truth.data)


@pytest.mark.parametrize('form', ['doubled', 'directly', 'named'])
def test_wrapper_forms(root, tmp_path, form):
    name = RUN
    if form == 'doubled':
        for wrapper in list(root.glob('interval5_*')):
            shutil.move(wrapper, tmp_path / 'moved')
            wrapper.mkdir()
            shutil.move(tmp_path / 'moved', wrapper / wrapper.name)
    elif form == 'directly':
        for wrapper in list(root.glob('interval5_*')):
            shutil.copytree(wrapper / f'interval5_{RUN}', root / f'interval5_{RUN}',
                            dirs_exist_ok=True)
            shutil.rmtree(wrapper)
    else:
        name = f'interval5_{RUN}'
    convert_uavscenes(root, name, tmp_path / 'out')
    topics = read(tmp_path / 'out')
    assert len(topics['/semantic/truth']) == len(topics['/color/image']) == 5
    assert np.unique(pixels(topics['/semantic/truth'][1][1])).tolist() == [1, 13, 255]


def test_intervals(root, tmp_path):
    make(root, interval=1)
    assert (find_run(root, RUN).interval, len(find_run(root, RUN).truth)) == (5, 5)
    assert len(find_run(root, RUN, 1).truth) == 21
    assert find_run(root, f'interval1_{RUN}').interval == 1
    shutil.rmtree(root / 'interval5_CAM_LIDAR')
    assert find_run(root, RUN).interval == 1
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(frames='2:6'))
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/depth/image']] == [stamp_of(i) for i in range(2, 6)]
    assert [s for s, _ in topics['/pose']] == [stamp_of(i) for i in range(2, 6)]


def test_depth_from_one_scan(root, tmp_path, caplog):
    convert_uavscenes(root, RUN, tmp_path / 'out')
    topics = read(tmp_path / 'out')
    for n, i in enumerate(range(0, 21, 5)):
        depth = pixels(topics['/depth/image'][n][1])
        expected = np.zeros((HEIGHT, WIDTH))
        expected[::4, ::4] = ground(i)[::4, ::4]
        assert np.allclose(depth, expected, atol=1e-4)
    assert 'calibration' not in caplog.text


def test_depth_from_neighbouring_scans(root, tmp_path):
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(lidar=2, frames='2:3'))
    depth = pixels(read(tmp_path / 'out')['/depth/image'][0][1])
    expected = np.zeros((HEIGHT, WIDTH), np.float32)
    for i in range(0, 21, 5):
        T = np.linalg.inv(place(10)) @ place(i) @ RIG
        for x, y, z in points(i) @ T[:3, :3].T + T[:3, 3]:
            u, v = round(K[0, 0] * x / z + K[0, 2]), round(K[1, 1] * y / z + K[1, 2])
            if 0 <= u < WIDTH and 0 <= v < HEIGHT and (not expected[v, u] or z < expected[v, u]):
                expected[v, u] = z
    assert np.count_nonzero(expected) > 2 * 80
    assert np.count_nonzero(np.abs(depth - expected) > 1e-3) == 0


def test_the_nearest_point_of_a_pixel_counts():
    cloud = np.array([[0, 0, 5.0], [0, 0, 3.0], [0.01, 0, 4.0], [0, 0, -2.0], [0, 0, 0.0],
                      [1e6, 0, 1.0]])
    depth = depth_of_points(cloud, K, (), (WIDTH, HEIGHT))
    assert depth[16, 20] == 3 and np.count_nonzero(depth) == 1
    assert np.count_nonzero(depth_of_points(np.empty((0, 3)), K, (0.1, 0, 0, 0, 0), (4, 4))) == 0


def test_points_are_distorted_like_the_image():
    # With this distortion r (1 - 0.3 r^2 + 0.02 r^4) the last point comes back into the image.
    cloud = np.array([[1.5, 1.0, 4.0], [-1.8, 0.0, 1.0]])
    expected, folded = cv2.projectPoints(cloud.reshape(2, 1, 3), np.zeros(3), np.zeros(3), K,
                                         np.array(FOLDING))[0].reshape(2, 2)
    assert 0 < folded[0] < WIDTH and 0 < folded[1] < HEIGHT
    assert np.count_nonzero(depth_of_points(cloud, K, FOLDING, (WIDTH, HEIGHT))) == 1
    v, u = np.argwhere(depth_of_points(cloud, K, FOLDING, (WIDTH, HEIGHT)))[0]
    assert [u, v] == np.rint(expected).astype(int).tolist()
    assert [u, v] != np.rint((K @ cloud[0] / 4)[:2]).astype(int).tolist()


def test_scale(root, extras, tmp_path):
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(
        predictions=str(extras / 'predictions'), scale=0.25, depth=str(extras / 'depth'),
        depth_unit='cm'))
    topics = read(tmp_path / 'out')
    for topic in ('/semantic/image', '/semantic/truth', '/depth/image', '/color/image'):
        assert (topics[topic][0][1].width, topics[topic][0][1].height) == (10, 8)
    np.testing.assert_array_equal(pixels(topics['/semantic/truth'][4][1])[1:, 1:],
                                  ids(20)[2::4, 2::4][1:, 1:])
    info = topics['/depth/camera_info'][0][1]
    assert (info.width, info.height) == (10, 8)
    assert np.allclose(info.k, [6.25, 0, 4.5, 0, 6.5, 3.5, 0, 0, 1])


def test_scaled_lidar_depth_and_small_depth_images(root, extras, tmp_path):
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(scale=0.5))
    depth = pixels(read(tmp_path / 'out')['/depth/image'][0][1])
    assert depth.shape == (16, 20) and np.isclose(depth.max(), 20.0, atol=1e-4)
    for path in (extras / 'depth').iterdir():       # at a quarter: kept as they are
        cv2.imwrite(str(path), np.full((8, 10), 2000, np.uint16))
    convert_uavscenes(root, RUN, tmp_path / 'two', UavscenesOptions(depth=str(extras / 'depth'),
                                                                    depth_unit='cm'))
    topics = read(tmp_path / 'two')
    info = topics['/depth/camera_info'][0][1]
    assert pixels(topics['/depth/image'][0][1]).shape == (8, 10)
    assert topics['/semantic/image'][0][1].width == WIDTH
    assert (info.width, info.k[0], info.k[2]) == (10, 6.25, 4.5)


def test_intrinsics_of_the_calibration(root, tmp_path):
    convert_uavscenes(root, RUN, tmp_path / 'out', UavscenesOptions(camera='calibration'))
    info = read(tmp_path / 'out')['/depth/camera_info'][0][1]
    assert np.allclose(info.k, [25, 0, 1224 * WIDTH / 2448 - 0.5, 0, 26, 15.5, 0, 0, 1])
    assert info.d.tolist() == [-0.1, 0.01, 0.001, -0.002, 0.0]
    (root / 'calibration_results.py').unlink()
    refusal(root, tmp_path / 'none', 'no calibration_results.py', camera='calibration')


def test_calibration_files_are_read_not_run(root):
    rig = calibration.read_calibration(root / 'calibration_results.py', RUN)
    assert np.allclose(rig.T_camera_lidar, RIG)
    assert np.allclose(calibration.nominal().T_camera_lidar[:3, :3], RIG[:3, :3])


def test_a_misprinted_rotation_is_mended_and_said(root, caplog):
    rig = calibration.read_calibration(root / 'calibration_results.py', 'HKairport01')
    R = rig.T_camera_lidar[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12) and np.isclose(np.linalg.det(R), 1)
    assert 'Other_calibration: camera_ext_R is 0.050 off a rotation' in caplog.text


@pytest.mark.parametrize('old, new, text', [
    ("'camera_ext_R': [0, -1,", "'camera_ext_R': [0, 1,", 'the matrix mirrors'),
    ("'camera_ext_R': [0, -1,", "'camera_ext_R': [0, -2,", 'expected a rotation'),
    ("'camera_ext_t': np.array([0.1,", "'camera_ext_t': np.array([", 'expected 3 numbers in'),
    ("'camera_ext_t'", "'t'", "expected 3 numbers in 'camera_ext_t'"),
    ('[0.1, 0.2, -0.3]', '[0.1, 1e999, -0.3]', 'not finite'),
    ('AMtown', 'BMtown', "no calibration for the run 'AMtown01'; known: BMtown01, HKairport01"),
    ('scenename', 'def scenename', 'expected Python source')])
def test_broken_calibrations_are_refused(root, tmp_path, old, new, text):
    (root / 'calibration_results.py').write_text(CALIBRATION.replace(old, new))
    refusal(root, tmp_path, text)


def test_a_calibration_without_a_table_goes_by_name(root):
    (root / 'calibration_results.py').write_text(CALIBRATION.split('scenename')[0])
    rig = calibration.read_calibration(root / 'calibration_results.py', 'AMtown03')
    assert np.allclose(rig.T_camera_lidar, RIG)


def test_without_a_calibration_the_nominal_mount_is_taken_and_said(root, tmp_path, caplog):
    (root / 'calibration_results.py').unlink()
    convert_uavscenes(root, RUN, tmp_path / 'out')
    assert 'no calibration_results.py' in caplog.text
    assert np.count_nonzero(pixels(read(tmp_path / 'out')['/depth/image'][0][1])) > 60


def test_frames_that_lack_something_are_left_out_and_counted(root, tmp_path, caplog):
    cam = root / f'interval5_CAM_LIDAR/interval5_{RUN}'
    path = cam / 'sampleinfos_interpolated.json'
    infos = json.loads(path.read_text())
    infos[10]['T4x4'][0][0] = float('nan')
    path.write_text(json.dumps(infos[:20]))
    scan = next((cam / 'interval5_LIDAR').glob(f'image{text_of(stamp_of(5))}*'))
    scan.unlink()
    truth = root / f'interval5_CAM_label/interval5_{RUN}/interval5_CAM_label_id'
    (truth / 'Thumbs.db').write_text('x')
    convert_uavscenes(root, RUN, tmp_path / 'out')
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/depth/image']] == [stamp_of(0), stamp_of(15)]
    for text in (f'1 frames left out: without depth ({text_of(stamp_of(5))})',
                 f'1 frames left out: with a pose that is not finite ({text_of(stamp_of(10))})',
                 f'1 frames left out: without a pose ({text_of(stamp_of(20))})'):
        assert text in caplog.text


def test_predictions_without_truth_and_without_images(root, extras, tmp_path, caplog):
    shutil.rmtree(root / 'interval5_CAM_label')
    shutil.rmtree(root / f'interval5_CAM_LIDAR/interval5_{RUN}/interval5_CAM')
    convert_uavscenes(root, RUN, tmp_path / 'out',
                      UavscenesOptions(predictions=str(extras / 'predictions')))
    topics = read(tmp_path / 'out')
    assert '/semantic/truth' not in topics and '/color/image' not in topics
    assert len(topics['/semantic/image']) == 5
    assert not [r for r in caplog.records if r.levelno >= logging.WARNING]


def test_scans_as_arrays_and_empty_scans(tmp_path):
    np.save(tmp_path / 'scan.npy', np.array([[1, 2, 3, 99], [np.nan, 0, 0, 1]], np.float32))
    assert read_scan(tmp_path / 'scan.npy').tolist() == [[1, 2, 3]]
    (tmp_path / 'scan.txt').write_text('')
    assert read_scan(tmp_path / 'scan.txt').shape == (0, 3)
    (tmp_path / 'scan.txt').write_text('1 2 3\n')
    assert read_scan(tmp_path / 'scan.txt').tolist() == [[1, 2, 3]]
    for content in ('1 2\n3 4\n', '1 2 3\n4 5\n', 'x y z\n'):
        (tmp_path / 'scan.txt').write_text(content)
        with pytest.raises(PersemError, match='scan.txt: expected lines of "x y z"'):
            read_scan(tmp_path / 'scan.txt')


def test_the_named_ids_are_those_of_the_legend():
    legend = load_legend('uavscenes')
    assert sorted(NAMED) == sorted(
        item.id for item in legend.classes if not item.name.startswith('un'))


def slope(i):
    """Return the depth of frame i in metres above ground that rises by 0.4 along x."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    T = place(i)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], 2) \
        @ T[:3, :3].T
    return (0.4 * T[0, 3] - T[2, 3]) / (rays[..., 2] - 0.4 * rays[..., 0])


@pytest.mark.parametrize('unit, median', [
    ('cm', 20), ('mm', 2), ('m', 2000), ('100000', 0.02)])
def test_a_wrong_unit_of_the_depth_is_noticed(root, extras, tmp_path, caplog, unit, median):
    caplog.set_level(logging.INFO)
    for i in range(0, 21, 5):
        path = extras / f'depth/{text_of(stamp_of(i))}.png'
        cv2.imwrite(str(path), np.rint(slope(i) * 100).astype(np.uint16))
    options = {'predictions': str(extras / 'predictions'), 'depth': str(extras / 'depth')}
    summary = convert_uavscenes(root, RUN, tmp_path / 'out',
                                UavscenesOptions(depth_unit=unit, **options))
    middle = float(re.search(r'; depth \S+ to \S+ m, median (\S+) m$', summary)[1])
    assert middle == pytest.approx(median, rel=0.3)
    warnings = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    if unit == 'cm':
        assert not warnings
        assert 'depth of one frame meets that of another within' in caplog.text
        return
    warning, = warnings
    assert warning.startswith('the depth unit looks wrong')
    assert warning.endswith('with --depth-unit cm')
    caplog.clear()
    convert_uavscenes(root, RUN, tmp_path / 'unchecked',
                      UavscenesOptions(depth_unit=unit, check=False, **options))
    assert 'depth' not in caplog.text


def test_refusals_of_folders(root, extras, tmp_path):
    refusal(tmp_path / 'nowhere', tmp_path, 'no such folder')
    refusal(root, tmp_path, "of the run 'AMtown09'; runs there: interval5_AMtown01",
            name='AMtown09')
    refusal(root, tmp_path, "of the run ''; runs there: interval5_AMtown01", name='')
    refusal(root, tmp_path, "'AMtown01' at interval 1; runs there: interval5_", interval=1)
    refusal(extras, tmp_path, 'no runs of UAVScenes there; ROOT should hold what the archives '
            'unpack to, interval5_CAM_LIDAR/interval5_AMtown01/sampleinfos_interpolated.json for')
    refusal(root, tmp_path, '--predictions .*nowhere: no such folder',
            predictions=str(root / 'nowhere'))
    refusal(root, tmp_path, '--predictions .*: no files named after stamps',
            predictions=str(root))
    refusal(root, tmp_path, '--depth .*nowhere: no such folder', depth=str(root / 'nowhere'))
    refusal(root, tmp_path, '--depth .*: no files named after stamps', depth=str(root))
    refusal(root, tmp_path, 'integers without a unit; say --depth-unit',
            depth=str(extras / 'depth'))
    refusal(root, tmp_path, 'expected m, cm, mm', depth=str(extras / 'depth'), depth_unit='dm')
    refusal(root, tmp_path, '--scale 0: expected', scale=0.0)
    refusal(root, tmp_path, '--scale nan: expected', scale=float('nan'))
    refusal(root, tmp_path, '--lidar -1: expected', lidar=-1)
    refusal(root, tmp_path, 'cannot be read', calibration=str(root / 'nowhere.py'))
    refusal(root, tmp_path, 'no frame is left of 5', frames='7:')


def test_refusals_of_missing_parts(root, extras, tmp_path):
    cam = root / f'interval5_CAM_LIDAR/interval5_{RUN}'
    for path in (cam / 'interval5_LIDAR').iterdir():
        path.rename(path.with_name(path.name.replace('image', 'img')))
    refusal(root, tmp_path, 'no scans named image<stamp>_lidar<stamp>.txt')
    shutil.rmtree(cam / 'interval5_LIDAR')
    refusal(root, tmp_path, 'no folder interval5_LIDAR of AMtown01; unpack')
    for path in (extras / 'depth').iterdir():
        path.rename(path.with_name(path.name.replace('1658', '1758')))
    refusal(root, tmp_path, r'no frame of AMtown01 is complete: 5 label images \(1658137057.6412',
            depth=str(extras / 'depth'), depth_unit='cm')
    shutil.rmtree(root / 'interval5_CAM_label')
    refusal(root, tmp_path, 'no labels: neither interval5_CAM_label_id')


@pytest.mark.parametrize('change, text', [
    (lambda text: text[:-5], 'not JSON'),
    (lambda text: '{}', 'expected a list with one object per image'),
    (lambda text: '[3]', 'entry 0: expected OriginalImageName'),
    (lambda text: text.replace('T4x4', 'T'), 'entry 0: expected OriginalImageName'),
    (lambda text: text.replace('1658137057', 'image', 1), 'entry 0: expected an image named'),
    (lambda text: text.replace('[[25.0, 0.0', '[[0.0, 0.0', 1), 'positive focal lengths'),
    (lambda text: text.replace('-1.0', '-1.2', 1), 'expected a rotation in the pose'),
    (lambda text: text.replace('"Width": 40', '"Width": 80'), 'expected one aspect ratio')])
def test_broken_samples_are_refused(root, tmp_path, change, text):
    path = root / f'interval5_CAM_LIDAR/interval5_{RUN}/sampleinfos_interpolated.json'
    path.write_text(change(path.read_text()))
    refusal(root, tmp_path, text)


def test_broken_images_are_refused(root, extras, tmp_path):
    label = next(root.glob('interval5_CAM_label/*/interval5_CAM_label_id/*'))
    before = label.read_bytes()
    cv2.imwrite(str(label), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    refusal(root, tmp_path, f'{label.name}: expected one channel of class ids')
    label.write_bytes(before[:50])
    refusal(root, tmp_path, f'{label.name}: not an image')
    label.write_bytes(before)
    depth = next((extras / 'depth').iterdir())
    cv2.imwrite(str(depth), np.ones((HEIGHT, HEIGHT), np.uint16))
    refusal(root, tmp_path, f'{depth.name}: 32x32, but the labels are 40x32',
            depth=str(extras / 'depth'), depth_unit='cm')


def test_command_line(root, extras, tmp_path, capsys):
    out = tmp_path / 'out'
    words = ['convert', 'uavscenes', str(root), RUN, str(out), '--predictions',
             str(extras / 'predictions'), '--scale', '0.5', '--lidar', '1', '--storage', 'sqlite3',
             '--compress', '--no-color', '--every', '2']
    assert cli.main(words) == 0
    assert capsys.readouterr().out.startswith(f'{out}: 21 poses, 3 labels')
    topics = read(out)
    assert len(topics['/semantic/image']) == 3 and '/color/image' not in topics
    assert cli.main(words) == 1
    assert capsys.readouterr().err.count('\n') == 1
    assert cli.main([*words, '--force']) == 0
    assert cli.main(['convert', 'uavscenes', str(root), RUN]) == 2
    words[4] = str(tmp_path / 'other')
    assert cli.main([*words, '--depth-invalid', 'a']) == 1


@pytest.mark.parametrize('below', [
    '', 'interval5_CAM_LIDAR', f'interval5_CAM_label/interval5_{RUN}',
    f'interval5_CAM_LIDAR/interval5_{RUN}'])
def test_frames_of_a_folder_of_uavscenes_name_the_converter(root, tmp_path, capsys, below):
    assert cli.main(['convert', 'frames', str(root / below), str(tmp_path / 'out')]) == 1
    assert capsys.readouterr().err == (
        f'persem: {root / below}: looks like UAVScenes: persem convert uavscenes ROOT RUN OUT\n')
    assert not (tmp_path / 'out').exists()


def test_command_line_of_frames(root, extras, tmp_path, capsys):
    """The same folders, read by their patterns alone."""
    poses = tmp_path / 'poses.txt'
    poses.write_text('\n'.join(
        f'{text_of(stamp_of(i))} {0.4 * i} {0.1 * i} {20 - 0.02 * i} 0.70710678 -0.70710678 0 0'
        for i in range(21)))
    words = ['convert', 'frames', str(extras), str(tmp_path / 'out'), '--labels', 'predictions',
             '--depth', 'depth/*.png', '--depth-unit', 'cm', '--pose', str(poses),
             '--intrinsics', '25,26,19.5,15.5', '--legend', 'uavscenes']
    assert cli.main(words) == 0
    assert '5 labels, 5 depth' in capsys.readouterr().out
    topics = read(tmp_path / 'out')
    assert [s for s, _ in topics['/depth/image']] == [stamp_of(i) for i in range(0, 21, 5)]
    q = topics['/pose'][0][1].pose.orientation
    assert np.allclose(transform([0, 0, 20], [q.x, q.y, q.z, q.w]), place(0), atol=1e-6)
    assert '/semantic/legend' in topics
