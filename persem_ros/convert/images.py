"""Label, depth and colour files as arrays, checked; resizing that keeps pixel centres."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.guard.limits import BYTES_A_PIXEL, max_bytes, max_pixels, too_many_pixels
from persem_ros.guard.pictures import check_parts, JPEG, pixels_of_file

PNG = b'\x89PNG\r\n\x1a\n'
UNITS = {'m': 1.0, 'cm': 100.0, 'mm': 1000.0}
LABEL_ENCODINGS = {'u1': 'mono8', 'u2': 'mono16', 'i2': '16SC1', 'i4': '32SC1'}


def read_array(path: Path) -> NDArray[Any]:
    """
    Return an image file or a .npy file as it is stored.

    Raises
    ------
    PersemError
        When it is missing, damaged or empty.

    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PersemError(f'{path}: cannot be read: {error.strerror}') from error
    try:
        if path.suffix == '.npy':
            array = read_npy(path)
        elif _is_broken_png(data):      # the decoder would say so on standard error, too
            array = None
        else:
            _check_size(memoryview(data), path)
            array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, ValueError, EOFError):
        array = None
    if array is None or array.size == 0:
        raise PersemError(f'{path}: not an image that can be decoded ({len(data)} bytes)')
    return np.squeeze(array, 2) if array.ndim == 3 and array.shape[2] == 1 else array


def read_npy(path: Path) -> NDArray[Any]:
    """
    Return the array of a .npy file that has room for it.

    Raises
    ------
    ValueError, EOFError
        Where that is not what it is.
    PersemError
        For an array that is larger than --max-pixels allows.

    """
    with open(path, 'rb') as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else \
            np.lib.format.read_array_header_2_0
        try:
            shape, _, dtype = read(file)
        except Exception as error:      # its header is Python, taken apart by Python's tokenizer
            raise ValueError(str(error)) from None
        size = dtype.itemsize * math.prod(shape)
        if size > max_bytes():
            raise PersemError(
                f'{path}: an array of {" x ".join(map(str, shape))} values is larger than '
                f'--max-pixels allows ({BYTES_A_PIXEL} bytes for each of {max_pixels()}); if it '
                f'is meant to be, --max-pixels {-(-size // BYTES_A_PIXEL)}')
        if size > path.stat().st_size - file.tell():
            raise EOFError('fewer values than its shape says')
    return np.load(path, allow_pickle=False)


def _check_size(data: memoryview, path: Path) -> None:
    """Refuse (PersemError) an image of another kind, or one that unpacks to too much."""
    if not len(data):
        raise EOFError('an empty file')
    try:
        width, height = pixels_of_file(data)
        if data[:8] == PNG or data[:2] == JPEG:
            check_parts(data)
    except ValueError as error:
        raise PersemError(f'{path}: not an image that can be decoded: '
                          f'{error.args[-1]}') from None
    if too_many_pixels(width, height):
        raise PersemError(
            f'{path}: an image of {width} x {height} pixels is larger than --max-pixels allows '
            f'({max_pixels()}); if it is meant to be, --max-pixels {width * height}')


def _is_broken_png(data: bytes) -> bool:
    """Whether bytes that begin like a PNG end early or have a wrong checksum."""
    if not data.startswith(PNG):
        return False
    begin = len(PNG)
    while begin + 12 <= len(data):
        end = begin + 8 + int.from_bytes(data[begin:begin + 4], 'big')
        if zlib.crc32(data[begin + 4:end]) != int.from_bytes(data[end:end + 4], 'big'):
            return True
        if data[begin + 4:begin + 8] == b'IEND':
            return False
        begin = end + 4
    return True


def read_labels(path: Path) -> tuple[NDArray[np.integer[Any]], str]:
    """
    Return (ids, encoding) of a label file.

    Returns
    -------
    ndarray, shape (H, W), uint8, uint16, int16 or int32
        As stored; 64-bit ids of .npy files become int32.
    str
        The image encoding that carries them.

    """
    array = read_array(path)
    if array.ndim != 2:
        hint = '; a palette PNG decodes to colours, save its indices instead' \
            if Path(path).suffix == '.png' else ''
        raise PersemError(f'{path}: expected one channel of class ids, got shape {array.shape}'
                          f'{hint}')
    if array.dtype.kind in 'iu' and array.dtype.itemsize > 2 and array.dtype != np.int32:
        if array.max() > 2**31 - 1 or array.min() < -2**31:
            raise PersemError(f'{path}: ids do not fit into 32 bits')
        array = array.astype(np.int32)
    code = array.dtype.str[1:]
    if code not in LABEL_ENCODINGS:
        raise PersemError(f'{path}: expected integer class ids, got {array.dtype.name}')
    return array, LABEL_ENCODINGS[code]


