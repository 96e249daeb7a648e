"""One input as a stream of raw messages: a recording or several, whatever their storage."""

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.recording import finding, packing
from persem_ros.inputs.recording.stamps import HEAD
from persem_ros.inputs.recording.storage import channels_of, Storage

LARGE = 3               # messages that unpack to too much; of more nothing is read
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
        self._storage = Storage()
        self._large = 0
        self._heads: list[Head] | None = None       # of all messages, where they are few
        recordings = [finding.found(part) for part in finding.split(path)]
        self.name = '+'.join(found.path.stem if found.path.is_file() else
                             found.path.resolve().name for found in recordings)
        try:
            for found in recordings:
                self._storage.add(found)
            self.topics = self._topics()
            self._storage.note_twice()
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
        self._storage.close()

    @property
    def notes(self) -> list[str]:
        """Return what was wrong with the recording and did not prevent its use: sentences."""
        return list(dict.fromkeys(self._storage.notes + self._storage.damaged()))

    @property
    def size(self) -> int:
        """Bytes on disk."""
        return self._storage.size

    @property
    def storage(self) -> str:
        """Return the kinds of files."""
        return self._storage.kinds

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
        for k, file in enumerate(self._storage.files):
            chosen = {c.number: c for c in channels_of(file) if c.topic in names}
            if not chosen:
                continue
            for number, time, place, start in file.heads(chosen):
                channel = chosen[number]
                if start[:4] == packing.ZSTD:
                    start = self.read(k, place)
                yield Head(channel.topic, channel.msgtype, time, k, place, bytes(start[:HEAD]))

    def read(self, file: int, place: int) -> bytes:
        """Return the message that a Head tells of, b'' where it cannot be read any more."""
        data = self._storage.files[file].read(place)
        try:
            return packing.message(data)
        except packing.TooLarge as error:
            note = f'{self._storage.files[file].path.name}: {error}'
            self._large += 1
            if self._large > LARGE:
                raise PersemError(f'{note}; more than {LARGE} messages do') from None
            if note not in self._storage.notes:
                self._storage.notes.append(note)
            return b''
        # Zstandard's own exception, and whatever else damaged bytes lead to.
        except Exception:
            return b''

    def decode(self, data: bytes | memoryview, typename: str) -> Any:
        """Deserialize a message; BadMessage where its bytes are damaged."""
        return self._decode(data, typename)

    def _topics(self) -> list[TopicInfo]:
        counts: Counter[tuple[str, str]] = Counter()
        for file in self._storage.files:
            for c in channels_of(file):
                counts[c.topic, c.msgtype] += c.count
        return sorted(TopicInfo(*names, count) for names, count in counts.items())
