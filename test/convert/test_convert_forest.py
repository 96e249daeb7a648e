"""persem convert forest: both parts, every unknown an option, refusals."""

import json

import cv2
import numpy as np
from persem_ros import cli
from persem_ros.convert.forest.colors import ids_of_colors
from persem_ros.convert.forest.poses import AIRSIM, metadata_poses
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.recording import Recording
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend_files import load_legend
import pytest

WIDTH, HEIGHT, HIGH = 32, 24, 30.0
LEGEND = load_legend('forest')


def ground(i):
    """Return the true ids of image *i*, looking down: bands of classes 1, 4, 6 along north."""
    image = np.ones((HEIGHT, WIDTH), np.uint8)
    image[:8] = 4
    image[:, i + 3:i + 6] = 6
    return image


def write_synthetic(root, depth=None, frames=4, doubled=False, turn=0.0, sink=0.0):
    """Write seq3: 30 m above ground, *turn* degrees, north a metre and down *sink* an image."""
    folder = root / 'seq3' / 'seq3' if doubled else root / 'seq3'
    for name in ('color', 'labels', 'depth'):
        (folder / name).mkdir(parents=True)
    lines = ['\t'.join(('VehicleName', 'TimeStamp', *AIRSIM))]
    for i in range(frames):
        colors = LEGEND.colors(ground(i))
        cv2.imwrite(str(folder / 'labels' / f'img_{i}.png'), colors[..., ::-1])
        cv2.imwrite(str(folder / 'color' / f'img_{i}.png'), colors[..., ::-1])
        array = np.full((HEIGHT, WIDTH), HIGH, np.float32)
        if depth is None:
            np.save(folder / 'depth' / f'img_{i}.npy', array)
        else:
            cv2.imwrite(str(folder / 'depth' / f'img_{i}.png'), depth(array))
        half = np.radians(turn * i) / 2
        numbers = i, float(i), 5.0, sink * i - HIGH, np.cos(half), 0.0, 0.0, np.sin(half)
        lines.append('\t'.join(['drone', *map(str, numbers), f'img_{i}.png']))
    (folder / 'airsim_rec.txt').write_text('\n'.join(lines) + '\n')
    return folder


def frames_of(path):
    with Recording(path, updated(Config(), {'pose.max_gap': 10.0})) as recording:
        return list(recording.frames(truth=True, color=True))


def world_points(frame):
    """Return the map points of a frame's pixels, (h, w, 3)."""
    points = np.concatenate([frame.camera.rays, np.ones(frame.depth.shape + (1,))], 2)
    points *= frame.depth[..., None]
    return points @ frame.T_map_camera[:3, :3].T + frame.T_map_camera[:3, 3]


def convert(root, *words):
    assert cli.main(['convert', 'forest', str(root), 'seq3', str(root / 'out'), '--no-check',
                     *words]) == 0
    return frames_of(root / 'out')


@pytest.mark.parametrize('doubled', [False, True])
def test_airsim_looking_down(tmp_path, doubled):
    write_synthetic(tmp_path, doubled=doubled)
    frames = convert(tmp_path, '--pitch', '-90')
    assert len(frames) == 4
    for i, frame in enumerate(frames):
        assert (frame.labels == ground(i)).all() and (frame.truth == frame.labels).all()
        assert frame.color.shape == (HEIGHT, WIDTH, 3)
        # North 1 m an image and east 5 m in AirSim; east, north, up here. The top of the
        # image looks north, its right side east, and the ground is at 0.
        np.testing.assert_allclose(frame.T_map_camera[:3, 3], [5, i, HIGH], atol=1e-9)
        points = world_points(frame)
        np.testing.assert_allclose(points[..., 2], 0, atol=1e-6)
        assert points[0, 0, 1] > points[-1, 0, 1] and points[0, -1, 0] > points[0, 0, 0]
    fov = 2 * np.degrees(np.arctan(WIDTH / 2 / frames[0].camera.K[0, 0]))
    assert fov == pytest.approx(90)


@pytest.mark.parametrize('words, depth', [
    (('--depth-unit', 'cm'), lambda a: (100 * a).astype(np.uint16)),
    ((), lambda a: (1000 * a).astype(np.uint16)),
    (('--depth-coding', 'rgb24'), lambda a: np.stack(
        [np.rint(a / 1000 * (2**24 - 1)).astype(np.int64) >> k & 255
         for k in (16, 8, 0)], 2).astype(np.uint8))], ids=['cm', 'mm', 'rgb24'])
def test_codings_of_depth(tmp_path, words, depth):
    write_synthetic(tmp_path, depth)
    for frame in convert(tmp_path, *words):
        np.testing.assert_allclose(frame.depth, HIGH, atol=1e-4)


def test_distance_along_the_ray(tmp_path):
    folder = write_synthetic(tmp_path)
    K = [16.0, 16.0, 15.5, 11.5]
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    ray = np.sqrt(1 + ((u - K[2]) / K[0]) ** 2 + ((v - K[3]) / K[1]) ** 2)
    for path in (folder / 'depth').iterdir():
        np.save(path, (HIGH * ray).astype(np.float32))
    frames = convert(tmp_path, '--depth-is', 'ray', '--intrinsics', '16,16,15.5,11.5')
    np.testing.assert_allclose(frames[0].depth, HIGH, rtol=1e-6)
    np.testing.assert_allclose(frames[0].camera.K[0], [16, 0, 15.5])