def read_depth(
        path: Path, per_metre: float | None = None, invalid: tuple[int, ...] = (0, 65535)
) -> tuple[NDArray[Any], str]:
    """
    Return (depth, encoding): 16UC1 in millimetres where the file is, else 32FC1 in metres.

    Parameters
    ----------
    path : Path
        16-bit PNG or TIFF, floating-point TIFF or .npy.
    per_metre : float, optional
        Stored units per metre. Without it integers are millimetres, floats metres.
    invalid : tuple of int
        Stored integers that mean "no measurement"; they become 0.

    Returns
    -------
    ndarray, shape (H, W), uint16 or float32
        0 (and in floats NaN) is no measurement.
    str
        16UC1 or 32FC1.

    """
    array = read_array(path)
    kind, size = array.dtype.kind, array.dtype.itemsize
    if array.ndim != 2 or kind not in 'iuf' or (kind != 'f' and size < 2):
        raise PersemError(f'{path}: expected one channel of 16-bit or floating-point depth, got '
                          f'{array.dtype.name} of shape {array.shape}')
    if kind == 'f':
        return (array / (per_metre or 1.0)).astype(np.float32), '32FC1'
    bad = np.isin(array, invalid) | (array < 0)
    if array.dtype == np.uint16 and per_metre in (None, 1000.0):
        return np.where(bad, np.uint16(0), array), '16UC1'
    return np.where(bad, 0, array / (per_metre or 1000.0)).astype(np.float32), '32FC1'


def units_per_metre(path: Path, per_metre: float | None = None) -> float:
    """Return the stored units per metre that read_depth() takes a file to have."""
    return per_metre or (1.0 if read_array(path).dtype.kind == 'f' else UNITS['mm'])


def metres(depth: NDArray[Any], encoding: str) -> NDArray[np.float64]:
    """Return depth as metres, 0 where there is no measurement."""
    depth = depth / 1000.0 if encoding == '16UC1' else depth.astype(np.float64)
    return np.where(np.isfinite(depth), depth, 0.0)


def parse_unit(text: str | None) -> float | None:
    """
    Return stored units per metre: of m, cm, mm, or the number itself (5000 for TUM).

    Raises
    ------
    PersemError
        For anything else.

    """
    if text is None:
        return None
    if text in UNITS:
        return UNITS[text]
    try:
        value = float(text)
    except ValueError:
        value = float('nan')
    if not 0 < value < float('inf'):
        raise PersemError(f'depth unit {text!r}: expected m, cm, mm or the number of units that '
                          'make a metre')
    return value


def read_color(path: Path, size: tuple[int, int] | None = None) -> tuple[NDArray[np.uint8], str]:
    """Return (array, encoding) of a colour file: (H, W, 3), bgr8; *size* is (w, h)."""
    array = read_array(path)
    if array.dtype != np.uint8 or (array.ndim == 3 and array.shape[2] not in (3, 4)):
        raise PersemError(f'{path}: expected an 8-bit colour image, got {array.dtype.name} of '
                          f'shape {array.shape}')
    if array.ndim == 2:
        array = np.asarray(cv2.cvtColor(array, cv2.COLOR_GRAY2BGR))
    array = array[..., :3]
    if size is not None and (array.shape[1], array.shape[0]) != tuple(size):
        array = np.asarray(cv2.resize(array, size, interpolation=cv2.INTER_AREA))
    return array, 'bgr8'


def nearest(array: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """
    Resize without mixing values.

    Parameters
    ----------
    array : ndarray, shape (H, W)
        Any type.
    size : tuple of int
        New (width, height).

    Returns
    -------
    ndarray, shape (height, width)
        The pixel whose area holds the new pixel's centre.

    """
    width, height = size
    if array.shape == (height, width):
        return array
    # In integers: floor((i + 0.5) * old / new).
    rows = (2 * np.arange(height) + 1) * array.shape[0] // (2 * height)
    columns = (2 * np.arange(width) + 1) * array.shape[1] // (2 * width)
    return array[rows[:, None], columns]


def scaled_K(
        K: NDArray[np.float64], old: tuple[int, int], new: tuple[int, int]) -> NDArray[np.float64]:
    """
    Return the pinhole matrix (3, 3) for an image resized from *old* to *new* (width, height).

    Pixel centres are at integers: f' = s f, c' = s (c + 0.5) - 0.5.

    """
    K = np.array(K, float)
    for axis in (0, 1):
        scale = new[axis] / old[axis]
        K[axis, 2] = scale * (K[axis, 2] + 0.5) - 0.5
        K[axis, :2] *= scale
    return K
