"""Compressed images as image_transport sends them; helpers and a check that they are right."""

import struct
from types import SimpleNamespace

import cv2
import numpy as np
from persem_ros.inputs.decode import image_messages

HEADER = bytes(12)      # compressedDepth: quantisation that only float images use


def png_of(image, depth=True):
    """Return (format, data) of a uint16 depth image or of labels as PNG."""
    data = cv2.imencode('.png', image)[1].tobytes()
    return ('16UC1; compressedDepth png', HEADER + data) if depth else ('png', data)


def rvl_of(image):
    """Return (format, data) of a uint16 depth image in RVL (Wilson, 2017)."""
    nibbles, flat, previous, i = [], image.reshape(-1).astype(int), 0, 0
    while i < len(flat):
        zeros = 0
        while i + zeros < len(flat) and flat[i + zeros] == 0:
            zeros += 1
        i += zeros
        run = 0
        while i + run < len(flat) and flat[i + run] != 0:
            run += 1
        _put(nibbles, zeros)
        _put(nibbles, run)
        for value in flat[i:i + run]:
            delta = int(value) - previous
            _put(nibbles, (delta << 1) ^ (delta >> 63))
            previous = int(value)
        i += run
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << 4 * (7 - k) for k, n in enumerate(nibbles[j:j + 8]))
             for j in range(0, len(nibbles), 8)]
    size = struct.pack('<II', image.shape[1], image.shape[0])
    return '16UC1; compressedDepth rvl', HEADER + size + struct.pack(f'<{len(words)}I', *words)


def _put(nibbles, value):
    """Append a number, three bits at a time, the fourth says that more follow."""
    while True:
        bits, value = value & 7, value >> 3
        nibbles.append(bits | (8 if value else 0))
        if not value:
            return


def test_what_the_helpers_pack_is_what_the_node_unpacks():
    depth = np.random.default_rng(1).integers(0, 4000, (12, 16)).astype(np.uint16)
    depth[3:5, 2:9] = 0
    for form, data in (png_of(depth), rvl_of(depth)):
        found = image_messages.depth(SimpleNamespace(format=form, data=data))
        assert np.array_equal(found, depth / 1000.0)
