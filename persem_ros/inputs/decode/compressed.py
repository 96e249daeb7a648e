"""
Compressed images: PNG labels, JPEG and PNG colours, compressedDepth in PNG and RVL.

The format string of a CompressedImage decides, not the bytes: '16UC1; compressedDepth rvl',
'mono16; png compressed', 'png'. Every function raises ValueError(reason, sentence).

"""

from __future__ import annotations

import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.guard.limits import too_many_pixels
from persem_ros.guard.pictures import check_parts, pixels_of

HEADER = 12         # compressedDepth: int32 format, float32 A, float32 B
INTEGERS = ('16UC1', 'mono16')
# Depth without that header.
PLAIN = ('png', *(f'{name.lower()}; {how}' for name in INTEGERS
                  for how in ('png', 'png compressed')))
SIZE = 8            # RVL: uint32 columns, uint32 rows


def labels(
        form: str, data: NDArray[np.uint8], lossy: bool = False
) -> tuple[NDArray[np.uint8 | np.uint16], str]:
    """
    Decode PNG labels.

    Parameters
    ----------
    form : str
        The message's format.
    data : ndarray, uint8
        The message's data.
    lossy : bool
        Whether JPEG will do.

    Returns
    -------
    ndarray, shape (H, W), uint8 or uint16, or (H, W, 3 or 4), uint8
        Ids, or blue, green, red (and alpha).
    str
        The encoding that the format names, '' where it names none.

    """
    encoding, _, how = form.partition(';')
    if 'compressedDepth' in form:
        return _deep(form, data)[0], encoding.strip()
    if not lossy and ('jpeg' in form.lower() or 'jpg' in form.lower()):
        raise ValueError('lossy compression', f'a label image has the format {form!r}, whose '
                         'losses change ids; expected png')
    image = _imdecode(data, cv2.IMREAD_UNCHANGED, form)
    if image.ndim == 3 and (image.shape[2] < 3 or image.dtype != np.uint8):
        raise ValueError('odd channels', f'a label PNG has {image.shape[2]} channels of '
                         f'{image.dtype}, expected one channel of ids, or colours of 8 bits')
    return image, encoding.strip() if how else ''


def depth(form: str, data: NDArray[np.uint8]) -> NDArray[np.uint16 | np.float32]:
    """
    Decode a compressedDepth image.

    Returns
    -------
    ndarray, shape (H, W), uint16 or float32
        Millimetres (16UC1) or metres (32FC1).

    """
    deep = 'compressedDepth' in form
    if not deep and form.strip().lower() not in PLAIN:
        raise ValueError(f'format {form!r}', f'a compressed depth image has the format {form!r}, '
                         "expected '16UC1; compressedDepth png', '... rvl' or 'png'")
    if not deep:
        image = _imdecode(data, cv2.IMREAD_UNCHANGED, form)
        if image.ndim != 2 or image.dtype != np.uint16:
            raise ValueError('depth PNG not 16 bit', f'a depth PNG has {image.dtype} pixels of '
                             f'shape {image.shape}, expected one channel of uint16 millimetres')
        return image
    image, head = _deep(form, data)
    encoding = form.partition(';')[0].strip()
    if encoding in INTEGERS:
        return image
    if encoding != '32FC1':
        raise ValueError(f'encoding {encoding!r}', f'a compressed depth image has the format '
                         f'{form!r}, expected 16UC1 or 32FC1 before the semicolon')
    a, b = head.view('<f4')[1:]
    with np.errstate(divide='ignore'):
        return np.where(image > 0, a / (image.astype(np.float32) - b), np.float32(np.nan))


