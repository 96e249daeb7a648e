"""Images that announce more than they hold, or that take hours, are refused before decoding."""

import struct
import zlib

import cv2
import numpy as np
from persem_ros.guard.pictures import check_parts, pixels_of, SCANS, TEXTS
import pytest

IDS = np.arange(48, dtype=np.uint8).reshape(6, 8)
PNG = cv2.imencode('.png', IDS)[1].tobytes()
JPEG = cv2.imencode('.jpg', IDS)[1].tobytes()


def chunk(kind, data=b''):
    return struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))


@pytest.mark.parametrize('data', [PNG, JPEG, PNG + b'more', JPEG[:-2]], ids=str)
def test_sizes_of_whole_images(data):
    assert pixels_of(memoryview(data)) == (8, 6)
    check_parts(memoryview(data))


@pytest.mark.parametrize(('data', 'words'), [
    (b'', 'neither PNG nor JPEG'), (b'BM' + PNG, 'neither PNG nor JPEG'),
    (PNG[:8], 'cut off'), (PNG[:-1], 'cut off'), (PNG[:40], 'cut off'),
    (PNG[:33] + b'\xff' * 8 + PNG[41:], 'cut off'),     # 87 bytes took 12 s and 4 GB to decode
    (PNG[:8] + chunk(b'IDAT') + PNG[8:], 'begin with its size'),
    (PNG[:33] + (TEXTS + 1) * chunk(b'zTXt', b'a\0\0x') + PNG[33:], 'compressed texts'),
    (JPEG[:2], 'nothing of its size'), (JPEG + SCANS * b'\xff\xda', 'scans')],
    ids=lambda value: value if isinstance(value, str) else None)
def test_images_that_cannot_be_whole(data, words):
    with pytest.raises(ValueError, match=words) as caught:
        pixels_of(memoryview(data))
        check_parts(memoryview(data))
    assert caught.value.args[0] == 'damaged compressed image'
    assert 'expected a whole PNG or JPEG' in caught.value.args[1]
