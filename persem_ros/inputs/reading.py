"""One reading of a recording: messages in, frames out, in the order of header stamps."""

from functools import partial
import heapq
import sys
from typing import NamedTuple

from persem_ros.errors import PersemError
from persem_ros.inputs import messages
from persem_ros.inputs.assemble import Assembler
from persem_ros.inputs.messages import BadMessage
from persem_ros.inputs.poses import NO_MOUNT, PoseBuffer
from persem_ros.inputs.sync import COLOR, DEPTH, LABELS, Synchronizer, TRUTH

ORDER = {TRUTH: 0, COLOR: 1, DEPTH: 2, LABELS: 3}   # at one stamp: whatever completes goes last
INFO, POSE, TF = 'camera_info', 'pose', 'tf'
WINDOW_BYTES = 64 << 20
QUEUE_BYTES = 256 << 20
PATIENCE = 30.0         # s for poses and labels that come late; waiting costs memory only
POSES_KEPT = 300.0      # s
READY_MAX = 64          # matches of some cameras that wait for those of another


class Raw(NamedTuple):
    """An image that has not been decoded: most of those without a partner never are."""

    msgtype: str
    data: bytes
    frame_id: str


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

    def __init__(self, synchronizer, assembler, poses):
        """Keep them together."""
        self.sync = synchronizer
        self.assembler = assembler
        self.poses = poses


