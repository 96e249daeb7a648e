"""
One .mcap file, whole or damaged: what is in it, and any message by its place.

The format is https://mcap.dev/spec. Everything is found by walking over the file's records, and
by the summary at its end only where it spares a walk: so a file without an end reads as one with.

"""

from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterator
import os
from pathlib import Path
import struct

from persem_ros.inputs.recording.channels import Channel
from persem_ros.inputs.recording.mcap_chunks import Chunk, Chunks, text_at
from persem_ros.inputs.recording.stamps import HEAD

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 7, 8, 11, 15
FOOT = 37                   # bytes of the footer record and the magic behind it
PREFIX = 22                 # bytes of a message record before its data
RECORD = struct.Struct('<BQ')
MESSAGE_HEAD = struct.Struct('<HIQQ')
ALONE = (1 << 23) - 1       # in a place: a message outside of all chunks
PEEK = 1 << 14              # bytes that are read at once where only heads are wanted


class McapFile:
    """
    An open .mcap file.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    damage : list of str
        What is wrong with it, a few words each; those of chunks come as they are read.
    profile : str
        'ros2', 'ros1', '' …
    channels : list of Channel
        With the numbers of their messages.

    Raises
    ------
    ValueError
        Where it is no .mcap file.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []
        self.profile = ''
        self._file = path.open('rb')
        try:
            self._fd = self._file.fileno()
            self._end = os.fstat(self._fd).st_size
            self._chunks = Chunks(self._get, self._end, self._note)
            self._alone = array('q')            # places of messages outside of chunks
            self._inside: dict[int, set[int]] = {}      # chunk's record -> channels, if known
            self._schemas: dict[int, tuple[str, str]] = {}
            self._channels: dict[int, tuple[str, int, str]] = {}
            self._starts: list[int] | None = None       # of chunks, as the summary says
            if self._get(0, len(MAGIC)) != MAGIC:
                raise ValueError('no mcap file')
            self._scan()
            self.channels = self._described(self._counts())
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._chunks.clear()

    def heads(self, numbers: Collection[int]) -> Iterator[tuple[int, int, int, bytes]]:
        """
        Walk over the messages of some channels in the order of the file.

        Yields
        ------
        number : int
            Channel.
        time : int
            Log time, nanoseconds.
        place : int
            For read().
        head : bytes
            Of a message its first bytes; the whole message where they are at hand.

        """
        wanted = set(numbers)
        for place in self._alone:
            at = place & ((1 << 40) - 1)
            number, _, time, _ = MESSAGE_HEAD.unpack(self._get(at + 9, PREFIX))
            if number in wanted:
                yield number, time, place, self._get(at + 9 + PREFIX, HEAD)
        for k, chunk in enumerate(self._chunks.all):
            inside = self._inside.get(chunk.record)
            if not inside or inside & wanted:     # a writer without indexes lists none
                yield from self._heads_in(k, chunk, wanted)

    def read(self, place: int) -> bytes:
        """Return the serialized message at a place, b'' where it cannot be read any more."""
        number, at = place >> 40, place & ((1 << 40) - 1)
        if number == ALONE:
            size = RECORD.unpack(self._get(at, 9))[1]
            return self._get(at + 9 + PREFIX, size - PREFIX)
        chunk = self._chunks.all[number]
        if self._chunks.is_plain(number):
            size = RECORD.unpack(self._get(chunk.start + at, 9))[1]
            return self._get(chunk.start + at + 9 + PREFIX, size - PREFIX)
        content = self._chunks.content(number)
        if len(content) < at + 9:
            return b''
        size = RECORD.unpack_from(content, at)[1]
        return content[at + 9 + PREFIX:at + 9 + size]

    def _get(self, at: int, size: int) -> bytes:
        return os.pread(self._fd, max(0, min(size, self._end - at)), at)

    def _heads_in(self, k: int, chunk: Chunk, wanted: set[int]) \
            -> Iterator[tuple[int, int, int, bytes]]:
        """Yield what heads() does of one chunk; of one that is not compressed little is read."""
        if chunk.compression or self._chunks.at_hand(k):
            content = self._chunks.content(k)
            end, first, buffer = len(content), 0, content
        else:
            end, first, buffer = min(chunk.size, self._end - chunk.start), 0, b''
        at = 0
        while at + 9 <= end:
            if at + 9 + PREFIX + HEAD > first + len(buffer) < end:
                first, buffer = at, self._get(chunk.start + at, min(PEEK, end - at))
            if at + 9 > first + len(buffer):    # the file has become shorter meanwhile
                break
            kind, size = RECORD.unpack_from(buffer, at - first)
            if at + 9 + size > end:
                break
            if kind == MESSAGE and size >= PREFIX:
                number, _, time, _ = MESSAGE_HEAD.unpack_from(buffer, at - first + 9)
                if number in wanted:
                    begin = at - first + 9 + PREFIX
                    yield number, time, k << 40 | at, buffer[
                        begin:min(begin + HEAD, at - first + 9 + size)]
            at += 9 + size

    def _scan(self) -> None:
        """Find chunks and messages outside of them; schemas and channels wherever they are."""
        at = len(MAGIC)
        while at + 9 <= self._end:
            kind, size = RECORD.unpack(self._get(at, 9))
            start, at = at, at + 9 + size
            if kind == DATA_END:
                break
            if at > self._end or not HEADER <= kind <= DATA_END:
                if kind == CHUNK:       # what there is of it may still be read
                    self._chunks.add(start, size)
                at = self._resumed(start)
                continue
            if kind == CHUNK:
                self._chunks.add(start, size)
            elif kind == MESSAGE:
                self._alone.append(ALONE << 40 | start)
            elif kind in (HEADER, SCHEMA, CHANNEL):
                self._learn(kind, self._get(start + 9, size))
        if self._get(self._end - len(MAGIC), len(MAGIC)) != MAGIC or self._end < FOOT:
            self._note('cut off')

    def _resumed(self, at: int) -> int:
        """Return where the next chunk begins behind a damaged record; the end if unknown."""
        if self._starts is None:        # once: there may be as many damaged records as chunks
            self._starts = sorted(start for _, start in self._summary_chunks())
        place = bisect_right(self._starts, at)
        found = place < len(self._starts)
        self._note('damaged' if found else 'cut off')
        return self._starts[place] if found else self._end

    def _summary(self) -> Iterator[tuple[int, bytes]]:
        """Yield (kind, content) of the records behind the data, none where the end is lost."""
        foot = self._get(self._end - FOOT, FOOT)
        if len(foot) < FOOT or foot[-len(MAGIC):] != MAGIC or foot[0] != FOOTER:
            return
        at = int.from_bytes(foot[9:17], 'little')
        while 0 < at < self._end - FOOT:
            kind, size = RECORD.unpack(self._get(at, 9))
            if at + 9 + size > self._end:
                return
            yield kind, self._get(at + 9, size)
            at += 9 + size

    def _summary_chunks(self) -> list[tuple[int, int]]:
        return [(kind, int.from_bytes(data[16:24], 'little')) for kind, data in self._summary()
                if kind == CHUNK_INDEX]

    def _learn(self, kind: int, data: bytes) -> None:
        """Take a header, schema or channel; leave out one that is damaged."""
        try:
            if kind == HEADER:
                self.profile = text_at(data, 0)[0]
                return
            number = int.from_bytes(data[:2], 'little')
            if kind == SCHEMA:
                name, at = text_at(data, 2)
                self._schemas[number] = name, text_at(data, at)[0]
            else:
                topic, at = text_at(data, 4)
                schema = int.from_bytes(data[2:4], 'little')
                self._channels[number] = topic, schema, text_at(data, at)[0]
        except (ValueError, IndexError):
            self._note('damaged')

    def _counts(self) -> dict[int, int]:
        """Return {channel: messages}: of the summary where it has them, else counted."""
        stated: dict[int, int] = {}
        total = -1
        for kind, data in self._summary():
            if kind in (SCHEMA, CHANNEL):
                self._learn(kind, data)
            elif kind == CHUNK_INDEX:
                length = int.from_bytes(data[32:36], 'little')
                start = int.from_bytes(data[16:24], 'little')
                self._inside[start] = {number for number, _ in _pairs(data[36:36 + length])}
            elif kind == STATISTICS:
                total = int.from_bytes(data[:8], 'little')
                stated = dict(_pairs(data[46:]))
        if sum(stated.values()) == total and not self.damage \
                and set(stated) <= set(self._channels):
            return stated
        for k in range(len(self._chunks.all)):
            self._learn_inside(k)
        return Counter(number for number, *_ in self.heads(self._channels))

    def _learn_inside(self, k: int) -> None:
        """Take the schemas and channels of a chunk."""
        chunk, at = self._chunks.all[k], 0
        content = self._chunks.content(k) if chunk.compression else b''
        end = len(content) if chunk.compression else min(chunk.size, self._end - chunk.start)
        while at + 9 <= end:
            head = content[at:at + 9] if chunk.compression else self._get(chunk.start + at, 9)
            kind, size = RECORD.unpack(head)
            if at + 9 + size > end:
                return
            if kind in (SCHEMA, CHANNEL):
                self._learn(kind, content[at + 9:at + 9 + size] if chunk.compression
                            else self._get(chunk.start + at + 9, size))
            at += 9 + size

    def _described(self, counts: dict[int, int]) -> list[Channel]:
        found = []
        for number, (topic, schema, encoding) in sorted(self._channels.items()):
            name, form = self._schemas.get(schema, ('', ''))
            found.append(Channel(number, topic, name, counts.get(number, 0), encoding, form))
        return found

    def _note(self, text: str) -> None:
        if text not in self.damage:
            self.damage.append(text)


def _pairs(data: bytes) -> Iterator[tuple[int, int]]:
    """Return the (uint16, uint64) pairs of a map in a record, as far as it goes."""
    return struct.iter_unpack('<HQ', data[:len(data) // 10 * 10])
