"""Images to arrays: every encoding, both byte orders, and what is refused."""

from types import SimpleNamespace

import cv2
from message_forms import MAKE, STAMP
import numpy as np
from persem_ros.inputs.decode import image_messages as images
from persem_ros.inputs.decode.compressed import rvl_decode
from persem_ros.inputs.decode.messages import BadMessage
import pytest


def raw(data, height, width, encoding, step=None, big=0):
    """Return an Image with the bytes of *data* as they are."""
    data = np.frombuffer(np.asarray(data).tobytes(), np.uint8)
    return MAKE.make('sensor_msgs/msg/Image', MAKE.header(STAMP, '/camera'), height, width,
                     encoding, big, step or data.size // max(height, 1), data)


def packed(form_text, data):
    """Return a CompressedImage."""
    return MAKE.compressed(STAMP, 'camera', form_text, bytes(data))


def png(image):
    """Return the bytes of a PNG."""
    return cv2.imencode('.png', image)[1].tobytes()


@pytest.mark.parametrize('encoding, dtype', [
    ('mono8', 'u1'), ('8UC1', 'u1'), ('mono16', '<u2'), ('16UC1', '>u2'), ('16SC1', '<i2'),
    ('16SC1', '>i2'), ('32SC1', '<i4'), ('32SC1', '>i4')])
def test_labels_of_every_encoding(form, encoding, dtype):
    info = np.iinfo(dtype)
    ids = np.array([[0, 1, 2], [info.max, info.min, 7]])
    image, kept = images.labels(form(raw(ids.astype(dtype), 2, 3, encoding, big='>' in dtype)))
    assert kept == encoding and image.dtype == np.int32 and image.flags.writeable
    np.testing.assert_array_equal(image, ids)


@pytest.mark.parametrize('order', '<>')
def test_padded_rows_are_cut(form, order):
    values = np.arange(20, dtype=f'{order}u2').reshape(4, 5)
    image, _ = images.labels(form(raw(values, 4, 3, 'mono16', big=order == '>')))
    np.testing.assert_array_equal(image, values[:, :3])


def test_rows_of_an_odd_number_of_bytes():
    rows = np.zeros((3, 7), np.uint8)
    rows[:, :4] = np.array([[1, 2], [3, 4], [5, 6]], '<u2').view(np.uint8)
    image, _ = images.labels(raw(rows, 3, 2, 'mono16'))
    np.testing.assert_array_equal(image, [[1, 2], [3, 4], [5, 6]])


@pytest.mark.parametrize('order', '<>')
def test_depth_in_millimetres_and_metres(form, order):
    mm = np.array([[0, 1, 1999, 65535]], f'{order}u2')
    found = images.depth(form(raw(mm, 1, 4, '16UC1', big=order == '>')))
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, [[0.0, 0.001, 1.999, 65.535]])
    metres = np.array([[np.nan, np.inf, -np.inf, -1.0, 0.0, 1.1]], f'{order}f4')
    found = images.depth(form(raw(metres, 1, 6, '32FC1', big=order == '>')))
    np.testing.assert_array_equal(found, metres.astype(np.float64))


@pytest.mark.parametrize('encoding, dtype, stored, scale, metres', [
    ('mono16', '<u2', 1999, 0.0, 1.999), ('mono16', '>u2', 1999, 0.0, 1.999),
    ('64FC1', '<f8', 1.1, 0.0, 1.1), ('64FC1', '>f8', 1.1, 0.0, 1.1),
    ('16UC1', '<u2', 1999, 0.001, 1.999), ('16UC1', '<u2', 40001, 0.00025, 10.00025),
    ('32FC1', '<f4', 1500.0, 0.001, 1.5), ('16UC1', '<u2', 7, 1.0, 7.0)])
def test_depth_of_other_encodings_and_units(form, encoding, dtype, stored, scale, metres):
    values = np.array([[stored, 0]], dtype)
    found = images.depth(form(raw(values, 1, 2, encoding, big='>' in dtype)), scale)
    assert found.dtype == np.float64 and found.tolist() == [[metres, 0.0]]


