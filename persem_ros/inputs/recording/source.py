"""One input as a stream of raw messages: a recording or several, whatever their storage."""

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from shlex import quote
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.recording import finding, packing
from persem_ros.inputs.recording.channels import Channel
from persem_ros.inputs.recording.mcap_file import McapFile
from persem_ros.inputs.recording.sqlite_file import SqliteFile
from persem_ros.inputs.recording.stamps import FIRST, HEAD, offset

LARGE = 3               # messages that unpack to too much; of more nothing is read
SHOWN = 4               # topics in a note
REMEMBERED = 200_000    # messages of an input whose heads are kept, 250 bytes each


class TopicInfo(NamedTuple):
    """A topic of a recording; a topic with two types is two of them."""

    name: str
    msgtype: str        # 'sensor_msgs/msg/Image'
    count: int          # type: ignore[assignment]  # hides tuple.count, which nobody asks for


class Head(NamedTuple):
    """What is known of a message that has not been read."""

    topic: str
    msgtype: str
    time: int           # when it was recorded, nanoseconds
    file: int           # with the place: where it is
    place: int
    start: bytes        # its first bytes, stamps.HEAD of them at least


class Source:
    """
    An open input.

    Parameters
    ----------
    path : str or Path
        As of finding.found; 'A+B' is one input in two recordings.

    Attributes
    ----------
    path : Path
        The same.
    name : str
        A short name for people.
    storage : str
        'mcap' or 'sqlite3', with the kind of compression where there is one.
    topics : list of TopicInfo
        By name.

    Raises
    ------
    PersemError
        Where there is no recording, or nothing in it can be read.

    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._decode = Decoder()
        self._notes: list[str] = []
        self._damage: list[str] = []
        self._files: list[McapFile | SqliteFile] = []
        self._unpacked: TemporaryDirectory[str] | None = None
        self._packed: list[Path] = []
        self._sizes = self._large = 0
        self._heads: list[Head] | None = None       # of all messages, where they are few
        recordings = [finding.found(part) for part in finding.split(path)]
        self.name = '+'.join(found.path.stem if found.path.is_file() else
                             found.path.resolve().name for found in recordings)
        try:
            ends = []
            for found in recordings:
                self._open(found)
                ends.append(len(self._files))
            self.topics = self._topics()
            self._note_twice(recordings, ends)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> 'Source':
        """Return the open input."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the input."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._damage = self._damaged()
        for file in self._files:
            with suppress(OSError, sqlite3.Error):  # nothing was written, nothing can be lost
                file.close()
        self._files = []
        if self._unpacked is not None:
            self._unpacked.cleanup()
            self._unpacked = None

    @property
    def notes(self) -> list[str]:
        """Return what was wrong with the recording and did not prevent its use: sentences."""
        return list(dict.fromkeys(self._notes + self._damaged()))

    @property
    def size(self) -> int:
        """Bytes on disk."""
        return self._sizes

    @property
    def storage(self) -> str:
        """Return the kinds of files."""
        kinds = {'mcap' if isinstance(file, McapFile) else 'sqlite3' for file in self._files}
        return ' and '.join(sorted(kinds)) + (', compressed files' if self._packed else '')

    def messages(self, names: Collection[str], start: int | None = None,
                 stop: int | None = None) -> Iterator[tuple[str, str, int, bytes]]:
        """
        Read messages in the order of the files.

        Parameters
        ----------
        names : collection of str
            Topics.
        start, stop : int, optional
            Only what was recorded from *start* until before *stop*, nanoseconds.

        Yields
        ------
        topic : str
            Its name.
        type : str
            Its message type.
        time : int
            When it was recorded, nanoseconds.
        data : bytes
            The serialized message.

        """
        for head in self.heads(names):
            if start is not None and head.time < start or stop is not None and head.time >= stop:
                continue
            data = self.read(head.file, head.place)
            if data:
                yield head.topic, head.msgtype, head.time, data

    def heads(self, names: Collection[str]) -> Iterator[Head]:
        """Walk over the messages of some topics without reading them, as messages() does."""
        if self._heads is None and sum(topic.count for topic in self.topics) <= REMEMBERED:
            self._heads = list(self._walked({topic.name for topic in self.topics}))
        if self._heads is None:
            return self._walked(names)
        return (head for head in self._heads if head.topic in names)

    def _walked(self, names: Collection[str]) -> Iterator[Head]:
        for k, file in enumerate(self._files):
            chosen = {c.number: c for c in self._channels(file) if c.topic in names}
            if not chosen:
                continue
            for number, time, place, start in file.heads(chosen):
                channel = chosen[number]
                if start[:4] == packing.ZSTD:
                    start = self.read(k, place)
                yield Head(channel.topic, channel.msgtype, time, k, place, bytes(start[:HEAD]))

    def read(self, file: int, place: int) -> bytes:
        """Return the message that a Head tells of, b'' where it cannot be read any more."""
        data = self._files[file].read(place)
        try:
            return packing.message(data)
        except packing.TooLarge as error:
            note = f'{self._files[file].path.name}: {error}'
            self._large += 1
            if self._large > LARGE:
                raise PersemError(f'{note}; more than {LARGE} messages do') from None
            if note not in self._notes:
                self._notes.append(note)
            return b''
        # Zstandard's own exception, and whatever else damaged bytes lead to.
        except Exception:
            return b''

    def decode(self, data: bytes | memoryview, typename: str) -> Any:
        """Deserialize a message; BadMessage where its bytes are damaged."""
        return self._decode(data, typename)

    def _damaged(self) -> list[str]:
        """Return the notes about files that are damaged, as far as they have been read."""
        return self._damage + [
            f'{file.path.name} is {", ".join(file.damage)}: what is readable was used'
            for file in self._files if file.damage]

    @staticmethod
    def _channels(file: McapFile | SqliteFile) -> list[Channel]:
        """Return the channels of ROS 2 messages."""
        return [c for c in file.channels if c.encoding == 'cdr' and c.schema != 'ros1msg']

    def _topics(self) -> list[TopicInfo]:
        counts: Counter[tuple[str, str]] = Counter()
        for file in self._files:
            for c in self._channels(file):
                counts[c.topic, c.msgtype] += c.count
        return sorted(TopicInfo(*names, count) for names, count in counts.items())

    def _open(self, found: finding.Found) -> None:
        """Open the files of one recording; compare them with its metadata.yaml."""
        opened: list[McapFile | SqliteFile] = []
        for path in found.files:
            self._sizes += path.stat().st_size
            file = self._file(path)
            if file is not None:
                opened.append(file)
                self._files.append(file)
        if not opened:
            for path in found.files:
                finding.check_file(path)
            why = self._notes[-1] if self._notes else 'no file'
            raise PersemError(f'{found.path} cannot be read as a recording ({why}); '
                              f'{finding.WANTED}')
        self._notes += found.notes
        self._check_encodings(found.path, opened)
        self._compare(found, opened)

    def _file(self, path: Path) -> McapFile | SqliteFile | None:
        """Open one storage file, None where nothing in it can be read."""
        name = path.name
        with path.open('rb') as stream:
            head = stream.read(8)
        if head[:4] == packing.ZSTD:
            unpacked = self._unpack(path)
            if unpacked is None:
                return None
            path = unpacked
            with path.open('rb') as stream:
                head = stream.read(8)
        try:
            file = McapFile(path) if head == finding.MCAP else SqliteFile(path)
        except (OSError, ValueError, sqlite3.Error) as error:
            why = 'is empty' if not head else f'cannot be read ({_line(error)})'
            self._notes.append(f'{name} {why}')
            return None
        if not any(channel.count for channel in file.channels):
            file.close()
            self._notes.append(f'{name} holds no messages that can be read')
            return None
        if isinstance(file, SqliteFile) and file.journal:
            self._notes.append(f'{name}-wal holds {file.journal} messages that {name} does not '
                               'have yet (the recorder was interrupted?): they were read too')
        return file

    def _unpack(self, path: Path) -> Path | None:
        """Decompress a file into a folder that close() removes."""
        if self._unpacked is None:
            self._unpacked = TemporaryDirectory(prefix='persem-')
        self._packed.append(path)
        plain = path.with_suffix('') if path.suffix in packing.SUFFIXES else path
        target = Path(self._unpacked.name) / f'{len(self._packed)}' / plain.name
        target.parent.mkdir()
        try:
            packing.unpack_file(path, target)
        except PersemError:
            raise
        except Exception as error:      # Zstandard's own
            self._damage.append(f'{path.name} is cut off or damaged ({_line(error)}): what is '
                                'readable was used')
        return target if target.exists() and target.stat().st_size else None

    def _check_encodings(self, path: Path, opened: list[McapFile | SqliteFile]) -> None:
        """Refuse recordings of other systems; name topics that cannot be read among others."""
        strange = [c for file in opened for c in file.channels
                   if c not in self._channels(file)]
        if not strange:
            return
        forms = sorted({'ros1' if c.schema == 'ros1msg' else c.encoding for c in strange})
        topics = sorted({c.topic for c in strange})
        shown = ', '.join(topics[:SHOWN]) + (', …' if len(topics) > SHOWN else '')
        if any(self._channels(file) for file in opened):
            self._notes.append(f'{shown}: messages in {" and ".join(forms)} cannot be read and '
                               'were left out; expected ROS 2 messages (cdr)')
        elif forms == ['ros1']:
            raise PersemError(
                f'{path} holds ROS 1 messages ({shown}), expected ROS 2 ones; '
                f"'rosbags-convert --src NAME.bag --dst {quote(path.stem)}' makes a recording of "
                'the .bag that it came from')
        else:
            raise PersemError(
                f'{path} holds messages in {" and ".join(forms)} ({shown}), expected ROS 2 '
                'messages (cdr), as ros2 bag record writes them; images, depth and poses that '
                "lie in folders become a recording by 'persem convert frames FOLDER OUT'")

    def _compare(self, found: finding.Found, opened: list[McapFile | SqliteFile]) -> None:
        """Note what metadata.yaml promises and the files do not hold."""
        if found.missing:
            lost = sum(found.metadata.by_file.get(name, 0) for name in found.missing) \
                if found.metadata else 0
            few = ', '.join(found.missing[:SHOWN]) + (', …' if len(found.missing) > SHOWN else '')
            self._notes.append(
                f'{found.path.name}: {few}, listed in metadata.yaml, '
                f'{"is" if len(found.missing) == 1 else "are"} missing'
                f'{f" ({lost} messages)" if lost else ""}: copy it there for the whole recording')
        if found.metadata is None:
            return
        there: Counter[str] = Counter()     # also of what is not in cdr
        for file in opened:
            for channel in file.channels:
                there[channel.topic] += channel.count
        differ = [f'{topic} has {there[topic]} messages, not {count}'
                  for topic, count in sorted(found.metadata.counts.items())
                  if there[topic] != count]
        if differ:
            shown = ', '.join(differ[:SHOWN]) + (
                f', and {len(differ) - SHOWN} more topics' if len(differ) > SHOWN else '')
            self._notes.append(f'{found.path.name}: the files differ from what metadata.yaml '
                               f'counts: {shown}')

    def _note_twice(self, recordings: list[finding.Found], ends: list[int]) -> None:
        """Note images and poses that several recordings of one input have under one name."""
        holders: dict[str, list[str]] = {}
        for found, start, end in zip(recordings, [0, *ends], ends):
            for topic in {c.topic for file in self._files[start:end]
                          for c in self._channels(file)
                          if c.count and offset(c.msgtype) == FIRST}:
                holders.setdefault(topic, []).append(found.path.name)
        for topic, names in sorted(holders.items()):
            if len(names) > 1:
                self._notes.append(f'{topic} is in {" and in ".join(names)}: of messages with one '
                                   f'stamp that of {names[0]} is used')


def _line(error: Exception) -> str:
    """Return an exception as one line."""
    return ' '.join(str(error).split()) or type(error).__name__
