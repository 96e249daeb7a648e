"""Camera infos: scaling, binning, region of interest, distortion, and what is refused."""

import bags
import cv2
import numpy as np
from persem_ros.frames import pinhole, same_aspect
from persem_ros.inputs.decode.camera import camera, check, content
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.outputs.recording.messages import MessageFactory
import pytest
from rosbags.typesys import get_typestore, Stores

MAKE = MessageFactory(get_typestore(Stores.ROS2_JAZZY).types)
K = np.array([[520.0, 0, 318.2], [0, 515.0, 241.7], [0, 0, 1]])
PLUMB = (0.11, -0.23, 0.001, -0.002, 0.05)
RATIONAL = (0.4, -0.1, 0.0005, 0.0003, 0.02, 0.7, -0.05, 0.01)
FISHEYE = (-0.02, 0.01, -0.004, 0.0006)


def info(width=640, height=480, k=K, d=(), model='plumb_bob', p=None, binning=(0, 0),
         roi=(0, 0, 0, 0)):
    msg = MAKE.camera_info(0, '/camera', width, height, k, d, model, p)
    msg.binning_x, msg.binning_y = binning
    msg.roi = MAKE.make('sensor_msgs/msg/RegionOfInterest', roi[0], roi[1], roi[3], roi[2], False)
    return msg


@pytest.mark.parametrize('form', [lambda msg: msg, bags.live])
def test_a_pinhole_camera_is_the_formula_of_the_specification(form):
    found = camera(form(info()), 640, 480)
    expected = pinhole(640, 480, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    np.testing.assert_array_equal(found.rays, expected.rays)
    np.testing.assert_array_equal(found.K, K)
    assert found.frame_id == 'camera'
    assert camera(form(info()), 640, 480, frame_id='depth_optical').frame_id == 'depth_optical'


def test_k_is_scaled_to_the_size_of_the_image():
    found = camera(info(), 320, 240).K
    np.testing.assert_allclose([found[0, 0], found[0, 2], found[1, 1], found[1, 2]],
                               [260.0, (318.2 + 0.5) / 2 - 0.5, 257.5, (241.7 + 0.5) / 2 - 0.5])


def test_a_scaled_camera_sees_the_same_things():
    big, small = camera(info(), 640, 480).rays, camera(info(), 320, 240).rays
    corners = big.reshape(240, 2, 320, 2, 2).mean((1, 3))   # four pixels become one
    np.testing.assert_allclose(small, corners, atol=1e-12)


def test_binning_is_the_same_as_scaling():
    np.testing.assert_array_equal(camera(info(binning=(2, 2)), 320, 240).rays,
                                  camera(info(), 320, 240).rays)
    with pytest.raises(BadMessage, match='aspect'):
        camera(info(binning=(2, 1)), 320, 240)
    found = camera(info(binning=(2, 1)), 320, 480).K
    assert found[0, 0] == 260.0 and found[1, 1] == 515.0


def test_a_region_of_interest_shifts_the_centre():
    whole = camera(info(), 640, 480).rays
    found = camera(info(roi=(100, 60, 320, 240)), 320, 240).rays
    np.testing.assert_allclose(found, whole[60:300, 100:420], atol=1e-12)
    halved = camera(info(roi=(100, 60, 320, 240), binning=(2, 2)), 160, 120).K
    np.testing.assert_allclose(halved[0, 2], (318.2 - 100 + 0.5) / 2 - 0.5)


def test_an_info_without_a_size_is_the_images_own():
    np.testing.assert_array_equal(camera(info(width=0, height=0), 320, 240).K, K)


@pytest.mark.parametrize('model, D', [('plumb_bob', PLUMB), ('plumb_bob', (*PLUMB[:4],)),
                                      ('rational_polynomial', RATIONAL)])
def test_distorted_rays_project_to_their_pixels(model, D):
    rays = camera(info(d=D, model=model), 640, 480).rays
    points = np.dstack([rays, np.ones(rays.shape[:2])]).reshape(-1, 1, 3)
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(D))[0]
    v, u = np.mgrid[:480, :640]
    np.testing.assert_allclose(pixels.reshape(480, 640, 2), np.stack([u, v], -1), atol=1e-6)


