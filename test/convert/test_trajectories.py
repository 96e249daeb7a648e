"""Files with all poses of a data set, as EuRoC, SceneNN, ARKitScenes and TUM write them."""

import logging

import cv2
import numpy as np
from persem_ros.convert.frames.convert import convert_frames
from persem_ros.convert.frames.layout import FramesOptions
from persem_ros.convert.trajectories import poses_from_trajectory
from persem_ros.core.transforms import inverse, matrix_to_quaternion
from persem_ros.errors import PersemError
import pytest
from test_convert_frames import matrix, place, read, rewrite, seven  # noqa: F401

BEGIN = 1403636579763555584     # ns
STEP = 5_000_000
EUROC = ('#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], '
         'q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], '
         'b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], '
         'b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]')
NAMES = {'header': EUROC + '\n', 'no header': '', 'names alone': EUROC[1:] + '\n'}


def quaternion(T, w_first):
    """Return the four numbers of a rotation as a file has them."""
    q = matrix_to_quaternion(T[:3, :3])
    return np.roll(q, 1) if w_first else q


def line(T, stamp, w_first, *more, by=' '):
    """Return a line of a trajectory."""
    return by.join([str(stamp), *(f'{x:.9f}' for x in (*T[:3, 3], *quaternion(T, w_first))),
                    *more])


@pytest.mark.parametrize('header', NAMES)
@pytest.mark.parametrize('more', [('0.1',) * 9, ()])
def test_euroc_has_nanoseconds_and_w_first(tmp_path, header, more):
    path = tmp_path / 'data.csv'
    path.write_text(NAMES[header] + '\n'.join(
        line(place(i), BEGIN + i * STEP, True, *more, by=',') for i in range(6)))
    poses = poses_from_trajectory(path, ['0'], True)
    assert poses.stamps == [BEGIN + i * STEP for i in range(6)]
    assert np.allclose(poses.matrices[4], place(4), atol=1e-6)
    assert poses.order == 'w x y z'


def test_scenenn_counts_blocks_from_0_and_images_from_1(tmp_path):
    path = tmp_path / 'trajectory.log'
    path.write_text(''.join(f'{i} {i} {i + 1}\n' + '\n'.join(
        ' '.join(f'{x:.9f}' for x in row) for row in place(i)) + '\n' for i in range(6)))
    images = poses_from_trajectory(path, [f'image{i:05d}' for i in range(1, 7)], False)
    assert np.allclose(images.by_key['image00001'], place(0))
    assert np.allclose(images.by_key['image00006'], place(5))
    frames = poses_from_trajectory(path, [f'{i:05d}' for i in range(6)], False)
    assert np.allclose(frames.by_key['00005'], place(5))


def test_arkitscenes_turns_by_axis_and_angle_from_world_to_camera(tmp_path):
    path = tmp_path / 'lowres_wide.traj'
    rows = []
    for i in range(4):
        T = inverse(place(i))
        rows.append(f'{6845.0 + i / 10:.4f} ' + ' '.join(
            f'{x:.9f}' for x in (*cv2.Rodrigues(T[:3, :3])[0].ravel(), *T[:3, 3])))
    path.write_text('\n'.join([*rows, '6845.4 nan nan nan 0 0 0']))
    poses = poses_from_trajectory(path, ['6845.2'], True)
    assert poses.stamps == [6_845_000_000_000 + i * 10**8 for i in range(4)]
    assert np.allclose(poses.matrices[3], place(3), atol=1e-6)
    assert poses.lost == ['6845.4']


def trajectory(folder, header=''):
    """Put one file with w first in place of the poses of a 7-Scenes folder."""
    for path in folder.glob('*.pose.txt'):
        path.unlink()
    path = folder / 'poses.txt'
    path.write_text(header + '\n'.join(line(place(i), 5 * i, True) for i in range(12)))
    return path


def test_tum_with_w_first_says_so_in_its_comment(seven, tmp_path):       # noqa: F811
    path = trajectory(seven, '# number tx ty tz qw qx qy qz\n')
    poses = poses_from_trajectory(path, [f'{5 * i:06d}' for i in range(12)], False)
    assert np.allclose(poses.by_key['000055'], place(11), atol=1e-6)
    assert poses.other is None


def test_tum_with_w_first_is_told_by_depth(seven, tmp_path, caplog):     # noqa: F811
    trajectory(seven)
    convert_frames(seven, tmp_path / 'out')
    found = read(tmp_path / 'out')['/pose']
    assert np.allclose(matrix(found[7][1].pose), place(7), atol=1e-6)
    assert 'in the order w x y z' in caplog.text
    caplog.clear()
    convert_frames(seven, tmp_path / 'blind', FramesOptions(check=False))
    found = read(tmp_path / 'blind')['/pose']
    assert not np.allclose(matrix(found[7][1].pose), place(7), atol=1e-2)


def test_tum_as_it_should_be_stays(seven, tmp_path, caplog):             # noqa: F811
    trajectory(seven).write_text('\n'.join(line(place(i), 5 * i, False) for i in range(12)))
    convert_frames(seven, tmp_path / 'out')
    found = read(tmp_path / 'out')['/pose']
    assert np.allclose(matrix(found[7][1].pose), place(7), atol=1e-6)
    assert 'in the order' not in caplog.text


@pytest.mark.parametrize('name, text, said', [
    ('data.csv', EUROC + '\n', 'no lines|no poses|empty'),
    ('trajectory.log', '0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n', 'different length'),
    ('lowres_wide.traj', '1.0 0 0 zero 0 0 0\n', 'line 1')])
def test_damaged_trajectories_are_refused(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(PersemError, match=said):
        poses_from_trajectory(tmp_path / name, ['1'], True)


@pytest.mark.parametrize('ending, said', [('.color.png', True), ('.color.jpg', False)])
def test_seven_scenes_has_unregistered_colour(seven, tmp_path, caplog, ending, said):  # noqa: F811
    caplog.set_level(logging.INFO)
    for path in seven.glob('*.color.jpg') if said else ():
        cv2.imwrite(str(path).replace('.color.jpg', ending), cv2.imread(str(path)))
        path.unlink()
    convert_frames(seven, tmp_path / 'out')
    assert ('not registered' in caplog.text) == said


def test_wrong_poses_are_not_told_by_their_quaternions(seven, tmp_path, caplog):       # noqa: F811
    rewrite(seven, inverse)
    convert_frames(seven, tmp_path / 'out')
    assert 'in the order' not in caplog.text
