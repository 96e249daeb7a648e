"""A few kilobytes that say or unpack to gigabytes are refused, by what they say of themselves."""

from contextlib import closing
import sqlite3
import struct
import tracemalloc

import bags
import numpy as np
from persem_ros.errors import PersemError
from persem_ros.guard import limits
from persem_ros.inputs.decode import compressed
from persem_ros.inputs.recording import packing
from persem_ros.inputs.recording.source import Source
import pytest
from rosbags.rosbag2.storage_mcap import zstd

PIXELS = 1_000_000      # so that a bomb of some 64 MB is one
MOST = PIXELS * limits.BYTES_A_PIXEL


@pytest.fixture(autouse=True)
def small_bound():
    """Lower inputs.max_pixels while a test runs."""
    before = limits.max_pixels()
    limits.use(PIXELS)
    yield
    limits.use(before)


@pytest.fixture(scope='module')
def bomb():
    """Return a zstd frame of a few kilobytes that unpacks to 64 MB."""
    return zstd.compress(bytes(4 * MOST))


def test_a_message_that_unpacks_to_too_much(bomb):
    assert len(bomb) < 20_000
    tracemalloc.start()
    try:
        with pytest.raises(packing.TooLarge, match='raise inputs.max_pixels'):
            packing.message(bomb)
        assert tracemalloc.get_traced_memory()[1] < 3 * MOST
    finally:
        tracemalloc.stop()


def test_a_chunk_that_says_too_much_or_too_little(bomb):
    with pytest.raises(packing.TooLarge, match='raise inputs.max_pixels'):
        packing.unpacked('zstd', bomb, 4 * MOST)
    with pytest.raises(packing.TooLarge, match='more than the 1000 bytes'):
        packing.unpacked('zstd', bomb, 1000)


def test_an_image_whose_header_says_too_much():
    head = b'\x89PNG\r\n\x1a\n' + struct.pack('>I4sIIBBBBB', 13, b'IHDR', 60000, 45000, 8,
                                              0, 0, 0, 0)
    rvl = bytes(12) + struct.pack('<II', 60000, 45000) + bytes(16)
    for read, form, data in ((compressed.labels, 'mono8; png compressed', head),
                             (compressed.color, 'png', head),
                             (compressed.depth, '16UC1; compressedDepth png', bytes(12) + head),
                             (compressed.depth, '16UC1; compressedDepth rvl', rvl)):
        with pytest.raises(ValueError, match='--set inputs.max_pixels=2700000000') as caught:
            read(form, np.frombuffer(data, np.uint8))
        assert caught.value.args[0] == 'too many pixels'


def test_a_recording_of_messages_that_unpack_to_too_much_is_given_up(tmp_path, bomb):
    path = bags.write(tmp_path / 'bag', 2, storage='sqlite3')
    with closing(sqlite3.connect(next(path.glob('*.db3')))) as db:
        db.execute('UPDATE messages SET data = ?', (bomb,))
        db.commit()
    with Source(path) as source, pytest.raises(PersemError, match='raise inputs.max_pixels'):
        list(source.messages({topic.name for topic in source.topics}))
