"""Image messages to arrays: ids, colours, depth, confidences; raw and compressed."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
import math
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.inputs.decode import compressed
from persem_ros.inputs.decode.messages import BadMessage

LABELS = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '16SC1': 'i2',
          '32SC1': 'i4'}
DEPTH = {'16UC1': 'u2', 'mono16': 'u2', '32FC1': 'f4', '64FC1': 'f8'}
MILLIMETRE = 0.001          # unit of integer depth, REP-118
CONFIDENCE = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2', '32FC1': 'f4'}
# Where red, green, blue (and alpha) are in a pixel; cv_bridge calls OpenCV's order 8UC3.
PLANES = {'rgb8': [0, 1, 2], 'bgr8': [2, 1, 0], '8UC3': [2, 1, 0], 'rgba8': [0, 1, 2, 3],
          'bgra8': [2, 1, 0, 3], '8UC4': [2, 1, 0, 3]}
# Channels, and how OpenCV makes RGB of them: forty times as fast as choosing planes in NumPy.
COLOR = {'rgb8': (3, None), 'bgr8': (3, cv2.COLOR_BGR2RGB), '8UC3': (3, cv2.COLOR_BGR2RGB),
         'rgba8': (4, cv2.COLOR_RGBA2RGB), 'bgra8': (4, cv2.COLOR_BGRA2RGB),
         '8UC4': (4, cv2.COLOR_BGRA2RGB), 'mono8': (1, cv2.COLOR_GRAY2RGB),
         '8UC1': (1, cv2.COLOR_GRAY2RGB)}
Found = TypeVar('Found')


def labels(msg: Any) -> tuple[NDArray[np.int32], str]:
    """
    Read a label image whose pixels are ids.

    Parameters
    ----------
    msg : sensor_msgs/Image or CompressedImage (PNG)
        Ids, never colours.

    Returns
    -------
    ndarray, shape (H, W), int32
        The ids as they are: negative ones and those above 65534 included.
    str
        The encoding, one of `LABELS`.

    Raises
    ------
    BadMessage
        Unknown encoding, zero size, short data, damaged PNG.

    """
    planes, encoding = label_planes(msg)
    if planes.ndim == 3:
        raise BadMessage('colours instead of ids', f'a label image has {planes.shape[2]} channels '
                         f'({encoding}), expected one of ids')
    return planes.astype(np.int32), encoding


def label_planes(msg: Any, lossy: bool = False) -> tuple[NDArray[Any], str]:
    """
    Read a label image of ids or of colours.

    Parameters
    ----------
    msg : sensor_msgs/Image or CompressedImage
        Of rclpy or of rosbags.
    lossy : bool
        Whether JPEG will do, as it may for colours.

    Returns
    -------
    ndarray, shape (H, W) or (H, W, 3 or 4)
        Ids in their own type, or red, green, blue (and alpha), uint8.
    str
        The encoding.

    Raises
    ------
    BadMessage
        As of labels().

    """
    if hasattr(msg, 'format'):
        array, encoding = _decoded(partial(compressed.labels, lossy=lossy), msg)
        if array.ndim == 3:
            order = [2, 1, 0, 3][:array.shape[2]]       # as OpenCV decodes
            return array[..., order], encoding or 'png'
        if encoding not in LABELS:
            encoding = {1: 'mono8', 2: 'mono16'}[array.itemsize]
        return array, encoding
    if msg.encoding in PLANES:
        order = PLANES[msg.encoding]
        rows = _rows(msg, msg.width * len(order))
        return rows.reshape(msg.height, msg.width, len(order))[..., order], msg.encoding
    return _plane(msg, LABELS, 'a label image'), msg.encoding


def confidence(msg: Any) -> NDArray[np.uint32]:
    """
    Read a confidence image of the segmenter.

    Returns
    -------
    ndarray, shape (H, W), uint32
        w in units of 2 ** -16, 0 .. 65536; 0 where it was NaN (spec section 11).

    """
    array = _plane(msg, CONFIDENCE, 'a confidence image')
    if array.dtype.kind == 'u':
        w = array / float(np.iinfo(array.dtype).max)
    else:
        w = np.clip(np.nan_to_num(array.astype(np.float64), nan=0.0), 0.0, 1.0)
    return np.rint(w * 65536.0).astype(np.uint32)


def depth_confidence(msg: Any) -> NDArray[np.float64]:
    """Read a confidence image of the depth, float64 (H, W), in the camera's own numbers."""
    if hasattr(msg, 'format'):
        array, _ = _decoded(compressed.labels, msg)
        if array.ndim == 2:
            return array.astype(np.float64)
        raise BadMessage('several channels', f'a depth confidence image has {array.shape[2]} '
                         'channels, expected one')
    return _plane(msg, {**CONFIDENCE, '64FC1': 'f8'},
                  'a depth confidence image').astype(np.float64)


