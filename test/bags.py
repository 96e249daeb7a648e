"""Small recordings for tests: a wall 2 m ahead, labelled in stripes, seen on a straight flight."""

from array import array
from types import SimpleNamespace

import numpy as np

from persem_ros.core.transforms import transform
from persem_ros.outputs.recording.writer import RecordingWriter

START = 1_700_000_000_000_000_000
STEP = 100_000_000          # ns between frames
WIDTH, HEIGHT = 16, 12
K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])


def stamp(i):
    """Return the stamp of frame *i*, which may be a fraction."""
    return START + round(i * STEP)


def labels(i, width=WIDTH, height=HEIGHT):
    """Return the (H, W) uint16 label image of frame *i*: stripes of ids 1 to 4, shifted by i."""
    return np.tile((np.arange(width) + i) // 4 % 4 + 1, (height, 1)).astype(np.uint16)


def depth(i, width=WIDTH, height=HEIGHT):
    """Return the (H, W) float32 depth image of frame *i*, metres: 2 plus i hundredths."""
    return np.full((height, width), 2 + i / 100, np.float32)


def pose(i):
    """Return T_map_camera of frame *i*: i tenths of a metre along x, turned by i degrees."""
    half = np.radians(i) / 2
    return transform([i / 10, 0.0, 1.0], [0.0, 0.0, np.sin(half), np.cos(half)])


def write_images(out, i, at=None):
    """Write the label image, depth image and camera info of frame *i* at the stamp *at*."""
    at = stamp(i) if at is None else at
    out.camera_info('depth/camera_info', at, 'camera', WIDTH, HEIGHT, K)
    out.image('depth/image', at, 'camera', depth(i), '32FC1')
    out.image('semantic/image', at, 'camera', labels(i), 'mono16')


def write(path, frames=5, poses=None, storage='mcap', compress=False, extra=None):
    """
    Write a recording of *frames* frames with poses half a frame before and after each.

    Parameters
    ----------
    path : Path
        The folder.
    frames : int
        Number of frames.
    poses : iterable of float, optional
        Frame numbers that get a pose.
    storage, compress
        As of the RecordingWriter.
    extra : callable, optional
        extra(out) writes more.

    """
    poses = np.arange(-1, frames + 1) + 0.5 if poses is None else poses
    events = [(float(i), i) for i in range(frames)] + [(float(i), None) for i in poses]
    with RecordingWriter(path, storage=storage, compress=compress) as out:
        for at, number in sorted(events, key=lambda event: event[0]):
            if number is None:
                out.pose('pose', stamp(at), 'map', pose(at))
            else:
                write_images(out, number)
        if extra:
            extra(out)
    return path


def live(message):
    """Return a message as rclpy hands it out: numbers in array.array, nothing of rosbags."""
    if isinstance(message, np.ndarray):
        return array(message.dtype.char, message.tobytes())
    if isinstance(message, list):
        return [live(item) for item in message]
    if hasattr(message, '__dataclass_fields__'):
        return SimpleNamespace(**{name: live(getattr(message, name))
                                  for name in message.__dataclass_fields__
                                  if not name.startswith('__')})
    return message
