"""Messages of one instant to a Frame; the last step of the way in, live and in a replay."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Camera, Cloud, Frame, Matching, same_aspect
from persem_ros.inputs import fit
from persem_ros.inputs.decode import clouds, image_messages, messages
from persem_ros.inputs.decode.labels import LabelReader
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.names import renamed
from persem_ros.inputs.registration import depth_of_cloud, registered
from persem_ros.inputs.sync.match import COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS, TRUTH
from persem_ros.inputs.views import CAMERAS_KEPT, Views
from persem_ros.settings.config import Config, frame_of
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from persem_ros.inputs.sync.match import Match
    from persem_ros.inputs.views import View

OTHER_CAMERA = 'labels of another camera'
NamesAt = Callable[[int, int], tuple[Legend, NDArray[np.int32] | None]]
Ids = tuple[NDArray[np.int32], str]     # and their encoding
Found = TypeVar('Found')
Scalar = TypeVar('Scalar', bound=np.generic)


class Assembler:
    """
    Makes the frames of one camera.

    Parameters
    ----------
    config : persem_ros.settings.config.Config, optional
        The settings camera.*, depth.*, labels.* and points.*.
    sensor : str
        The camera's name, '' where there is only one.
    names_at : callable
        names_at(stamp, tables) gives what Names.at() does: what ids mean.

    Attributes
    ----------
    given : str
        The frame that the settings say its images are in, '' for none.

    """

    def __init__(self, config: Config | None = None, sensor: str = '',
                 names_at: NamesAt = lambda stamp, tables: (Legend(), None)) -> None:
        """Start without a camera info."""
        config = config or Config()
        self._views, self._label_views = (Views(config.camera.rectified) for _ in range(2))
        self._depth, self._points, self._fit = config.depth, config.points, config.labels.fit
        self._sensor = sensor
        self.given = frame_of(config, sensor)
        self._matchings: dict[tuple[tuple[int, int], tuple[int, int]], Matching | None] = {}
        self._names_at = names_at
        self.reader, self._truth_reader = LabelReader(config.labels), LabelReader(config.labels)

    @property
    def frame_id(self) -> str | None:
        """Return the frame of the first camera info, None before it has come."""
        return self._views.frame_id

    @property
    def frame_setting(self) -> str:
        """Return the name of the setting that says which frame its images are in."""
        return f'cameras.{self._sensor}.frame' if self._sensor else 'camera.frame'

    @property
    def knows_labels(self) -> bool:
        """Return whether a camera info of the labels' own camera has come."""
        return self._label_views.frame_id is not None

    def add_info(self, info: Any) -> None:
        """Use *info* for images from its stamp on; refuse (BadMessage) an unusable one."""
        self._views.add(info)

    def add_labels_info(self, info: Any) -> None:
        """Use *info*, of the labels' own camera, in the same way."""
        self._label_views.add(info)

    def depth(self, msg: Any) -> NDArray[np.float64]:
        """Return the depth image of a message in metres (H, W), by depth.scale and kind."""
        if image_messages.is_disparity(msg) or self._depth.kind == 'disparity':
            return image_messages.disparity(msg, self._depth.scale)
        return image_messages.depth(msg, self._depth.scale)

    def frame(self, match: Match, decoded: dict[str, Any]) -> tuple[Frame, list[BadMessage]]:
        """
        Return the Frame of a match.

        Parameters
        ----------
        match : Match
            With its pose.
        decoded : dict of str to message
            The messages of the match by kind.

        Returns
        -------
        Frame
            With the companions that could be read.
        list of BadMessage
            What was wrong with the others.

        Raises
        ------
        BadMessage
            Where labels, depth or camera info cannot be used.

        """
        label_msg = decoded[LABELS]
        legend, new = self._names_at(match.stamp, getattr(match.items.get(LABELS), 'tables', 0))

        def ids(msg: Any, reader: LabelReader = self.reader) -> Ids:
            found, encoding = reader(msg, legend)
            return renamed(found, new), encoding

        if is_cloud(label_msg):
            return _named(LABELS, lambda msg: self._cloud(match, msg, new), label_msg), []
        labels, encoding = _named(LABELS, ids, label_msg)
        depth, camera, matching = self._placed(match, decoded, labels.shape)
        companions: dict[str, NDArray[Any]] = {}
        faults: list[BadMessage] = []
        truth_of = partial(ids, reader=self._truth_reader)
        readers: dict[str, Callable[[Any], NDArray[Any]]] = {
            TRUTH: _truth_like(labels, truth_of), COLOR: image_messages.color}
        for kind, read in readers.items():
            if kind in decoded:
                try:
                    companions[kind] = _named(kind, read, decoded[kind])
                except BadMessage as fault:
                    faults.append(fault)
        return Frame(match.stamp, labels, depth, camera, _pose_of(match), self._sensor,
                     messages.frame_id(label_msg), _wide(encoding, new), matching=matching,
                     weights=_weights(labels, decoded.get(CONFIDENCE)),
                     truth=companions.get(TRUTH), color=companions.get(COLOR),
                     T_body_camera=match.T_body_camera), faults

    def _placed(self, match: Match, decoded: dict[str, Any], shape: tuple[int, int]
                ) -> tuple[NDArray[np.float64], Camera, Matching | None]:
        """Return depth image, camera and Matching for labels of a *shape* (H, W)."""
        label_msg, depth_msg, T = decoded[LABELS], decoded[DEPTH], match.T_labels_depth
        if is_cloud(depth_msg):
            view = self._views.of(label_msg, *shape[::-1])
            points = _named(DEPTH, lambda msg: clouds.positions(clouds.structured(msg)), depth_msg)
            return depth_of_cloud(points.reshape(-1, 3), view, np.eye(4) if T is None else T,
                                  self._points.splat), view.camera, None
        depth = _named(DEPTH, self.depth, depth_msg)
        matching = self._matching(shape, depth.shape) if T is None else None
        camera = self._seen(depth_msg, depth)
        self._distrust(depth, decoded.get(DEPTH_CONFIDENCE))
        if T is not None:
            matching = registered(depth, self._views.of(depth_msg, *depth.shape[::-1]),
                                  self._label_view(label_msg, depth_msg, T, shape), T)
        return depth, camera, matching

    def _label_view(self, label_msg: Any, depth_msg: Any, T: NDArray[np.float64],
                    shape: tuple[int, int]) -> View:
        """Return the View of labels of another camera than the depth's."""
        if self._label_views.frame_id is None:
            frames = messages.frame_id(label_msg), messages.frame_id(depth_msg)
            raise BadMessage(OTHER_CAMERA, other_camera_sentence(*frames, T))
        return self._label_views.of(label_msg, *shape[::-1])

    def _cloud(self, match: Match, msg: Any, new: NDArray[np.int32] | None) -> Frame:
        """Return the Frame of a labelled cloud."""
        cloud = clouds.structured(msg)
        points = clouds.positions(cloud)
        labels = renamed(clouds.labels(cloud, self._points.label_field), new)
        distance = np.linalg.norm(points, axis=2)
        camera = Camera(np.zeros((*labels.shape, 2)), np.eye(3), messages.frame_id(msg))
        return Frame(match.stamp, labels, distance, camera, _pose_of(match), self._sensor,
                     messages.frame_id(msg), 'mono16', points=points,
                     cloud=Cloud(cloud, self._points.label_field),
                     T_body_camera=match.T_body_camera)

    def _matching(self, labels: tuple[int, int], depth: tuple[int, int]) -> Matching | None:
        """Return how the pixels of label and depth images of two shapes belong together."""
        key = labels, depth
        if key not in self._matchings:
            if len(self._matchings) >= CAMERAS_KEPT:
                self._matchings.pop(next(iter(self._matchings)))
            self._matchings[key] = fit.matching(labels, depth, self._fit)
        return self._matchings[key]

    def _distrust(self, depth: NDArray[np.float64], msg: Any) -> None:
        """Take out of *depth* what its confidence image says is not to be trusted."""
        least = self._depth.min_confidence
        if msg is None or not least:
            return
        trust = _named(DEPTH_CONFIDENCE, image_messages.depth_confidence, msg)
        if not same_aspect(trust.shape[::-1], depth.shape[::-1]):
            raise BadMessage(f'{DEPTH_CONFIDENCE}: another shape', 'a depth confidence image has '
                             f'the size {trust.shape[1]} x {trust.shape[0]}, its depth image '
                             f'{depth.shape[1]} x {depth.shape[0]}, expected one aspect ratio')
        trust = resampled(trust, depth.shape)
        depth[~((trust if least > 0 else -trust) >= least)] = np.nan

    def seen(self, depth_msg: Any) -> tuple[NDArray[np.float64], Camera]:
        """Return depth (H, W), metres along the optical axis, and camera of a depth message."""
        depth = self.depth(depth_msg)
        return depth, self._seen(depth_msg, depth)

    def _seen(self, depth_msg: Any, depth: NDArray[np.float64]) -> Camera:
        """Return the Camera of a depth image and make what it holds depth along the axis."""
        view = self._views.of(depth_msg, *depth.shape[::-1])
        if view.blind is not None:
            depth[view.blind] = np.nan
        if self._depth.kind == 'ray':
            depth /= view.lengths
        return view.camera


