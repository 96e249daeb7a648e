"""Label images that are colours, channels or instances; sizes that show the view otherwise."""

import cv2
import numpy as np
from persem_ros.inputs import fit
from persem_ros.inputs.decode.labels import LabelReader
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.settings.config import Config, updated
from persem_ros.settings.legend_files import load_legend
import pytest
from rosbags.typesys import get_typestore, Stores

MAKE = MessageFactory(get_typestore(Stores.ROS2_JAZZY).types)
TOWN = load_legend('town')
IDS = np.array([[0, 1, 2, 3], [3, 3, 2, 1]])


def image(pixels, encoding):
    """Return an Image of pixels (H, W[, n])."""
    pixels = np.ascontiguousarray(pixels)
    return MAKE.make('sensor_msgs/msg/Image', MAKE.header(1, 'camera'), *pixels.shape[:2],
                     encoding, 0, pixels[0].nbytes, pixels.reshape(-1).view(np.uint8))


def reader(**values):
    """Return a LabelReader with settings labels.*."""
    return LabelReader(updated(Config(), {f'labels.{k}': v for k, v in values.items()}).labels)


def planes(ids, channel, n):
    """Return ids in one channel of n, 255 in the fourth."""
    pixels = np.zeros((*ids.shape[:2], n), np.uint8)
    pixels[..., 3:] = 255
    pixels[..., channel] = ids
    return pixels


@pytest.mark.parametrize('encoding, place, channel, n', [
    ('bgra8', 2, 'r', 4), ('rgba8', 0, 'r', 4), ('rgb8', 1, 'g', 3), ('bgr8', 0, 'b', 3),
    ('8UC3', 2, 'r', 3), ('rgb8', slice(0, 3), 'r', 3)])
def test_ids_in_one_channel_are_found(encoding, place, channel, n):
    read = reader()
    ids = IDS[..., None] if isinstance(place, slice) else IDS
    empty, _ = read(image(planes(0 * IDS, 0, n), encoding))
    assert not empty.any() and not read.channel         # tells nothing yet
    found, kept = read(image(planes(ids, place, n), encoding))
    assert found.tolist() == IDS.tolist() and kept == 'mono8' and read.channel == channel
    assert f'--set labels.channel={channel}' in read.note
    told = reader(channel=channel)
    assert told(image(planes(ids, place, n), encoding))[0].tolist() == IDS.tolist()
    assert not told.note


@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8', 'rgba8', 'bgra8', 'png'])
@pytest.mark.parametrize('channel', ['', 'legend'])
def test_colours_of_the_legend(encoding, channel):
    ids = np.array(TOWN.ids)[IDS]
    colors = TOWN.colors(ids)
    if encoding == 'png':
        msg = MAKE.compressed(1, 'camera', 'png', cv2.imencode('.png', colors[..., ::-1])[1])
    else:
        order = [{'r': 0, 'g': 1, 'b': 2, 'a': 3}[c] for c in encoding[:-1]]
        msg = image(np.dstack([colors, np.full(ids.shape, 9, np.uint8)])[..., order], encoding)
    read = reader(channel=channel)
    found, kept = read(msg, TOWN)
    assert found.tolist() == ids.tolist() and read.channel == 'legend' and not read.note
    assert kept in ('mono8', 'mono16')


def test_colours_beside_those_of_the_legend_get_the_nearest_and_are_said():
    ids = np.full((10, 10), TOWN.ids[1])
    colors = TOWN.colors(ids).astype(int)
    colors[0, :5] += np.where(colors[0, :5] < 128, 3, -3)
    read = reader()
    found, _ = read(image(colors.astype(np.uint8), 'rgb8'), TOWN)
    assert (found == TOWN.ids[1]).all() and read.note.startswith('5 % of the label pixels')
    jpeg = MAKE.compressed(1, 'camera', 'jpeg', cv2.imencode('.jpg', TOWN.colors(ids))[1])
    with pytest.raises(BadMessage, match='losses'):
        read = reader()
        read(jpeg, TOWN)
    assert reader(channel='legend')(jpeg, TOWN)[0].shape == (10, 10)


def test_colours_of_nobody_knows_what_are_refused_with_what_to_type():
    rgb = np.random.default_rng(0).integers(0, 255, (4, 4, 3)).astype(np.uint8)
    for read, legend, words in ((reader(), None, 'labels.legend=FILE'),
                                (reader(), TOWN, 'the legend has'),
                                (reader(channel='legend'), None, 'labels.legend'),
                                (reader(channel='a'), None, 'without channel a')):
        with pytest.raises(BadMessage, match=words):
            read(image(rgb, 'rgb8'), legend)