def color(form: str, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Decode a JPEG or PNG image as uint8 RGB of shape (H, W, 3)."""
    image = _imdecode(data, cv2.IMREAD_COLOR, form)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _deep(form: str, data: NDArray[np.uint8]) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Return the 16-bit image of compressedDepth data and its 12-byte header."""
    if data.size <= HEADER:
        raise ValueError('data too short', f'a compressedDepth image has {data.size} bytes, '
                         f'expected a header of {HEADER} and an image')
    head, body = data[:HEADER].copy(), data[HEADER:]
    if re.search(r'compressedDepth\s+rvl', form):
        return _rvl_image(body), head
    image = _imdecode(body, cv2.IMREAD_UNCHANGED, form)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise ValueError('depth PNG not 16 bit', f'a compressedDepth PNG has {image.dtype} '
                         f'pixels of shape {image.shape}, expected one channel of uint16')
    return image, head


def _imdecode(data: NDArray[np.uint8], flags: int, form: str) -> NDArray[Any]:
    """Decode with OpenCV, which answers None or throws at damaged data."""
    check_pixels(*pixels_of(data.data))
    check_parts(data.data)
    try:
        image = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise ValueError('damaged compressed image',
                         f'a compressed image of format {form!r} and {data.size} bytes cannot be '
                         'decoded')
    return image


def check_pixels(width: int, height: int) -> None:
    """Refuse an image that is larger than inputs.max_pixels allows, before it is decoded."""
    sentence = too_many_pixels(int(width), int(height))
    if sentence:
        raise ValueError('too many pixels', sentence)


def _rvl_image(body: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Decode the part of an RVL message that follows the header."""
    columns, rows = (int(x) for x in body[:SIZE].copy().view('<u4')) if body.size >= SIZE \
        else (0, 0)
    nibbles = 2 * (body.size - SIZE)
    if not columns * rows:
        raise ValueError('zero size', f'an RVL image has the size {columns} x {rows}')
    check_pixels(columns, rows)
    image = np.empty(columns * rows, np.uint16)
    if not rvl_decode(np.ascontiguousarray(body[SIZE:]), nibbles, image):
        raise ValueError('damaged RVL data', f'an RVL image of {columns} x {rows} pixels ends '
                         f'early or runs over, {body.size} bytes')
    return image.reshape(rows, columns)


@cached
def _number(data: NDArray[np.uint8], at: int, end: int) -> tuple[int, int]:
    """
    Read one variable-length number.

    Numbers are runs of nibbles, 3 bits each, the lowest first, the top bit says "more"; nibbles
    fill little-endian 32-bit words from the top, so that byte 3 of a word comes first.

    """
    value = 0
    shift = 0
    while at < end and shift <= 30:
        word, inside = at >> 3, at & 7
        byte = data[word * 4 + 3 - (inside >> 1)]
        nibble = np.int64(byte >> 4 if inside & 1 == 0 else byte & 15)
        at += 1
        value |= (nibble & 7) << shift
        if nibble & 8 == 0:
            return value, at
        shift += 3
    return -1, at


@cached
def rvl_decode(data: NDArray[np.uint8], end: int, out: NDArray[np.uint16]) -> bool:
    """
    Decode RVL (Wilson 2017: runs of zeros, runs of zigzag differences) into *out*.

    Parameters
    ----------
    data : ndarray, uint8
        The code, whole 32-bit words.
    end : int
        How many nibbles may be read.
    out : ndarray, shape (N,), uint16
        The pixels.

    Returns
    -------
    bool
        False where the code ends early or does not fit.

    """
    end = min(end, data.size // 4 * 8)
    at = 0
    done = 0
    previous = 0
    while done < out.size:
        zeros, at = _number(data, at, end)
        if zeros < 0 or zeros > out.size - done:
            return False
        out[done:done + zeros] = 0
        done += zeros
        if done == out.size:
            break
        count, at = _number(data, at, end)
        if count < 0 or count > out.size - done or (zeros == 0 and count == 0):
            return False
        for _ in range(count):
            code, at = _number(data, at, end)
            if code < 0:
                return False
            previous += (code >> 1) ^ -(code & 1)
            out[done] = previous & 0xffff
            done += 1
    return True