def is_cloud(msg: Any) -> bool:
    """Return whether a message is a sensor_msgs/PointCloud2."""
    return hasattr(msg, 'point_step')


def other_camera_sentence(labels: str, depth: str, T_labels_depth: NDArray[np.float64]) -> str:
    """Return the sentence that says what labels in another frame than the depth need."""
    apart = np.linalg.norm(T_labels_depth[:3, 3])
    turn = np.degrees(np.arccos(np.clip((np.trace(T_labels_depth[:3, :3]) - 1) / 2, -1, 1)))
    return (f'the labels are in the frame {labels!r}, the depth is in {depth!r}, {apart:.3g} m '
            f'and {turn:.2g} degrees apart by TF: each depth pixel has to be found in the label '
            'image, for which the intrinsics of that are needed: --set topics.labels_info=TOPIC')


def resampled(labels: NDArray[Scalar], shape: tuple[int, int]) -> NDArray[Scalar]:
    """Return *labels* (H, W) on a grid of another *shape* by nearest pixel centres."""
    if labels.shape == shape:
        return labels
    rows, columns = (((np.arange(n) + 0.5) * m / n).astype(int)
                     for n, m in zip(shape, labels.shape))
    return labels[rows[:, None], columns]


def _pose_of(match: Match) -> NDArray[np.float64]:
    """Return T_map_camera of a match that has left."""
    assert match.T_map_camera is not None, 'an Intake lets no match leave without a pose'
    return match.T_map_camera