@pytest.mark.parametrize('form_text', ['mono16; png compressed', '16UC1; png', 'png'])
def test_depth_in_a_plain_png(form_text):
    found = images.depth(packed(form_text, png(np.array([[0, 1500]], np.uint16))), 0.01)
    np.testing.assert_array_equal(found, [[0.0, 15.0]])


@pytest.mark.parametrize('encoding, pixel', [
    ('rgb8', [1, 2, 3]), ('bgr8', [3, 2, 1]), ('rgba8', [1, 2, 3, 9]), ('bgra8', [3, 2, 1, 9])])
def test_colors_are_rgb(form, encoding, pixel):
    data = np.tile(np.array(pixel, np.uint8), (2, 3, 1))
    np.testing.assert_array_equal(images.color(form(raw(data, 2, 3, encoding))),
                                  np.tile([1, 2, 3], (2, 3, 1)))


@pytest.mark.parametrize('read, message, reason', [
    (images.labels, raw(np.zeros(12, 'u1'), 2, 2, 'rgb8'), 'colours instead of ids'),
    (images.labels, raw(np.zeros(4, 'f4'), 2, 2, '32FC1'), "encoding '32FC1'"),
    (images.labels, raw(np.zeros(4, 'u1'), 2, 2, ''), "encoding ''"),
    (images.depth, raw(np.zeros(4, 'u1'), 2, 2, 'mono8'), "encoding 'mono8'"),
    (images.color, raw(np.zeros(4, 'u1'), 2, 2, 'bayer_rggb8'), "encoding 'bayer_rggb8'"),
    (images.labels, raw(np.zeros(7, 'u1'), 2, 4, 'mono8', step=4), 'data too short'),
    (images.labels, raw(np.zeros(0, 'u1'), 2, 4, 'mono8', step=4), 'data too short'),
    (images.depth, raw(np.zeros(8, 'u1'), 2, 4, '16UC1', step=4), 'row shorter than width'),
    (images.labels, raw(np.zeros(0, 'u1'), 0, 0, 'mono8'), 'zero size'),
    (images.depth, raw(np.zeros(0, 'u1'), 3, 0, '32FC1'), 'zero size')])
def test_bad_images_are_refused_in_a_sentence(form, read, message, reason):
    with pytest.raises(BadMessage) as caught:
        read(form(message))
    assert caught.value.reason == reason and len(str(caught.value)) > len(reason)


@pytest.mark.parametrize('dtype, encoding', [(np.uint8, 'mono8'), (np.uint16, 'mono16')])
@pytest.mark.parametrize('text', ['png', '{}; png compressed ', 'rgb8; png compressed'])
def test_png_labels(form, dtype, encoding, text):
    ids = np.arange(12, dtype=dtype).reshape(3, 4) * 21
    image, kept = images.labels(form(packed(text.format(encoding), png(ids))))
    assert kept == encoding
    np.testing.assert_array_equal(image, ids)


def test_compressed_labels_that_are_no_ids(form):
    for text, data, reason in [
            ('jpeg', b'\xff\xd8\xff', 'lossy compression'),
            ('png', png(np.zeros((2, 2, 3), np.uint8)), 'colours instead of ids'),
            ('png', b'\x89PNG nothing', 'damaged compressed image'),
            ('png', b'', 'damaged compressed image')]:
        with pytest.raises(BadMessage) as caught:
            images.labels(form(packed(text, data)))
        assert caught.value.reason == reason


def test_compressed_color(form):
    rgb = np.zeros((4, 5, 3), np.uint8)
    rgb[..., 0] = 200
    found = images.color(form(packed('bgr8; png compressed bgr8', png(rgb[..., ::-1]))))
    np.testing.assert_array_equal(found, rgb)


