"""The recording refined/: what a node would have published, as rosbag2."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.outputs.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from persem_ros.frames import Frame
    from persem_ros.outputs.results.timing import Stopwatch
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

TYPES: dict[str, type[np.integer[Any]]] = {
    'mono8': np.uint8, '8UC1': np.uint8, 'mono16': np.uint16, '16UC1': np.uint16,
    '16SC1': np.int16, '32SC1': np.int32}


class RefinedWriter:
    """
    Writes /mapper/labels, /mapper/labels_color and the latched /mapper/map.

    Parameters
    ----------
    path : Path
        The recording's folder.
    legend : persem_ros.settings.legend.Legend
    config : persem_ros.settings.config.Config
    watch : outputs.results.timing.Stopwatch
    storage : str
        As of the RecordingWriter.

    """

    def __init__(self, path: Path, legend: Legend, config: Config, watch: Stopwatch,
                 storage: str = 'mcap') -> None:
        self._out = RecordingWriter(path, storage, compress=True, force=True)
        self._legend, self._config, self._watch = legend, config, watch

    def __enter__(self) -> RefinedWriter:
        """Open the recording."""
        with ExitStack() as stack:
            stack.enter_context(self._out)
            text = self._legend.to_yaml()
            if text:
                self._out.text('/mapper/legend', text, latched=True)
            stack.pop_all()     # open now, until __exit__
        return self

    def __exit__(
            self, kind: type[BaseException] | None, value: BaseException | None,
            traceback: TracebackType | None) -> None:
        """Put the recording under its name, or remove what there is of it."""
        self._out.__exit__(kind, value, traceback)

    def frame(self, frame: Frame, labels: NDArray[np.int32]) -> None:
        """Write a frame's refined labels, int32 (H, W), in the encoding of its input."""
        with self._watch('write'):
            base = f'/mapper/{frame.sensor}' if frame.sensor else '/mapper'
            if frame.cloud is not None:
                self._out.cloud(f'{base}/points', frame.stamp, frame.frame_id,
                                frame.cloud.with_labels(labels))
                return
            image = fitted(labels, frame.encoding)
            self._out.image(f'{base}/labels', frame.stamp, frame.frame_id, image, frame.encoding)
            self._out.image(f'{base}/labels_color', frame.stamp, frame.frame_id,
                            self._legend.colors(image), 'rgb8')

    def map(self, points: NDArray[np.void], stamp: int) -> None:       # noqa: A003
        """Write the map's points, latched."""
        with self._watch('write'):
            self._out.cloud('/mapper/map', stamp, self._config.frames.map, points, latched=True)


def fitted(labels: NDArray[np.int32], encoding: str) -> NDArray[np.integer[Any]]:
    """
    Return labels in the pixel type of an image encoding.

    An id that the type cannot hold (another camera's, UNKNOWN) becomes its largest value.

    """
    pixel = TYPES[encoding]
    limit = np.iinfo(pixel).max
    # Where a negative id does not fit, it is a huge one.
    ids = labels.view(np.uint32) if np.dtype(pixel).kind == 'u' else labels
    return np.minimum(ids, limit).astype(pixel)
