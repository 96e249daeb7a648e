"""The chunks of an .mcap file: where they lie, and what is in them, unpacked and checked."""

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple
from zlib import crc32

from persem_ros.inputs.recording import packing

KEPT = 32 << 20             # bytes of chunks that are kept: compressed ones, and damaged ends. In
#                             order, 2 MB unpack as seldom as 64; 32 hold what is 2 s late at 5 Hz


class Chunk(NamedTuple):
    """Where a chunk lies, where its records do, and what they were before the compression."""

    record: int
    start: int
    stored: int
    size: int
    crc: int
    compression: str


class Chunks:
    """
    Those of one file, by their numbers.

    Parameters
    ----------
    get : callable
        get(at, size) gives bytes of the file, fewer behind its end.
    end : int
        Bytes of the file.
    note : callable
        note(text) hears what is wrong with a chunk.

    Attributes
    ----------
    all : list of Chunk
        In the order of the file.

    """

    def __init__(self, get: Callable[[int, int], bytes], end: int,
                 note: Callable[[str], None]) -> None:
        self.all: list[Chunk] = []
        self._get, self._end, self._note = get, end, note
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._good: set[int] = set()        # those whose checksum was found right
        self._bad: set[int] = set()

    def add(self, start: int, size: int) -> None:
        """Take in the chunk record at a place, with so many bytes of content; leave out others."""
        head = self._get(start + 9, min(size, 128))
        if len(head) < 40:
            return
        try:
            length, crc = int.from_bytes(head[16:24], 'little'), head[24:28]
            compression, at = text_at(head, 28)
            stored = int.from_bytes(head[at:at + 8], 'little')
        except (ValueError, IndexError):
            return
        if compression not in packing.KINDS:
            self._note(f'compressed by {compression[:20]!r}, which is not known here')
            return
        # Chunks lie one behind the other: what reaches into the next would be read over and over.
        stored = min(stored, max(0, size - at - 8))
        if not compression:
            length = min(length, stored)
        self.all.append(Chunk(start, start + 9 + at + 8, stored, length,
                              int.from_bytes(crc, 'little'), compression))

    def at_hand(self, k: int) -> bool:
        """Return whether the content of a chunk is kept."""
        return k in self._cache

    def is_plain(self, k: int) -> bool:
        """Return whether the records of a chunk may be read one by one: it is whole."""
        return not self.all[k].compression and k in self._good and k not in self._cache

    def content(self, k: int) -> bytes:
        """Return the records of a chunk, b'' where they are damaged."""
        if k in self._cache:
            self._cache.move_to_end(k)
            return self._cache[k]
        if k in self._bad:
            return b''
        chunk = self.all[k]
        try:
            content = packing.unpacked(chunk.compression,
                                       self._get(chunk.start, chunk.stored), chunk.size)
            # A chunk that the file's end cuts off has no checksum that could be right.
            if chunk.start + chunk.stored <= self._end and k not in self._good:
                if len(content) != chunk.size or chunk.crc and crc32(content) != chunk.crc:
                    raise ValueError('checksum')
                self._good.add(k)
        # Damaged bytes make the decompressors raise exceptions of their own.
        except Exception as error:
            self._bad.add(k)
            self._note(str(error) if isinstance(error, packing.TooLarge) else 'damaged inside')
            return b''
        if not chunk.compression and k in self._good:   # read() takes single messages from now on
            return content
        self._cache[k] = content
        kept = sum(map(len, self._cache.values()))
        while kept > KEPT and len(self._cache) > 2:
            kept -= len(self._cache.popitem(last=False)[1])
        return content

    def clear(self) -> None:
        """Let go of the contents that are kept."""
        self._cache.clear()


def text_at(data: bytes, at: int) -> tuple[str, int]:
    """Return the string at an offset and where it ends; ValueError where it does not end."""
    end = at + 4 + int.from_bytes(data[at:at + 4], 'little')
    if end > len(data):
        raise ValueError('a text that does not end')
    return data[at + 4:end].decode(errors='replace'), end