def rvl_encode(image):
    """Encode as the paper does (Wilson 2017), in plain Python."""
    nibbles, previous, pixels, at = [], 0, [int(x) for x in image.ravel()], 0

    def put(value):
        while True:
            nibble, value = value & 7, value >> 3
            nibbles.append(nibble | (8 if value else 0))
            if not value:
                return

    while at < len(pixels):
        zeros = at
        while at < len(pixels) and pixels[at] == 0:
            at += 1
        put(at - zeros)
        run = at
        while at < len(pixels) and pixels[at] != 0:
            at += 1
        put(at - run)
        for value in pixels[run:at]:
            delta, previous = value - previous, value
            put(2 * delta if delta >= 0 else -2 * delta - 1)
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int(''.join(f'{n:x}' for n in nibbles[i:i + 8]), 16)
             for i in range(0, len(nibbles), 8)]
    return np.array(words, '<u4').tobytes()


def deep(text, image, how, a=0.0, b=0.0):
    """Return a compressedDepth message of a uint16 image."""
    head = np.zeros(1, '<i4').tobytes() + np.array([a, b], '<f4').tobytes()
    body = png(image) if how == 'png' else \
        np.array(image.shape[::-1], '<u4').tobytes() + rvl_encode(image)
    return packed(text, head + body)


@pytest.fixture
def holes():
    """Return millimetres with holes, far jumps and both ends of the range."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 65536, (23, 31)).astype(np.uint16)
    image[rng.random(image.shape) < 0.4] = 0
    image[0, :3] = 0, 65535, 1
    return image


@pytest.mark.parametrize('text, how', [
    ('16UC1; compressedDepth png', 'png'), ('16UC1; compressedDepth', 'png'),
    ('16UC1; compressedDepth rvl', 'rvl')])
def test_compressed_depth(form, holes, text, how):
    np.testing.assert_array_equal(images.depth(form(deep(text, holes, how))), holes / 1000.0)


@pytest.mark.parametrize('how', ['png', 'rvl'])
def test_compressed_inverse_depth(form, how):
    metres = np.array([[0.5, 1.0, 4.2, 9.5]])
    a = 100.0 * 101.0           # as compressed_depth_image_transport does: quantisation 100
    b = 1.0 - a / 10.0          # and 10 m at most
    code = (a / metres + b).astype(np.uint16)
    code[0, 3] = 0
    found = images.depth(form(deep(f'32FC1; compressedDepth {how}', code, how, a, b)))
    np.testing.assert_allclose(found[0, :3], metres[0, :3], rtol=2e-3)
    assert np.isnan(found[0, 3])


def test_a_depth_png_without_a_header(form, holes):
    np.testing.assert_array_equal(images.depth(form(packed('png', png(holes)))), holes / 1000.0)


@pytest.mark.parametrize('image', [np.zeros((3, 5), np.uint16), np.full((3, 5), 7, np.uint16),
                                   np.array([[0, 0, 5, 65535, 0]], np.uint16)])
def test_rvl_runs_at_the_ends(image):
    out = np.full(image.size, 99, np.uint16)
    code = np.frombuffer(rvl_encode(image), np.uint8)
    assert rvl_decode(code, 2 * code.size, out)
    np.testing.assert_array_equal(out, image.ravel())


def test_damaged_compressed_depth_is_refused(holes):
    whole = deep('16UC1; compressedDepth rvl', holes, 'rvl')
    rng = np.random.default_rng(2)
    for length in (0, 5, 12, 15, 20, 60, len(whole.data) // 2):
        cut = SimpleNamespace(format=whole.format, data=whole.data[:length].copy())
        with pytest.raises(BadMessage):
            images.depth(cut)
    for _ in range(200):        # wrong bytes give a wrong image or a refusal, never a crash
        data = whole.data.copy()
        data[20 + rng.integers(0, data.size - 20, 5)] = rng.integers(0, 256, 5)
        try:
            assert images.depth(SimpleNamespace(format=whole.format, data=data)).shape \
                == holes.shape
        except BadMessage as fault:
            assert fault.reason == 'damaged RVL data'
    for text in ('8UC1; compressedDepth png', 'jpeg', '16UC1; zdepth'):
        with pytest.raises(BadMessage):
            images.depth(SimpleNamespace(format=text, data=deep(text, holes, 'png').data))
