"""Every bound is a sentence that names the limit, and how to raise it or what to do instead."""

from pathlib import Path
import struct
import zlib

import cv2
import numpy as np
from persem_ros.convert import images
from persem_ros.core.geometry.method import check_pairs
from persem_ros.errors import PersemError
from persem_ros.guard import limits
from persem_ros.guard.pictures import check_parts, SCANS, TEXTS
from persem_ros.guard.yaml_text import LEGEND, load, RECORDING, SETTINGS
from persem_ros.inputs.decode import compressed, image_messages, legends
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.recording import packing
import pytest
from rosbags.rosbag2.storage_mcap import zstd

PNG = cv2.imencode('.png', np.zeros((6, 8), np.uint8))[1].tobytes()
JPEG = cv2.imencode('.jpg', np.zeros((6, 8), np.uint8))[1].tobytes()
PIXELS = 1000


def png(width, height):
    """Return a PNG whose header says a size that its data have not."""
    head = b'IHDR' + struct.pack('>IIBBBBB', width, height, 8, 0, 0, 0, 0)
    return PNG[:12] + head + struct.pack('>I', zlib.crc32(head)) + PNG[33:]


def tiff(tag, order='<'):
    """Return the head of a TIFF of 8 x 6 pixels in which a size (*tag*) is 60 000."""
    entries = {256: 8, 257: 6, tag: 60_000}
    mark = b'II' if order == '<' else b'MM'
    return mark + struct.pack(f'{order}HIH', 42, 8, len(entries)) + b''.join(
        struct.pack(f'{order}HHII', k, 4, 1, v) for k, v in sorted(entries.items()))


