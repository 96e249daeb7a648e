"""What every converter writes: frames and poses, on the topics that a replay reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
import logging
from typing import Any, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.images import metres
from persem_ros.errors import PersemError
from persem_ros.settings.config import Topics
from tqdm import tqdm

if TYPE_CHECKING:
    from persem_ros.outputs.recording.writer import RecordingWriter
    from persem_ros.settings.legend import Legend

LOG = logging.getLogger(__name__)
MAP, CAMERA = 'map', 'camera'
KEPT = 500      # depths a frame, for the median

Item = TypeVar('Item')      # whatever a converter calls a frame
Posed = tuple[int, NDArray[np.float64]]     # stamp, T_map_camera (4, 4)


class SceneWriter:
    """
    Writes a data set's frames to a RecordingWriter, on the default topics.

    Parameters
    ----------
    out : RecordingWriter
        The open recording.
    legend : Legend, optional
        Goes to /semantic/legend, latched.
    trajectory : iterable of Posed
        In order of stamps; written among the images, so that a recording
        that breaks off has the poses of what it has.

    Attributes
    ----------
    counts : Counter
        Messages written, by what they are: labels, depth, poses, ….
    depth_size : tuple of int
        (width, height) of the last depth image, None before the first.

    """

    def __init__(self, out: RecordingWriter, legend: Legend | None = None,
                 trajectory: Iterable[Posed] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self.depth_size: tuple[int, int] | None = None
        self._out, self._topics = out, Topics()
        self._stamps: list[int] = []
        self._range = np.inf, -np.inf
        self._kept: list[NDArray[np.float32]] = []
        self._trajectory = iter(trajectory)
        self._next = next(self._trajectory, None)
        if legend is not None:
            out.text('semantic/legend', legend.to_yaml(), latched=True)

    def labels(self, stamp: int, array: NDArray[np.integer[Any]], encoding: str) -> None:
        """Write a label image."""
        self._image('labels', self._topics.labels, stamp, array, encoding)

    def truth(self, stamp: int, array: NDArray[np.integer[Any]], encoding: str) -> None:
        """Write an image of true ids."""
        self._image('truth', self._topics.truth, stamp, array, encoding)

    def color(self, stamp: int, array: NDArray[np.uint8], encoding: str) -> None:
        """Write a colour image."""
        self._image('color', self._topics.color, stamp, array, encoding)

    def depth(self, stamp: int, array: NDArray[Any], encoding: str, K: NDArray[np.float64],
              D: NDArray[np.float64] | Sequence[float] = (), model: str = 'plumb_bob') -> None:
        """Write a depth image and the camera info of its size."""
        height, width = array.shape
        self.depth_size = width, height
        self._out.camera_info(self._topics.camera_info, stamp, CAMERA, width, height, K, D, model)
        self._image('depth', self._topics.depth, stamp, array, encoding)
        depth = metres(array, encoding)
        depth = depth[depth > 0]
        if depth.size:
            self._range = (min(self._range[0], depth.min()), max(self._range[1], depth.max()))
            self._kept.append(depth[::-(-depth.size // KEPT)].astype(np.float32))

    def finish(self) -> str:
        """Write the poses that are left; return one line on what was written."""
        while self._next is not None:
            self._pose(*self._next)
        counts = ', '.join(f'{n} {what}' for what, n in self.counts.items())
        seconds = (max(self._stamps) - min(self._stamps)) / 1e9
        return (f'{counts}; {seconds:.3f} s from stamp {min(self._stamps) / 1e9:.3f}; '
                f'{self._depth_range()}')

    def _depth_range(self) -> str:
        """Return what the depth was, which shows a wrong unit at a glance."""
        if not self._kept:
            return 'no depth was measured'
        low, high, middle = (
            np.format_float_positional(value, 2, fractional=False, trim='-')
            for value in (*self._range, np.median(np.concatenate(self._kept))))
        return f'depth {low} to {high} m, median {middle} m'

    def _image(
            self, what: str, topic: str, stamp: int, array: NDArray[Any], encoding: str) -> None:
        while self._next is not None and self._next[0] <= stamp:
            self._pose(*self._next)
        self._out.image(topic, stamp, CAMERA, array, encoding)
        self.counts[what] += 1
        self._stamps.append(stamp)

    def _pose(self, stamp: int, T: NDArray[np.float64]) -> None:
        """Write the next pose as a PoseStamped and to /tf, and go on to the one after."""
        self._out.pose(self._topics.pose, stamp, MAP, T)
        self._out.tf(stamp, MAP, CAMERA, T)
        self.counts['poses'] += 1
        self._next = next(self._trajectory, None)


def write_scene(writer: RecordingWriter, legend: Legend | None, trajectory: Iterable[Posed],
                items: list[Item], write: Callable[[SceneWriter, Item], None]) -> str:
    """
    Write a whole recording.

    Parameters
    ----------
    writer : RecordingWriter
        Not yet open.
    legend, trajectory
        Of SceneWriter.
    items : list
        The frames.
    write : function
        Writes the images of one.

    Returns
    -------
    str
        One line that says what was written.

    """
    with writer as out:
        scene = SceneWriter(out, legend, trajectory)
        for item in tqdm(items, unit='frame', disable=None):
            write(scene, item)
        return scene.finish()


def check_scale(scale: float) -> None:
    """Refuse a factor on the images' size that enlarges them, or leaves nothing."""
    if not 0 < scale <= 1:
        raise PersemError(f'--scale {scale:g}: expected more than 0 and at most 1')


def report_dropped(dropped: dict[str, list[str]]) -> None:
    """
    Warn about frames that were left out.

    Parameters
    ----------
    dropped : dict
        The reason, and the frames.

    """
    for reason, names in dropped.items():
        if names:
            LOG.warning('%d frames left out: %s (%s%s)', len(names), reason, ', '.join(names[:5]),
                        ', …' if len(names) > 5 else '')


def chosen(items: list[Item], frames: str | None = None, every: int = 1) -> list[Item]:
    """
    Return the part of a list that --frames A:B and --every N mean.

    Raises
    ------
    PersemError
        When the text is not A:B, or nothing is left.

    """
    begin, end = None, None
    if frames:
        words = frames.split(':')
        try:
            if len(words) != 2:
                raise ValueError
            begin, end = (int(word) if word.strip() else None for word in words)
        except ValueError:
            raise PersemError(f'--frames {frames}: expected A:B, first frame and the one after '
                              'the last, for example 100:200') from None
    if every < 1:
        raise PersemError(f'--every {every}: expected 1 or more')
    left = items[begin:end:every]
    if not left:
        raise PersemError(f'--frames {frames}: no frame is left of {len(items)}')
    return left
