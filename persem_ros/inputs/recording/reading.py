"""One reading of a recording: messages in, frames out, in the order of header stamps."""

import heapq
import sys

from persem_ros.errors import PersemError
from persem_ros.inputs.intake import INFO, Intake, ORDER, POSE, TF
from persem_ros.inputs.sync.pairing import COLOR, DEPTH, LABELS, TRUTH
from persem_ros.inputs.sync.poses import PoseBuffer

WINDOW_BYTES = 64 << 20
PATIENCE = 30.0         # s for poses and labels that come late; waiting costs memory only
POSES_KEPT = 300.0      # s


class Reading(Intake):
    """
    One pass over a recording.

    Parameters
    ----------
    recording : persem_ros.inputs.recording.recording.Recording
        Whose counters this fills.
    truth, color : bool
        Whether those topics are read.

    """

    def __init__(self, recording, truth=False, color=False):
        """Set up the queues."""
        config = recording.config
        super().__init__(config, recording.source.decode, recording.dropped, True, PATIENCE,
                         PATIENCE)
        self.examples = recording.examples
        self._recording = recording
        self._source = recording.source
        self._roles = {}        # topic -> [(kind, station or pose buffer)]
        self._buffers = {}      # pose topic -> PoseBuffer
        self._window = Window(round(config.sync.max_wait * 1e9), WINDOW_BYTES)
        companions = [kind for kind, wanted in ((TRUTH, truth), (COLOR, color)) if wanted]
        for name, chosen in recording.topics.items():
            self._add_camera(name, chosen, [k for k in companions if k in chosen])

    def frames(self):
        """Yield the frames; the recording's counters follow."""
        now = 0
        for topic, kind, time, data in self._source.messages(set(self._roles)):
            now = max(now, time)
            for role, taker in self._roles[topic]:
                self.take(role, taker, kind, now, data)
            yield from self.leaving(now)
        self._push(self._window.flush(), now)
        yield from self.leaving(now, True)
        self._conclude()

    def may_leave(self, stamp, number, match, now):
        """Whether the window and the other cameras have only later images."""
        return len(self.stations) == 1 or stamp < self.oldest_pending(sys.maxsize)

    def left(self, station, stamp):
        """Forget the poses that only earlier frames would ask for."""
        station.poses.forget(min(stamp, self.oldest_pending(stamp)))

    def oldest_pending(self, default):
        """Return the earliest stamp that may still come."""
        pending = super().oldest_pending(default)
        return pending if len(self.stations) == 1 else min(pending, self._window.front)

    def push_image(self, station, role, stamp, raw, now):
        """Let an image wait in the window until those before it have come."""
        self._push(self._window.push(stamp, ORDER[role], now, len(raw.data),
                                     (station, role, stamp, raw)), now)

    def no_mount(self, sentence):
        """Refuse poses that never lead to the camera."""
        raise PersemError(f'{self._recording.path}: {sentence}')

    def _push(self, items, now):
        for station, role, stamp, raw in items:
            super().push_image(station, role, stamp, raw, now)

    def _add_camera(self, name, chosen, companions):
        station = self.add_camera(name, self._pose_buffer(chosen), companions)
        station.assembler.add_info(self._recording.infos[chosen[INFO].name])
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

    def _conclude(self):
        """Tell the recording what only the end of a reading knows."""
        for buffer in self._buffers.values():
            for key, text in buffer.notes.items():
                self._recording.note(key, text)
        self.explain()


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