def npy(shape):
    """Return the header of a .npy file of a shape."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b'\x93NUMPY\1\0' + struct.pack('<H', len(head)) + head


def raw(width, height):
    """Return a sensor_msgs/Image that says a size."""
    class Message:
        """What is read of one."""

        encoding, step, is_bigendian, data = 'mono8', width, 0, np.zeros(9, np.uint8)
    Message.width, Message.height = width, height
    return Message


def text(content):
    """Return a std_msgs/String."""
    class Message:
        """What is read of one."""

        data = content
    return Message


def check(voxels, classes):
    """Check the pairs of votes for all classes in each voxel."""
    check_pairs(voxels * float(classes) ** 2, float(voxels * classes), classes, classes)


def file(name, content):
    """Return what reads a file of this content."""
    def read(folder):
        (folder / name).write_bytes(content)
        images.read_array(folder / name)
    return read


def as_image(data):
    return np.frombuffer(data, np.uint8)


DEEP, WIDE, LONG = '[' * 40, '[' + 'x, ' * 20_001 + ']', 'x' * 10_001
BOUNDS = {
    # what, how it is met, the limit and the way out
    'pixels of a PNG': (lambda _: compressed.labels('png', as_image(png(60, 60))),
                        '(1000)', '--set inputs.max_pixels=3600'),
    'pixels of an RVL image': (
        lambda _: compressed.depth('16UC1; compressedDepth rvl', as_image(
            bytes(12) + struct.pack('<II', 60, 60) + bytes(16))),
        '(1000)', '--set inputs.max_pixels=3600'),
    'pixels of a raw image': (lambda _: image_messages.labels(raw(60, 60)), '(1000)',
                              '--set inputs.max_pixels=3600'),
    'texts of a PNG': (lambda _: check_parts(memoryview(PNG[:33] + (TEXTS + 1) * (
        struct.pack('>I', 4) + b'zTXta\0\0x' + bytes(4)) + PNG[33:])), '16', 'save it anew'),
    'scans of a JPEG': (lambda _: check_parts(memoryview(JPEG + SCANS * b'\xff\xda')), '100',
                        'save it anew'),
    'a chunk': (lambda _: packing.unpacked('zstd', b'', 16_001), '16000 bytes',
                'raise inputs.max_pixels'),
    'a message': (lambda _: packing.message(zstd.compress(bytes(20_000))), '16000 bytes',
                  'raise inputs.max_pixels'),
    'a file': (lambda folder: packed(folder), '1000 bytes', 'zstd -d'),
    **{f'{name} of settings': (lambda _, t=t: load(t, 'file', SETTINGS), limit, 'leave out what')
       for name, t, limit in (('levels', DEEP, '32 levels'), ('values', WIDE, '20000 values'),
                              ('characters', LONG, '10000 characters'),
                              ('size', '#' * (SETTINGS.size + 1), '1048576 characters'))},
    'values of a legend': (lambda _: load('[' + 'x,' * 60 + ']', 'file', LEGEND._replace(
        nodes=50)), '50 values', 'no legend needs more'),
    'values of metadata.yaml': (lambda _: load('[' + 'x,' * 60 + ']', 'file', RECORDING._replace(
        nodes=50)), '50 values', 'remove it'),
    'pairs of classes': (lambda _: check(1, 65_535), '6.71e+07',
                         'choose another refine.method'),
    'pairs that are counted': (lambda _: check(1000, 2000), '64 a vote',
                               'choose another refine.method'),
    'a table of names': (lambda _: legends.table(text('{' + ' ' * legends.LONGEST + '}')),
                         str(legends.LONGEST), 'expected vision_msgs/LabelInfo'),
    **{f'pixels of a {name}': (file(name, content), '(1000)', '--max-pixels 36')
       for name, content in (
           ('a.png', png(60, 60)), ('a.bmp', b'BM' + bytes(16) + struct.pack('<ii', 60, -60)),
           ('a.pgm', b'P5\n# a note\n60 60 255\n'))},
    **{f'{name} of a TIFF': (file('a.tiff', tiff(tag, order)), '(1000)', '--max-pixels')
       for name, tag, order in (('width', 256, '<'), ('height', 257, '>'))},
    'values of a .npy file': (file('a.npy', npy('(60, 60)')), 'of 1000', '--max-pixels 1800')}


def packed(folder):
    (folder / 'a.mcap.zst').write_bytes(zstd.compress(bytes(5000)))
    packing.unpack_file(folder / 'a.mcap.zst', folder / 'a.mcap')


@pytest.fixture
def bounds(monkeypatch):
    """Lower the bounds, so that what exceeds them is small."""
    before = limits.max_pixels()
    limits.use(PIXELS)
    monkeypatch.setattr(packing, 'SMALL', 1000)
    monkeypatch.setattr(packing, 'RATIO', 1)
    yield
    limits.use(before)


@pytest.mark.parametrize('what', BOUNDS)
def test_a_bound_names_itself_and_what_to_do(bounds, tmp_path: Path, what):
    meet, limit, way_out = BOUNDS[what]
    with pytest.raises((PersemError, BadMessage, ValueError)) as caught:
        meet(tmp_path)
    sentence = str(caught.value.args[-1])
    assert limit in sentence and way_out in sentence, sentence
    assert len(sentence) < 600 and sentence.isprintable()


@pytest.mark.parametrize('name', ['a.png', 'a.jpg', 'a.tiff', 'a.bmp', 'a.pgm', 'a.pfm'])
def test_sizes_of_honest_files(tmp_path, name):
    array = np.arange(48).reshape(6, 8).astype(np.float32 if name == 'a.pfm' else np.uint8)
    cv2.imwrite(str(tmp_path / name), array)
    assert images.read_array(tmp_path / name).shape == (6, 8)
    assert images.pixels_of_file(memoryview((tmp_path / name).read_bytes())) == (8, 6)


@pytest.mark.parametrize('content', [b'', b'II*', b'MM\0+' + bytes(4), b'BM', b'P5', b'P5 x y',
                                     b'GIF89a' + bytes(20), tiff(256)[:20], npy('(9, 9)')[:20],
                                     b'P9 1 1', b'Pf\n-4 \xff 1\n'], ids=repr)
@pytest.mark.parametrize('name', ['a.tiff', 'a.npy'])
def test_what_is_no_image_is_one_sentence(tmp_path, name, content):
    with pytest.raises(PersemError, match='not an image that can be decoded'):
        file(name, content)(tmp_path)
