"""The frames of an evaluation: as recorded, with other predictions, or disturbed on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.convert.files import files_of
from persem_ros.convert.images import nearest as nearest_pixels, read_labels
from persem_ros.convert.stamps import stamp_of_name, stamps_from_names
from persem_ros.core.transforms import transform
from persem_ros.errors import PersemError
from persem_ros.frames import same_aspect
from persem_ros.inputs.names import renamed
from persem_ros.settings.config import nearest

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.inputs.recording.recording import Recording

ORDERS = ('recorded', 'reversed', 'shuffled')


@dataclass(frozen=True)
class Disturbance:
    """
    What is done to the frames before they are used; their names in a sweep are disturb.*.

    Attributes
    ----------
    pose_noise : float
        White noise of the positions, standard deviation per axis, metres.
    attitude_noise : float
        White noise of the attitude, standard deviation per axis, degrees.
    pose_drift : float
        Random walk of the positions: standard deviation per axis after 100 frames, metres.
    depth_noise : float
        White noise of the depth, standard deviation as a share of the depth.
    order : str
        Of integration: recorded, reversed or shuffled. Frames are always measured as recorded.
    seed : int
        Of all noise.

    """

    pose_noise: float = 0.0
    attitude_noise: float = 0.0
    pose_drift: float = 0.0
    depth_noise: float = 0.0
    order: str = 'recorded'
    seed: int = 0

    def with_value(self, name: str, value: object) -> Disturbance:
        """
        Return this with one value replaced.

        Raises
        ------
        PersemError
            For an unknown name or a value that does not fit.

        """
        known = [f'disturb.{field.name}' for field in fields(self)]
        if f'disturb.{name}' not in known:
            raise PersemError(f"unknown setting 'disturb.{name}'"
                              f'{nearest("disturb." + name, known)}; expected one of '
                              f'{", ".join(known)}')
        if name == 'order':
            if value not in ORDERS:
                raise PersemError(f'disturb.order: expected one of {", ".join(ORDERS)}, got '
                                  f'{value!r}')
        elif isinstance(value, bool) or not isinstance(value, (int, float)) or \
                not 0 <= value < float('inf') or name == 'seed' and value != int(value):
            raise PersemError(f'disturb.{name}: expected a number from 0 on, got {value!r}')
        changed: dict[str, Any] = {name: value}
        return replace(self, **changed)


class Stream:
    """
    A recording's frames, the same in every reading.

    Parameters
    ----------
    recording : persem_ros.inputs.recording.recording.Recording
    predictions : str
        Folder of label images that take the place of the recorded ones; '': none.
    disturbance : Disturbance
    new : ndarray, shape (65536,), int32, optional
        The id of a frame for each of the recording's, and of the predictions', -1 for none.

    Attributes
    ----------
    unpredicted : int
        Frames of the last reading that were left out for want of a prediction.

    """

    def __init__(self, recording: Recording, predictions: str = '',
                 disturbance: Disturbance = Disturbance(),
                 new: NDArray[np.int32] | None = None) -> None:
        self.recording, self.disturbance, self._new = recording, disturbance, new
        self.predictions = prediction_files(predictions) if predictions else None
        self.unpredicted = 0

    def frames(self, **wanted: Any) -> Iterator[Frame]:
        """Yield the frames in stamp order; parameters as of Recording.frames."""
        d = self.disturbance
        walk = np.zeros(3)
        self.unpredicted = 0
        for number, frame in enumerate(self.recording.frames(**wanted)):
            rng = np.random.default_rng((int(d.seed), number))
            if d.pose_drift:
                walk = walk + rng.normal(0.0, d.pose_drift / 10, 3)     # 100 steps: 10 times
            frame = disturbed(frame, d, rng, walk)
            if self.predictions is not None:
                path = self.predictions.get(frame.stamp)
                if path is None:
                    self.unpredicted += 1
                    continue
                frame = predicted(frame, path)
            if self._new is not None:
                frame = replace(frame, labels=renamed(frame.labels, self._new), truth=None
                                if frame.truth is None else renamed(frame.truth, self._new))
            yield frame


def prediction_files(folder: str) -> dict[int, Path]:
    """
    Return {stamp: path} of a folder of label images.

    Raises
    ------
    PersemError
        When there are none, or their names are not stamps.

    """
    files = files_of(Path(folder), '*')
    stamps = stamps_from_names(files)
    if not files or stamps is None:
        found = f'found {next(k for k in files if stamp_of_name(k) is None)!r}' if files \
            else 'found no file'
        raise PersemError(f'--predictions {folder}: expected label images that are named by the '
                          'stamps of the recorded ones, as 1658137057.641204937.png (s) or '
                          f'1658137057641204937.png (ns); {found}')
    return {stamps[key]: path for key, path in files.items()}


def predicted(frame: Frame, path: Path) -> Frame:
    """Return a frame with the labels of a file, on the grid of its own; refuse another shape."""
    labels = read_labels(path)[0]
    shape = frame.labels.shape
    if not same_aspect(labels.shape[::-1], shape[::-1]):
        raise PersemError(f'{path}: {labels.shape[1]}x{labels.shape[0]}, but the recorded label '
                          f'images are {shape[1]}x{shape[0]}; expected one aspect ratio')
    return replace(frame, labels=nearest_pixels(labels, shape[::-1]).astype(np.int32))


def disturbed(frame: Frame, disturbance: Disturbance, rng: np.random.Generator,
              walk: NDArray[np.float64]) -> Frame:
    """Return a frame with noise of *rng* and the drift *walk*, shape (3,), metres."""
    d, T, depth = disturbance, frame.T_map_camera, frame.depth
    if d.pose_noise or d.attitude_noise or d.pose_drift:
        angles = np.radians(rng.normal(0.0, d.attitude_noise, 3)) / 2
        turn = transform(np.zeros(3), [*angles, np.sqrt(max(0.0, float(1 - angles @ angles)))])
        T = np.array(T)
        T[:3, :3] = T[:3, :3] @ turn[:3, :3]
        T[:3, 3] += rng.normal(0.0, d.pose_noise, 3) + walk
    if d.depth_noise:
        depth = depth * (1 + rng.normal(0.0, d.depth_noise, depth.shape))
    same = T is frame.T_map_camera and depth is frame.depth
    return frame if same else replace(frame, T_map_camera=T, depth=depth)