def test_scale_frames_and_predictions(tmp_path):
    write_synthetic(tmp_path)
    (tmp_path / 'p').mkdir()
    for i in range(4):
        cv2.imwrite(str(tmp_path / 'p' / f'{i}.png'), np.full((HEIGHT, WIDTH), 5, np.uint8))
    (tmp_path / 'seq3' / 'kitti.txt').write_text(
        ''.join(f'1 0 0 {i} 0 1 0 0 0 0 1 0\n' for i in range(4)))
    frames = convert(tmp_path, '--scale', '0.5', '--frames', '1:4', '--every', '2',
                     '--predictions', str(tmp_path / 'p'), '--depth', 'depth/img_*.npy',
                     '--labels', 'labels/img_*.png', '--color', 'color/img_*.png',
                     '--pose', 'kitti.txt')
    assert len(frames) == 2 and (frames[0].labels == 5).all()
    assert frames[0].truth.shape == (HEIGHT // 2, WIDTH // 2) and (frames[0].truth == 6).any()
    assert frames[0].camera.width == WIDTH // 2


def test_wilduav_metadata(tmp_path):
    folder = tmp_path / 'seq3'
    for name in ('img', 'labels', 'depth', 'metadata'):
        (folder / name).mkdir(parents=True)
    R = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])       # down: right is south, down west
    K = np.array([[50.0, 0, 16], [0, 51, 12], [0, 0, 1]])
    for i in range(3):
        colors = LEGEND.colors(ground(i))[..., ::-1]
        cv2.imwrite(str(folder / 'img' / f'{i:06d}.png'), colors)
        cv2.imwrite(str(folder / 'labels' / f'{i:06d}.png'), colors)
        np.save(folder / 'depth' / f'{i:06d}.npy', np.full((HEIGHT, WIDTH), HIGH))
        (folder / 'metadata' / f'{i:06d}.json').write_text(json.dumps({
            'size': [WIDTH, HEIGHT], 'camera': {'matrix': K.T.ravel().tolist()},
            'pose': {'R': R.T.tolist(), 'C': [i, 2.0, HIGH + 300]}}))
    frames = convert(tmp_path)
    np.testing.assert_allclose(frames[1].T_map_camera[:3], np.column_stack(
        [R, [1, 2, HIGH + 300]]), atol=1e-9)
    np.testing.assert_allclose(frames[0].camera.K, K)
    (folder / 'metadata' / '000000.json').write_text('{"R": [1, 2]}')
    with pytest.raises(PersemError, match='found no rotation of 9 numbers and no translation'):
        metadata_poses({'0': folder / 'metadata' / '000000.json'})


def test_axes_are_checked(tmp_path, caplog):
    folder = write_synthetic(tmp_path, frames=10, turn=8.0)
    y = (np.arange(HEIGHT) - 11.5) / 16                 # flat ground, 60 degrees down
    depth = HIGH / (y * np.cos(np.radians(60)) + np.sin(np.radians(60)))
    for path in (folder / 'depth').iterdir():
        np.save(path, np.tile(depth[:, None], (1, WIDTH)).astype(np.float32))
    words = ['convert', 'forest', str(tmp_path), 'seq3', '--pitch', '-60']
    assert cli.main([*words, str(tmp_path / 'right')]) == 0
    assert 'wrong' not in caplog.text
    points = world_points(frames_of(tmp_path / 'right')[0])
    np.testing.assert_allclose(points[..., 2], 0, atol=1e-4)
    assert cli.main([*words, str(tmp_path / 'wrong'), '--axes', 'opencv']) == 0
    assert 'look wrong' in caplog.text and '--axes ned' in caplog.text


@pytest.mark.parametrize('unit, said', [('m', ''), ('cm', '--depth-unit m'),
                                        ('0.1', '--depth-unit m')])
def test_a_wrong_depth_unit_is_noticed(tmp_path, caplog, unit, said):
    """Going down tells it: the ground comes nearer by what the poses say."""
    folder = write_synthetic(tmp_path, frames=10, sink=1.0)
    for i in range(10):
        np.save(folder / 'depth' / f'img_{i}.npy', np.full((HEIGHT, WIDTH), HIGH - i))
    assert cli.main(['convert', 'forest', str(tmp_path), 'seq3', str(tmp_path / 'out'), '--pitch',
                     '-90', '--depth-unit', unit]) == 0
    warnings = [r.getMessage() for r in caplog.records if 'looks wrong' in r.getMessage()]
    assert len(warnings) == bool(said)
    assert not said or warnings[0].endswith(said)


def test_refusals(tmp_path, capsys):
    def refused(*words, name='seq3'):
        assert cli.main(['convert', 'forest', str(tmp_path), name, str(tmp_path / 'out'),
                         '--no-check', *words]) == 1
        return capsys.readouterr().err

    folder = write_synthetic(tmp_path)
    assert 'there are seq3' in refused(name='seq9')
    assert 'no depth files like disp/*.png' in refused('--depth', 'disp/*.png')
    assert 'no poses like t.txt' in refused('--pose', 't.txt')
    assert 'no label files like l/*.png' in refused('--labels', 'l/*.png')
    assert 'expected four numbers fx,fy,cx,cy, got two' in refused('--intrinsics', '50,50')
    assert '--fov 200: expected' in refused('--fov', '200')
    assert '--scale 2: expected' in refused('--scale', '2')
    assert 'rgb24 needs an 8-bit colour image' in refused('--depth-coding', 'rgb24')
    assert 'colours that the legend does not have' in refused('--legend', 'uavscenes')
    assert 'colours instead of ids, and no legend' in refused('--legend', '')
    (folder / 'airsim_rec.txt').write_text('POS_X ImageFile\n1 a.png\n')
    assert 'expected the columns POS_X' in refused()


def test_few_strange_colors_are_unlabelled():
    rgb = LEGEND.colors(ground(0))
    rgb[0, 0] = 1, 2, 3
    ids = ids_of_colors(rgb, LEGEND, 'here')
    assert ids[0, 0] == 255 and (ids.ravel()[1:] == ground(0).ravel()[1:]).all()