def depth(msg: Any, scale: float = 0.0) -> NDArray[np.float64]:
    """
    Read a depth image.

    Parameters
    ----------
    msg : sensor_msgs/Image or CompressedImage (compressedDepth PNG or RVL)
        16UC1 and mono16 hold millimetres, 32FC1 and 64FC1 metres.
    scale : float
        Metres per unit, where it is another one than that of the encoding; 0: by encoding.

    Returns
    -------
    ndarray, shape (H, W), float64
        Metres; 0, NaN and infinity are "no measurement".

    Raises
    ------
    BadMessage
        Unknown encoding, zero size, short data, damaged compression.

    """
    array = _depth_plane(msg)
    scale = unit_of(array.dtype, scale)
    # Divided, because units per metre are whole numbers, and metres per unit are rounded ones.
    return array.astype(np.float64) if scale == 1.0 else \
        np.true_divide(array, 1.0 / scale, dtype=np.float64)


def disparity(msg: Any, product: float = 0.0) -> NDArray[np.float64]:
    """
    Read a disparity image as depth.

    Parameters
    ----------
    msg : stereo_msgs/DisparityImage, or an Image of `DEPTH`
        Disparities in pixels of the rectified left image; the first says what *product* is.
    product : float
        Focal length (pixels) x baseline (metres) of the second, per unit of its numbers.

    Returns
    -------
    ndarray, shape (H, W), float64
        Metres along the optical axis; NaN without a disparity.

    """
    least = 0.0
    if is_disparity(msg):
        product, least, msg = float(msg.f) * float(msg.t), float(msg.min_disparity), msg.image
        if not product > 0.0 or not math.isfinite(product):
            raise BadMessage('no baseline', f'a disparity image has f x T = {product:g}, expected '
                             'focal length x baseline')
    values = _depth_plane(msg).astype(np.float64)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where((values > 0.0) & (values >= least), product / values, np.nan)


def is_disparity(msg: Any) -> bool:
    """Return whether a message is a stereo_msgs/DisparityImage."""
    return hasattr(msg, 'min_disparity')


def unit_of(dtype: np.dtype[Any], scale: float = 0.0) -> float:
    """Return the metres per unit of depth pixels of a *dtype*; *scale* as in depth()."""
    return scale or (MILLIMETRE if dtype.kind == 'u' else 1.0)


def color(msg: Any) -> NDArray[np.uint8]:
    """Read a colour image, raw or compressed, as uint8 RGB of shape (H, W, 3)."""
    if hasattr(msg, 'format'):
        return _decoded(compressed.color, msg)
    if msg.encoding not in COLOR:
        raise _unknown(msg.encoding, COLOR, 'a colour image')
    channels, conversion = COLOR[msg.encoding]
    pixels = _rows(msg, msg.width * channels).reshape(msg.height, msg.width, channels)
    return pixels.copy() if conversion is None else \
        np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def _depth_plane(msg: Any) -> NDArray[Any]:
    """Return the numbers of a depth image (H, W) in their own type."""
    if hasattr(msg, 'format'):
        return _decoded(compressed.depth, msg)
    return _plane(msg, DEPTH, 'a depth image')


def _plane(msg: Any, encodings: dict[str, str], what: str) -> NDArray[Any]:
    """Return the (H, W) view of a single-channel Image in its own dtype."""
    if msg.encoding not in encodings:
        raise _unknown(msg.encoding, encodings, what)
    dtype = np.dtype(encodings[msg.encoding])
    rows = _rows(msg, msg.width * dtype.itemsize)
    return rows.view(dtype.newbyteorder('>' if msg.is_bigendian else '<'))


def _rows(msg: Any, row_bytes: int) -> NDArray[np.uint8]:
    """Return the (H, row_bytes) uint8 view of an Image, row padding left out."""
    height, step = msg.height, msg.step
    if not (height and row_bytes):
        raise BadMessage('zero size', f'an image has the size {msg.width} x {height}')
    try:
        compressed.check_pixels(msg.width, height)
    except ValueError as error:
        raise BadMessage(*error.args) from None
    if step < row_bytes:
        raise BadMessage('row shorter than width', f'an image of width {msg.width} and encoding '
                         f'{msg.encoding} has a step of {step} bytes, expected {row_bytes}')
    data = np.frombuffer(msg.data, np.uint8)
    if data.size < height * step:
        raise BadMessage('data too short', f'an image has {data.size} bytes of data, expected '
                         f'height x step = {height} x {step} = {height * step}')
    return data[:height * step].reshape(height, step)[:, :row_bytes]


def _unknown(encoding: str, known: Collection[str], what: str) -> BadMessage:
    known = known if known is not LABELS else [*LABELS, *PLANES]
    return BadMessage(f'encoding {encoding!r}', f'{what} has the encoding {encoding!r}, '
                      f'expected one of {", ".join(known)}')


def _decoded(decoder: Callable[[str, NDArray[np.uint8]], Found], msg: Any) -> Found:
    """Run a decoder of compressed.py, which knows nothing of messages."""
    try:
        return decoder(msg.format, np.frombuffer(msg.data, np.uint8))
    except ValueError as error:
        raise BadMessage(*error.args) from None
