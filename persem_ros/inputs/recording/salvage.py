"""
Reading files that rosbags refuses: cut off, never closed, or with a name that it cannot open.

Both readers look like those of rosbags: connections, messages(connections), close().

"""

from pathlib import Path
import sqlite3
from typing import NamedTuple
from urllib.parse import quote

from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

MAGIC = b'\x89MCAP0\r\n'
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0F


class Connection(NamedTuple):
    """The part of rosbags' Connection that a Source looks at."""

    number: int
    topic: str
    msgtype: str
    msgcount: int
    ext: ConnectionExtRosbag2


def opened(file):
    """
    Open one storage file, whole or damaged.

    Parameters
    ----------
    file : Path
        A .mcap or .db3 file.

    Returns
    -------
    reader or None
        Its attribute *damage* is a word for the user, '' where nothing is wrong; None where
        nothing can be read.

    """
    try:
        reader = Whole(file)
    # Whatever a damaged file makes the parsers of rosbags raise.
    except Exception:
        try:
            reader = (Mcap if file.suffix == '.mcap' else Sqlite)(file)
        except (OSError, sqlite3.Error, ValueError, KeyError, IndexError):
            return None
    return reader if reader.connections else None


def _qos(text):
    """Return the QoS profiles of a topic, none where their text is damaged."""
    try:
        return parse_qos(text)
    except (ReaderError, KeyError, TypeError, AttributeError):
        return []


class Whole(Reader):
    """A file without damage in a folder that has lost its metadata."""

    damage = ''

    def __init__(self, file):
        """Open the file."""
        super().__init__(file)
        self.open()


class Mcap:
    """A .mcap file without its summary: read from the front, record by record."""

    damage = 'cut off'

    def __init__(self, file):
        """Read the file once to learn what is in it."""
        self.path = Path(file)
        self._schemas, self._channels, counts = {}, {}, {}
        with self.path.open('rb') as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise ValueError('not an mcap file')
        for kind, data in self._records():
            number = int.from_bytes(data[:2], 'little')
            if kind == SCHEMA:
                self._schemas[number] = _text(data, 2)[0]
            elif kind == CHANNEL:
                self._channels[number] = self._channel(data)
            elif kind == MESSAGE:
                counts[number] = counts.get(number, 0) + 1
        self.connections = [Connection(number, *names, counts.get(number, 0), ext)
                            for number, (names, ext) in self._channels.items()]

    def messages(self, connections):
        """Yield (connection, time, data) as far as the file goes."""
        chosen = {connection.number: connection for connection in connections}
        for kind, data in self._records():
            if kind == MESSAGE:
                connection = chosen.get(int.from_bytes(data[:2], 'little'))
                if connection is not None:
                    yield connection, int.from_bytes(data[6:14], 'little'), bytes(data[22:])

    def close(self):
        """Do nothing: every reading opens the file anew."""

    def _channel(self, data):
        schema = int.from_bytes(data[2:4], 'little')
        topic, at = _text(data, 4)
        encoding, at = _text(data, at)
        end = at + 4 + int.from_bytes(data[at:at + 4], 'little')
        at += 4
        metadata = {}
        while at < end:
            key, at = _text(data, at)
            metadata[key], at = _text(data, at)
        ext = ConnectionExtRosbag2(encoding, _qos(metadata.get('offered_qos_profiles', '')))
        return (topic, self._schemas.get(schema, '')), ext

    def _records(self):
        """Yield (kind, data) of the records outside and inside of chunks."""
        length = self.path.stat().st_size
        with self.path.open('rb') as stream:
            stream.seek(len(MAGIC))
            while len(head := stream.read(9)) == 9:
                size = int.from_bytes(head[1:], 'little')
                data = stream.read(min(size, length - stream.tell()))   # the size may be damaged
                if head[0] == DATA_END:
                    return
                if head[0] == CHUNK:
                    yield from _chunk(data)
                elif len(data) == size:
                    yield head[0], data


def _chunk(data):
    """Yield the records of a chunk, of one that is cut off those that are whole."""
    if len(data) < 32:
        return
    compression, at = _text(data, 28)
    size = int.from_bytes(data[at:at + 8], 'little')
    inner = memoryview(data)[at + 8:]
    if compression:
        if len(inner) < size or compression not in DECOMPRESSORS:
            return
        try:
            inner = memoryview(DECOMPRESSORS[compression](
                bytes(inner[:size]), int.from_bytes(data[16:24], 'little')))
        # The compressors' own exceptions: this chunk is damaged, the next may not be.
        except Exception:
            return
    at = 0
    while at + 9 <= len(inner):
        end = at + 9 + int.from_bytes(inner[at + 1:at + 9], 'little')
        if end > len(inner):
            return
        yield inner[at], inner[at + 9:end]
        at = end


def _text(data, at):
    """Return the string at an offset and where it ends."""
    end = at + 4 + int.from_bytes(data[at:at + 4], 'little')
    return bytes(data[at + 4:end]).decode(errors='replace'), end


class Sqlite:
    """A .db3 file, whole or cut off: rows in order until one cannot be read."""

    def __init__(self, file):
        """Open the file and learn what is in it."""
        self.path = Path(file)
        self.damage = ''
        self._base = sqlite3.connect(f'file:{quote(str(file))}?immutable=1', uri=True,
                                     check_same_thread=False)
        try:
            self.connections = self._topics()
        except BaseException:
            self._base.close()
            raise

    def _topics(self):
        """Return the connections, with the numbers of their messages that can be read."""
        # Without this SQLite refuses a file that is shorter than its header says.
        self._base.execute('PRAGMA writable_schema=ON')
        columns = [row[1] for row in self._base.execute('PRAGMA table_info(topics)')]
        qos = 'offered_qos_profiles' if 'offered_qos_profiles' in columns else "''"
        topics = self._base.execute(
            f'SELECT id, name, type, serialization_format, {qos} FROM topics').fetchall()
        counts = {}
        for number, _, _ in self._rows('topic_id, timestamp, 0'):
            counts[number] = counts.get(number, 0) + 1
        return [
            Connection(number, name, kind, counts.get(number, 0),
                       ConnectionExtRosbag2(form, _qos(profiles)))
            for number, name, kind, form, profiles in topics]

    def messages(self, connections):
        """Yield (connection, time, data) as far as the file goes."""
        chosen = {connection.number: connection for connection in connections}
        for number, time, data in self._rows('topic_id, timestamp, data'):
            if number in chosen:
                yield chosen[number], time, data

    def close(self):
        """Close the file."""
        self._base.close()

    def _rows(self, columns):
        # By row id, not by time: the index on time is the first thing that a cut destroys.
        rows = self._base.execute(f'SELECT {columns} FROM messages ORDER BY id')
        while True:
            try:
                row = rows.fetchone()
            except sqlite3.ProgrammingError:
                raise       # a mistake of ours, not damage
            except sqlite3.Error:
                self.damage = 'cut off'
                return
            if row is None:
                return
            yield row