class Reading:
    """
    One pass over a recording.

    Parameters
    ----------
    recording : persem_ros.inputs.recording.Recording
        Whose counters this fills.
    truth, color : bool
        Whether those topics are read.

    """

    def __init__(self, recording, truth=False, color=False):
        """Set up the queues."""
        config = recording.config
        self._recording = recording
        self._source = recording.source
        self._dropped = recording.dropped
        self._roles = {}        # topic -> [(kind, station or pose buffer)]
        self._buffers = {}      # pose topic -> PoseBuffer
        self._stations = []
        self._ready = []        # matches of all cameras, a heap
        self._missed = {}       # reason -> what a lookup without a pose was for
        self._window = Window(round(config.sync.max_wait * 1e9), WINDOW_BYTES)
        companions = [kind for kind, wanted in ((TRUTH, truth), (COLOR, color)) if wanted]
        for name, chosen in recording.topics.items():
            self._add_station(name, chosen, [k for k in companions if k in chosen])

    def frames(self):
        """Yield the frames; the recording's counters follow."""
        now = 0
        for topic, kind, time, data in self._source.messages(set(self._roles)):
            now = max(now, time)
            for role, taker in self._roles[topic]:
                try:
                    self._take(role, taker, kind, now, data)
                except BadMessage as fault:
                    self._drop(role, fault)
            yield from self._leaving(now)
        self._push(self._window.flush(), now)
        yield from self._leaving(now, True)
        self._conclude()

    def _add_station(self, name, chosen, companions):
        config = self._recording.config
        poses = self._pose_buffer(chosen)
        info = self._recording.infos[chosen[INFO].name]
        lookup = partial(self._lookup, poses, messages.frame_id(info))
        sync = Synchronizer(config.sync, lookup, companions, True, PATIENCE, PATIENCE,
                            QUEUE_BYTES, self._dropped)
        station = Station(sync, Assembler(config.camera.rectified, name), poses)
        station.assembler.add_info(info)
        self._stations.append(station)
        for kind in (LABELS, DEPTH, *companions, INFO):
            self._roles.setdefault(chosen[kind].name, []).append((kind, station))

    def _pose_buffer(self, chosen):
        """Return the buffer of a camera's poses; cameras with one pose topic share it."""
        name = chosen[POSE].name if POSE in chosen else TF
        if name not in self._buffers:
            buffer = self._buffers[name] = PoseBuffer(self._recording.config, POSES_KEPT)
            for transform in self._recording.statics:
                buffer.add_static(*transform)
            topics = [chosen[POSE]] if POSE in chosen else self._recording.choice.tf
            for topic in topics:
                self._roles[topic.name] = [(POSE if POSE in chosen else TF, buffer)]
        return self._buffers[name]

    def _take(self, role, taker, kind, now, data):
        """Take one message: images wait in the window, the rest is known at once."""
        if role in ORDER:
            stamp, frame_id = messages.header(data)
            item = (role, taker, stamp, Raw(kind, data, frame_id))
            self._push(self._window.push(stamp, ORDER[role], now, len(data), item), now)
            return
        msg = self._source.decode(data, kind)
        if role == INFO:
            taker.assembler.add_info(msg)
        elif role == POSE:
            if not taker.add(*messages.pose(msg)):
                self._dropped['pose: stamp repeated'] += 1
        else:
            good, faults = messages.transforms(msg)
            for found in good:
                taker.add_tf(*found)
            for fault in faults:
                self._drop(role, fault)

    def _push(self, items, now):
        for role, station, stamp, raw in items:
            station.sync.push(role, stamp, raw, len(raw.data), now)

    def _leaving(self, now, last=False):
        """Yield the frames that can leave, over all cameras in stamp order."""
        for number, station in enumerate(self._stations):
            for match in station.sync.flush() if last else station.sync.advance(now):
                heapq.heappush(self._ready, (match.stamp, number, match))
        while self._ready and (last or self._ready[0][0] < self._bound()
                               or len(self._ready) > READY_MAX):
            stamp, number, match = heapq.heappop(self._ready)
            station = self._stations[number]
            frame = self._frame(station, match)
            station.poses.forget(min(stamp, self._bound()))
            if frame is not None:
                yield frame

    def _bound(self):
        """Return the stamp before which no camera can have another match."""
        if len(self._stations) == 1:
            return float('inf')
        pending = [s.sync.first_pending for s in self._stations]
        return min([self._window.front, *(stamp for stamp in pending if stamp is not None)])

    def _lookup(self, poses, info_frame, match):
        """Return the pose of a match; refuse poses that never lead to the camera."""
        depth, labels = match.items[DEPTH], match.items[LABELS]
        frame_id = depth.frame_id or labels.frame_id or info_frame
        found = poses.lookup(match.stamp, frame_id)
        if found.reason == NO_MOUNT:
            raise PersemError(f'{self._recording.path}: {poses.mount_sentence(frame_id)}')
        if found.T is None:
            self._missed[found.reason] = poses, match.stamp, frame_id
        return found

    def _frame(self, station, match):
        """Return the decoded frame of a match, None where it cannot be used."""
        decoded = {}
        try:
            for kind, raw in match.items.items():
                try:
                    decoded[kind] = self._source.decode(memoryview(raw.data), raw.msgtype)
                except BadMessage as fault:
                    self._drop(kind, fault)
                    if kind in (LABELS, DEPTH):
                        return None
            frame, faults = station.assembler.frame(match, decoded)
        except BadMessage as fault:
            self._count(fault)
            return None
        for fault in faults:
            self._count(fault)
        return frame

    def _drop(self, role, fault):
        """Count a fault of a message whose reason does not yet say which kind it was."""
        self._count(fault if role == INFO else BadMessage(f'{role}: {fault.reason}', str(fault)))

    def _count(self, fault):
        self._dropped[fault.reason] += 1
        self._recording.examples.setdefault(fault.reason, str(fault))

    def _conclude(self):
        """Tell the recording what only the end of a reading knows."""
        for buffer in self._buffers.values():
            for key, text in buffer.notes.items():
                self._recording.note(key, text)
        for reason, (poses, stamp, frame_id) in self._missed.items():
            if reason in self._dropped:
                self._recording.examples[reason] = poses.explain(stamp, frame_id)


class Window:
    """
    Puts images that arrive out of order into stamp order, across a bounded time of arrival.

    Parameters
    ----------
    span : int
        Nanoseconds of arrival that an image is held.
    max_bytes : int
        Bound of what is held; the earliest stamps go first.

    """

    def __init__(self, span, max_bytes):
        """Start empty."""
        self.front = -sys.maxsize       # stamp of the last image that left
        self._span = span
        self._max = max_bytes
        self._heap = []
        self._bytes = 0
        self._count = 0

    def push(self, stamp, order, now, size, item):
        """Take an item; return those that leave, in order."""
        self._count += 1
        heapq.heappush(self._heap, (stamp, order, self._count, now, size, item))
        self._bytes += size
        leaving = []
        while self._heap and (now - self._heap[0][3] >= self._span or self._bytes > self._max):
            leaving.append(self._pop())
        return leaving

    def flush(self):
        """Return everything held, in order."""
        return [self._pop() for _ in range(len(self._heap))]

    def _pop(self):
        stamp, _, _, _, size, item = heapq.heappop(self._heap)
        self._bytes -= size
        self.front = stamp
        return item
