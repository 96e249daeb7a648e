"""Pictures as data URIs: PNG with a palette, PNG, JPEG."""

from __future__ import annotations

import base64
import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray


def indexed_png(
        index: NDArray[np.uint8], palette: NDArray[np.uint8], clear: int | None = None) -> bytes:
    """
    Return an image of few colours as a PNG with a palette: a third of the size of an RGB one.

    OpenCV writes no palettes, and the format is four chunks.

    Parameters
    ----------
    index : ndarray, shape (H, W), uint8
        Row of the palette of each pixel.
    palette : ndarray, shape (n, 3), uint8
        Red, green, blue; n <= 256.
    clear : int, optional
        The row that is transparent.

    Returns
    -------
    bytes

    """
    height, width = index.shape
    rows = np.zeros((height, width + 1), np.uint8)      # each row begins with its filter: none
    rows[:, 1:] = index
    chunks = [(b'IHDR', struct.pack('>IIBBBBB', width, height, 8, 3, 0, 0, 0)),
              (b'PLTE', np.ascontiguousarray(palette, np.uint8).tobytes())]
    if clear is not None:
        chunks.append((b'tRNS', b'\xff' * clear + b'\0'))
    chunks += [(b'IDAT', zlib.compress(rows.tobytes(), 7)), (b'IEND', b'')]
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(data)) + kind + data + struct.pack('>I', zlib.crc32(kind + data))
        for kind, data in chunks)


def png(rgba: NDArray[np.uint8]) -> bytes:
    """Return an image, (H, W, 4) uint8 red green blue alpha, as PNG bytes."""
    return _encoded('.png', rgba[..., [2, 1, 0, 3]], [cv2.IMWRITE_PNG_COMPRESSION, 7])


def jpeg(rgb: NDArray[np.uint8], quality: int = 72) -> bytes:
    """Return an image, (H, W, 3) uint8 red green blue, as JPEG bytes."""
    return _encoded('.jpg', rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


def data_uri(kind: str, content: bytes) -> str:
    """Return *content* as a data URI of the media type *kind*."""
    return f'data:{kind};base64,{base64.b64encode(content).decode()}'


def _encoded(ending: str, image: NDArray[np.uint8], options: list[int]) -> bytes:
    return cv2.imencode(ending, np.ascontiguousarray(image), options)[1].tobytes()