def _weights(labels: NDArray[np.int32], msg: Any) -> NDArray[np.uint32] | None:
    """Return the weights of labels (H, W) that a confidence message has, None without."""
    if msg is None:
        return None
    weights = _named(CONFIDENCE, image_messages.confidence, msg)
    if weights.shape != labels.shape:
        raise BadMessage(f'{CONFIDENCE}: another size', f'a confidence image has the size '
                         f'{weights.shape[1]} x {weights.shape[0]}, its label image '
                         f'{labels.shape[1]} x {labels.shape[0]}, expected the same')
    return weights


def _wide(encoding: str, new: NDArray[np.int32] | None) -> str:
    """Return an encoding that holds the map's ids, too: a new name may have a larger one."""
    return 'mono16' if new is not None and encoding in ('mono8', '8UC1') else encoding


def _truth_like(labels: NDArray[np.int32],
                ids: Callable[[Any], Ids]) -> Callable[[Any], NDArray[np.int32]]:
    """Return a reader of truth images on the grid of *labels*; ids(msg) reads one."""
    def read(msg: Any) -> NDArray[np.int32]:
        truth, _ = ids(msg)
        if not same_aspect(truth.shape[::-1], labels.shape[::-1]):
            raise BadMessage('shape differs from the labels', f'a truth image has the size '
                             f'{truth.shape[1]} x {truth.shape[0]}, its label image '
                             f'{labels.shape[1]} x {labels.shape[0]}')
        return resampled(truth, labels.shape)
    return read


def _named(kind: str, read: Callable[[Any], Found], msg: Any) -> Found:
    """Read a message; a fault's reason starts with the topic's *kind*."""
    try:
        return read(msg)
    except BadMessage as fault:
        raise BadMessage(f'{kind}: {fault.reason}', f'{kind}: {fault}') from None