def test_a_fisheye_ray_has_the_angle_of_the_model():
    rays = camera(info(d=FISHEYE, model='equidistant'), 640, 480).rays
    theta = np.arctan(np.hypot(rays[..., 0], rays[..., 1]))
    powers = sum(c * theta ** (2 * i + 3) for i, c in enumerate(FISHEYE))
    v, u = np.mgrid[:480, :640]
    seen = np.hypot((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1])
    np.testing.assert_allclose(theta + powers, seen, atol=1e-7)


@pytest.mark.parametrize('model, D', [('plumb_bob', PLUMB[:2]), ('plumb_bob', (*PLUMB, 0.0)),
                                      ('equidistant', FISHEYE[:3])])
def test_coefficients_that_are_left_out_are_zero(model, D):
    length = 4 if model == 'equidistant' else 8
    full = (*D, *(0.0,) * (length - len(D)))
    np.testing.assert_array_equal(camera(info(d=D, model=model), 640, 480).rays,
                                  camera(info(d=full, model=model), 640, 480).rays)


def test_distortion_follows_the_size():
    big = camera(info(d=PLUMB), 640, 480).rays
    small = camera(info(d=PLUMB), 320, 240).rays
    np.testing.assert_allclose(small, big.reshape(240, 2, 320, 2, 2).mean((1, 3)), atol=1e-5)


def test_pixels_that_no_ray_reaches_are_nan():
    rays = camera(info(d=(-0.9, 0.0, 0.0, 0.0, 0.0)), 640, 480).rays
    blind = np.isnan(rays[..., 0])
    assert blind[0, 0] and not blind[240, 320]
    np.testing.assert_array_equal(blind, np.isnan(rays[..., 1]))


def test_rectified_takes_p_and_leaves_the_distortion():
    P = np.hstack([K + np.diag([30.0, 30.0, 0]), [[-40.0], [0], [0]]])
    found = camera(info(d=PLUMB, model='nonsense', p=P), 640, 480, rectified=True)
    np.testing.assert_array_equal(found.rays,
                                  pinhole(640, 480, 550, 545, K[0, 2], K[1, 2]).rays)


@pytest.mark.parametrize('message, rectified, reason', [
    (info(k=np.zeros((3, 3))), False, 'camera info: bad K'),
    (info(k=K * [[1, 1, 1], [1, 0, 1], [1, 1, 1]]), False, 'camera info: bad K'),
    (info(k=K * np.nan), False, 'camera info: bad K'),
    (info(k=-K), False, 'camera info: bad K'),
    (info(p=np.zeros((3, 4))), True, 'camera info: bad P'),
    (info(d=PLUMB, model='kannala_brandt'), False, 'camera info: unknown distortion model'),
    (info(d=(np.nan, 0, 0, 0)), False, 'camera info: D not finite'),
    (info(d=np.ones(15)), False, 'camera info: too many distortion coefficients'),
    (info(d=np.ones(5), model='equidistant'), False,
     'camera info: too many distortion coefficients')])
def test_what_can_be_no_camera_is_refused(message, rectified, reason):
    for look in (lambda: camera(message, 640, 480, rectified), lambda: check(message, rectified)):
        with pytest.raises(BadMessage) as caught:
            look()
        assert caught.value.reason == reason


def test_another_aspect_ratio_is_refused():
    with pytest.raises(BadMessage, match='640 x 360.*640 x 480') as caught:
        camera(info(), 640, 360)
    assert caught.value.reason == 'camera info: another aspect ratio'


def test_an_unknown_model_without_distortion_is_a_pinhole():
    np.testing.assert_array_equal(camera(info(d=(0.0,) * 4, model=''), 640, 480).rays,
                                  camera(info(), 640, 480).rays)


def test_sizes_are_rounded_but_ratios_are_not():
    assert same_aspect((1920, 1080), (854, 480)) and same_aspect((640, 480), (20, 15))
    assert same_aspect((1296, 968), (640, 480)) and same_aspect((16, 12), (5, 4))
    assert not same_aspect((640, 480), (640, 360)) and not same_aspect((4, 3), (5, 3))


def test_infos_differ_by_content_not_by_stamp():
    first, second = info(d=PLUMB), info(d=PLUMB)
    second.header = MAKE.header(99, '/camera')
    assert content(first) == content(second) != content(info())
