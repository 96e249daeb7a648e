"""The way in, from serialized messages to frames; live and replay share every line of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
import heapq
from typing import Any, TYPE_CHECKING, Union

from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.decode import legends, messages, pose_messages
from persem_ros.inputs.decode.messages import BadMessage
from persem_ros.inputs.names import Names
from persem_ros.inputs.placing import Placing
from persem_ros.inputs.sync.match import (
    COLOR, CONFIDENCE, DEPTH, DEPTH_CONFIDENCE, LABELS, Raw, TRUTH)
from persem_ros.inputs.sync.no_pose import explain
from persem_ros.inputs.sync.pairing import KEEP, repeated, Synchronizer
from persem_ros.inputs.sync.poses import PoseBuffer

if TYPE_CHECKING:
    from collections import Counter

    from persem_ros.frames import Frame
    from persem_ros.inputs.sync.match import Match
    from persem_ros.inputs.sync.track import Lookup
    from persem_ros.settings.config import Config

# At one stamp: whatever completes goes last.
ORDER = {TRUTH: 0, COLOR: 1, CONFIDENCE: 2, DEPTH_CONFIDENCE: 3, DEPTH: 4, LABELS: 5}
INFO, POSE, TF, LEGEND = 'camera_info', 'pose', 'tf', 'legend'
LABELS_INFO, TRAJECTORY = 'labels_info', 'trajectory'
QUEUE_BYTES = 256 << 20
READY_MAX = 64          # matches of some cameras that wait for those of another
# decode(data, typename) gives a message; BadMessage where its bytes are damaged.
Decode = Callable[[Union[bytes, memoryview], str], Any]


class Station:
    """
    One camera on the way in.

    Parameters
    ----------
    synchronizer : Synchronizer
        Its images.
    assembler : Assembler
        Its camera infos.
    poses : PoseBuffer
        Its poses, which it may share with other cameras.

    """

    def __init__(
            self, synchronizer: Synchronizer, assembler: Assembler, poses: PoseBuffer) -> None:
        """Keep them together."""
        self.sync = synchronizer
        self.assembler = assembler
        self.poses = poses


Taker = Union[Station, PoseBuffer, None]    # of a message: a camera, its poses, or all cameras


class Intake:
    """
    Takes messages, pairs and places them, gives frames.

    Parameters
    ----------
    config : persem_ros.settings.config.Config
        The settings sync.*, camera.* and pose.*.
    decode : callable
        decode(data, typename) gives a message; BadMessage where its bytes are damaged.
    dropped : collections.Counter
        Where reasons are counted. Reasons without a colon count label images; others start with
        the kind of message.
    patient : bool
        Whether a match waits for its companions (see Synchronizer).
    pose_wait : float, optional
        Seconds that a match waits for its pose; None: sync.max_wait.
    keep : float
        Seconds that a depth image waits for its labels at least.
    max_bytes : int
        Bound of the images that a camera holds.
    examples : dict, optional
        To be filled.

    Attributes
    ----------
    stations : list
        The cameras, in the order of their numbers.
    examples : dict
        One whole sentence for reasons that have one.
    names : Names
        The classes of the map.
    placing : Placing
        Finds the poses.

    """

    def __init__(self, config: Config, decode: Decode, dropped: Counter[str],
                 patient: bool = False, pose_wait: float | None = None, keep: float = KEEP,
                 max_bytes: int = QUEUE_BYTES, examples: dict[str, str] | None = None) -> None:
        """Start without cameras."""
        self.config = config
        self.stations: list[Station] = []
        self.dropped = dropped
        self.examples = {} if examples is None else examples
        self.names = Names(config)
        self._decode = decode
        self._waits = patient, pose_wait, keep, max_bytes
        # Matches of all cameras with their stamps and the cameras' numbers, a heap.
        self._ready: list[tuple[int, int, Match]] = []
        self.placing = Placing(config, self.examples, self.no_mount, self.untied)

    @property
    def offset(self) -> int:
        """Return what is added to the stamps of label images, ns."""
        return round(self.config.sync.offset_labels * 1e9)

    def add_camera(self, name: str, poses: PoseBuffer, companions: Sequence[str] = (),
                   needed: Sequence[str] = (DEPTH,)) -> Station:
        """
        Add a camera whose poses come from the PoseBuffer *poses*; return its Station.

        companions and needed are kinds of images as of the Synchronizer.

        """
        # Not the method itself: a reading takes other names once it has its cameras.
        assembler = Assembler(self.config, name, lambda *at: self.names.at(*at))
        sync = Synchronizer(self.config.sync, partial(self._lookup, poses, assembler), companions,
                            *self._waits, self.dropped, needed)
        self.stations.append(Station(sync, assembler, poses))
        return self.stations[-1]

    def take(self, role: str, taker: Taker, kind: str, now: int, data: bytes) -> None:
        """
        Take one message; call `leaving` afterwards.

        Parameters
        ----------
        role : str
            A kind of images (one of ORDER), 'camera_info', 'labels_info', 'pose', 'tf',
            'tf_static' or 'legend'.
        taker : Station, PoseBuffer or None
            Whose message it is: poses and transforms go to a buffer, names of classes to none.
        kind : str
            The message type, 'sensor_msgs/msg/Image'.
        now : int
            Nanoseconds of a clock that does not go back.
        data : bytes
            The serialized message.

        """
        try:
            self._take(role, taker, kind, now, data)
        except BadMessage as fault:
            self._drop(role, fault)

    def leaving(self, now: int, last: bool = False) -> Iterator[Frame]:
        """Yield the frames that can leave at time *now*, over all cameras in stamp order."""
        for number, station in enumerate(self.stations):
            for match in station.sync.flush() if last else station.sync.advance(now):
                match.ready = now
                heapq.heappush(self._ready, (match.stamp, number, match))
        while self._ready and (last or self.may_leave(*self._ready[0], now)
                               or len(self._ready) > READY_MAX):
            stamp, number, match = heapq.heappop(self._ready)
            frame = self._frame(self.stations[number], match) \
                if self.wanted(match, number) else None
            self.left(self.stations[number], stamp)
            if frame is not None:
                yield frame

    def may_leave(self, stamp: int, number: int, match: Match, now: int) -> bool:
        """Whether no camera can have an earlier match than this one of camera *number*."""
        raise NotImplementedError

    def wanted(self, match: Match, number: int) -> bool:
        """Whether a match that leaves, of camera *number*, is to become a frame."""
        return True

    def untied(self, frame_id: str, other: str) -> bool:
        """Whether frames that nothing ties to each other are to be taken as one camera's."""
        return True

    def left(self, station: Station, stamp: int) -> None:
        """Take note that the match of *stamp* has left."""

    def oldest_pending(self, default: int) -> int:
        """Return the earliest stamp of a label image held, *default* where none is."""
        pending = (station.sync.first_pending for station in self.stations)
        return min((stamp for stamp in pending if stamp is not None), default=default)

    def push_image(self, station: Station, role: str, stamp: int, raw: Raw, now: int) -> None:
        """Hand an image to its synchroniser."""
        station.sync.push(role, stamp, raw, len(raw.data), now)

    def no_mount(self, reason: str, sentence: str) -> None:
        """Tell that poses do not lead to the camera, yet: *sentence* says what is missing."""
        self.examples[reason] = sentence

    def explain(self) -> None:
        """Write to `examples` why frames had no pose."""
        for reason, (poses, stamp, frame_id) in self.placing.missed.items():
            if reason in self.dropped:
                self.examples[reason] = explain(poses, stamp, frame_id)
        self.placing.missed.clear()

    def clear(self) -> None:
        """Forget all images held (the clock went back)."""
        self._ready.clear()
        for station in self.stations:
            station.sync.clear()

    def _take(self, role: str, taker: Taker, kind: str, now: int, data: bytes) -> None:
        if role in ORDER:
            assert isinstance(taker, Station)
            stamp, frame_id = messages.header(data)
            at = stamp + (self.offset if role == LABELS else 0)
            self.push_image(taker, role, at,
                            Raw(kind, data, frame_id, stamp, self.names.arrived), now)
            return
        msg = self._decode(data, kind)
        if role == LEGEND:
            self.names.add(legends.table(msg))
            return
        if role in (INFO, LABELS_INFO):
            assert isinstance(taker, Station)
            use = taker.assembler.add_info if role == INFO else taker.assembler.add_labels_info
            use(msg)
            return
        assert isinstance(taker, PoseBuffer)
        if role == POSE:
            found = pose_messages.pose(msg)
            if not taker.add(*found):
                self.dropped[f'pose: {repeated(found[0])}'] += 1
        else:
            good, faults = pose_messages.transforms(msg)
            for found in good:
                if role == TF:
                    taker.add_tf(*found)
                else:
                    taker.add_static(*found[1:])
            for fault in faults:
                self._drop(role, fault)

    def _lookup(self, poses: PoseBuffer, assembler: Assembler, match: Match) -> Lookup:
        """Return the pose of a match, once its camera is known."""
        return self.placing.lookup(poses, assembler, match)

    def _frame(self, station: Station, match: Match) -> Frame | None:
        """Return the decoded frame of a match, None where it cannot be used."""
        decoded: dict[str, Any] = {}
        try:
            for kind, raw in match.items.items():
                try:
                    decoded[kind] = self._decode(memoryview(raw.data), raw.msgtype)
                except BadMessage as error:
                    self._drop(kind, error)
                    if kind in station.sync.needed:
                        return None
            frame, faults = station.assembler.frame(match, decoded)
        except BadMessage as error:
            self._count(error)
            return None
        for fault in faults:
            self._count(fault)
        return frame

    def _drop(self, role: str, fault: BadMessage) -> None:
        """Count a fault of a message whose reason does not yet say which kind it was."""
        self._count(fault if role == INFO else BadMessage(f'{role}: {fault.reason}', str(fault)))

    def _count(self, fault: BadMessage) -> None:
        self.dropped[fault.reason] += 1
        self.examples.setdefault(fault.reason, str(fault))