def test_instances_become_classes():
    ids = np.array([[7001, 7002, 65_012_345, -1, 999]], np.int32)
    found, kept = reader(divisor=1000)(image(ids, '32SC1'))
    assert found.tolist() == [[7, 7, 65012, -1, 0]] and kept == '32SC1'
    assert reader(divisor=0)(image(ids, '32SC1'))[0].tolist() == ids.tolist()


# ---- labels.fit


def drawn(rows, columns):
    """Return an image of (row, column) centres of a view, each 0 .. 1."""
    return np.stack(np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5)
                                / columns, indexing='ij'), -1).reshape(-1, 2)


@pytest.mark.parametrize('fitting, shape', [('stretch', (32, 32)), ('crop', (32, 32)),
                                            ('letterbox', (32, 32)), ('crop', (48, 16)),
                                            ('letterbox', (16, 48)), ('stretch', (10, 60))])
def test_pixels_that_belong_together_show_the_same_place(fitting, shape):
    h, w = 24, 32
    found = fit.matching(shape, (h, w), fitting)
    view = drawn(h, w) * (h, w)                     # depth pixels, from the corner
    centre, size = np.array([h, w]) / 2, np.array(shape)
    scale = size / (h, w)
    if fitting != 'stretch':
        scale = np.repeat(scale.max() if fitting == 'crop' else scale.min(), 2)
    at = (view - centre) * scale + size / 2
    inside = ((at >= 0) & (at < size)).all(1)
    expected = np.where(inside, np.floor(at[:, 0] + 1e-9) * shape[1] + np.floor(at[:, 1] + 1e-9),
                        -1)
    assert found.labels_of.ravel().tolist() == expected.tolist()
    assert inside.all() == (fitting != 'crop')
    back = found.depth_of.ravel()
    assert (back >= 0).all() == (fitting != 'letterbox') and back.max() < h * w


def test_another_aspect_ratio_is_refused_unless_something_fits():
    assert fit.matching((968, 1296), (480, 640), 'exact') is None
    assert fit.matching((24, 32), (12, 16), 'crop') is None
    with pytest.raises(BadMessage, match='labels.fit=stretch'):
        fit.matching((32, 32), (24, 32), 'exact')


def test_a_legend_that_fits_no_colour_is_told_from_none():
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0], red[0, :, 1] = 200, 7
    with pytest.raises(BadMessage) as fault:
        reader()(image(red, 'rgb8'), TOWN)
    first = TOWN.classes[0]
    assert '0 % of the pixels have a colour of the legend' in str(fault.value)
    assert 'are (200, 0, 0), (200, 7, 0), the legend has' in str(fault.value)
    assert f'{tuple(first.color)} {first.name}' in str(fault.value)
    with pytest.raises(BadMessage) as fault:
        reader()(image(red, 'rgb8'))
    assert 'the legend has' not in str(fault.value)


def test_colours_in_the_other_order_or_of_a_shipped_legend_are_recognised():
    colors = TOWN.colors(np.array(TOWN.ids)[IDS])
    with pytest.raises(BadMessage, match='red and blue in the other order they fit'):
        reader()(image(colors[..., ::-1], 'rgb8'), TOWN)
    with pytest.raises(BadMessage, match='those of --set labels.legend=town'):
        reader()(image(colors, 'rgb8'), load_legend('cityscapes'))
    with pytest.raises(BadMessage, match='--set labels.legend=town'):
        reader()(image(colors, 'rgb8'))


@pytest.mark.parametrize('legend', [TOWN, None])
def test_one_channel_of_a_legends_colours_is_no_id(legend):
    read, colors = reader(channel='r'), TOWN.colors(np.array(TOWN.ids)[IDS])
    read(image(0 * colors, 'rgb8'), legend)         # tells nothing
    for pixels in (colors, planes(IDS, 0, 3)):      # and what was found of the first holds
        with pytest.raises(BadMessage, match='channel r alone is no id: --set labels.channel='):
            read(image(pixels, 'rgb8'), legend)


@pytest.mark.parametrize('pixels', [
    planes(IDS, 0, 3), np.repeat(IDS[..., None], 3, 2).astype('u1'),
    # Black is in every legend.
    planes(np.where(np.arange(2000).reshape(40, 50) < 9, 7, 0), 0, 3)])
def test_ids_in_a_channel_are_not_taken_for_colours(pixels):
    assert reader(channel='r')(image(pixels, 'rgb8'), TOWN)[0].tolist() == pixels[..., 0].tolist()
