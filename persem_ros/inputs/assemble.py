"""Messages of one instant to a Frame; the last step of the way in, live and in a replay."""

from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Camera, Frame, Matching, same_aspect
from persem_ros.inputs import fit
from persem_ros.inputs.decode import messages
from persem_ros.inputs.decode.camera import camera, check, content
from persem_ros.inputs.decode.labels import LabelReader
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.names import renamed
from persem_ros.inputs.sync.pairing import (
    COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS, TRUTH)
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

CAMERAS_KEPT = 8        # a zoom lens must not fill the memory
CHANGES_KEPT = 64
NamesAt = Callable[[int, int], tuple[Legend, NDArray[np.int32] | None]]


class Assembler:
    """
    Makes the frames of one camera.

    Parameters
    ----------
    config : persem_ros.settings.config.Config, optional
        The settings camera.*, depth.* and labels.*.
    sensor : str
        The camera's name, '' where there is only one.
    names_at : callable
        names_at(stamp, tables) gives what Names.at() does: what ids mean.

    """

    def __init__(self, config: Config | None = None, sensor: str = '',
                 names_at: NamesAt = lambda stamp, tables: (Legend(), None)) -> None:
        """Start without a camera info."""
        self._infos = deque(maxlen=CHANGES_KEPT)    # (stamp, content, info) at each change
        config = config or Config()
        self._rectified = config.camera.rectified
        self._depth, self._fit = config.depth, config.labels.fit
        self._names_at = names_at
        self.reader, self._truth_reader = LabelReader(config.labels), LabelReader(config.labels)
        self._sensor = sensor
        self._cameras: dict = {}
        self._matchings: dict = {}

    @property
    def frame_id(self):
        """Return the frame of the first camera info, None before it has come."""
        return messages.frame_id(self._infos[0][2]) if self._infos else None

    def add_info(self, info):
        """Use *info* for images from its stamp on; refuse (BadMessage) an unusable one."""
        key = content(info)
        if self._infos and self._infos[-1][1] == key:
            return
        check(info, self._rectified)
        self._infos.append((messages.stamp_ns(info), key, info))

    def depth(self, msg) -> NDArray[np.float64]:
        """Return the depth image of a message in metres (H, W), as depth.scale has it."""
        return messages.depth(msg, self._depth.scale)

    def frame(self, match, decoded):
        """
        Return the Frame of a match.

        Parameters
        ----------
        match : persem_ros.inputs.sync.pairing.Match
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
        label_msg, depth_msg = decoded[LABELS], decoded[DEPTH]
        legend, new = self._names_at(match.stamp, getattr(match.items.get(LABELS), 'tables', 0))

        def ids(msg, reader=self.reader):
            found, encoding = reader(msg, legend)
            return renamed(found, new), encoding

        labels, encoding = _named(LABELS, ids, label_msg)
        depth = _named(DEPTH, self.depth, depth_msg)
        matching = self._matching(labels.shape, depth.shape)
        view = self._seen(depth_msg, depth)
        self._distrust(depth, decoded.get(DEPTH_CONFIDENCE))
        companions, faults = {}, []
        truth_of = partial(ids, reader=self._truth_reader)
        for kind, read in ((TRUTH, _truth_like(labels, truth_of)), (COLOR, messages.color)):
            if kind in decoded:
                try:
                    companions[kind] = _named(kind, read, decoded[kind])
                except BadMessage as fault:
                    faults.append(fault)
        return Frame(match.stamp, labels, depth, view, match.T_map_camera, self._sensor,
                     messages.frame_id(label_msg), _wide(encoding, new), matching=matching,
                     weights=_weights(labels, decoded.get(CONFIDENCE)),
                     T_body_camera=match.T_body_camera, **companions), faults

    def _matching(self, labels: tuple[int, int], depth: tuple[int, int]) -> Matching | None:
        """Return how the pixels of label and depth images of two shapes belong together."""
        key = labels, depth
        if key not in self._matchings:
            if len(self._matchings) >= CAMERAS_KEPT:
                self._matchings.pop(next(iter(self._matchings)))
            self._matchings[key] = fit.matching(labels, depth, self._fit)
        return self._matchings[key]

    def _distrust(self, depth: NDArray[np.float64], msg) -> None:
        """Take out of *depth* what its confidence image says is not to be trusted."""
        least = self._depth.min_confidence
        if msg is None or not least:
            return
        trust = _named(DEPTH_CONFIDENCE, messages.depth_confidence, msg)
        if not same_aspect(trust.shape[::-1], depth.shape[::-1]):
            raise BadMessage(f'{DEPTH_CONFIDENCE}: another shape', 'a depth confidence image has '
                             f'the size {trust.shape[1]} x {trust.shape[0]}, its depth image '
                             f'{depth.shape[1]} x {depth.shape[0]}, expected one aspect ratio')
        trust = resampled(trust, depth.shape)
        depth[~((trust if least > 0 else -trust) >= least)] = np.nan

    def seen(self, depth_msg) -> tuple[NDArray[np.float64], Camera]:
        """Return depth (H, W), metres along the optical axis, and camera of a depth message."""
        depth = self.depth(depth_msg)
        return depth, self._seen(depth_msg, depth)

    def _seen(self, depth_msg, depth: NDArray[np.float64]) -> Camera:
        """Return the Camera of a depth image and make what it holds depth along the axis."""
        view, blind, lengths = self._camera(depth_msg, *depth.shape[::-1])
        if blind is not None:
            depth[blind] = np.nan
        if lengths is not None:
            depth /= lengths
        return view

    def _camera(self, depth_msg, width, height):
        """
        Return the Camera of a depth image, the mask of pixels that it cannot see, rays' lengths.

        The lengths, of rays with z = 1, are None where depth is z already.

        """
        if not self._infos:
            raise BadMessage('no camera info', 'no camera info came before the first frame')
        stamp = messages.stamp_ns(depth_msg)
        _, content_key, info = next((entry for entry in reversed(self._infos)
                                     if entry[0] <= stamp), self._infos[0])
        frame_id = messages.frame_id(depth_msg)
        key = content_key, width, height, frame_id
        if key not in self._cameras:
            if len(self._cameras) >= CAMERAS_KEPT:
                self._cameras.pop(next(iter(self._cameras)))
            view = camera(info, width, height, self._rectified, frame_id)
            blind = np.isnan(view.rays[..., 0])
            view.rays[blind] = 0.0
            lengths = np.sqrt(1.0 + (view.rays ** 2).sum(-1)) if self._depth.kind == 'ray' \
                else None
            self._cameras[key] = view, blind if blind.any() else None, lengths
        return self._cameras[key]


def resampled(labels, shape):
    """Return *labels* (H, W) on a grid of another *shape* by nearest pixel centres."""
    if labels.shape == shape:
        return labels
    rows, columns = (((np.arange(n) + 0.5) * m / n).astype(int)
                     for n, m in zip(shape, labels.shape))
    return labels[rows[:, None], columns]


def _weights(labels: NDArray[np.int32], msg) -> NDArray[np.uint32] | None:
    """Return the weights of labels (H, W) that a confidence message has, None without."""
    if msg is None:
        return None
    weights = _named(CONFIDENCE, messages.confidence, msg)
    if weights.shape != labels.shape:
        raise BadMessage(f'{CONFIDENCE}: another size', f'a confidence image has the size '
                         f'{weights.shape[1]} x {weights.shape[0]}, its label image '
                         f'{labels.shape[1]} x {labels.shape[0]}, expected the same')
    return weights


def _wide(encoding: str, new: NDArray[np.int32] | None) -> str:
    """Return an encoding that holds the map's ids, too: a new name may have a larger one."""
    return 'mono16' if new is not None and encoding in ('mono8', '8UC1') else encoding


def _truth_like(labels, ids):
    """Return a reader of truth images on the grid of *labels*; ids(msg) reads one."""
    def read(msg):
        truth, _ = ids(msg)
        if not same_aspect(truth.shape[::-1], labels.shape[::-1]):
            raise BadMessage('shape differs from the labels', f'a truth image has the size '
                             f'{truth.shape[1]} x {truth.shape[0]}, its label image '
                             f'{labels.shape[1]} x {labels.shape[0]}')
        return resampled(truth, labels.shape)
    return read


def _named(kind, read, msg):
    """Read a message; a fault's reason starts with the topic's *kind*."""
    try:
        return read(msg)
    except BadMessage as fault:
        raise BadMessage(f'{kind}: {fault.reason}', f'{kind}: {fault}') from None
