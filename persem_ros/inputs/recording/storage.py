"""The storage files of an input, open: what lies in them, what is wrong with them."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from pathlib import Path
from shlex import quote
import sqlite3
from tempfile import TemporaryDirectory
from typing import Union

from persem_ros.errors import PersemError
from persem_ros.inputs.recording import finding, packing
from persem_ros.inputs.recording.channels import Channel
from persem_ros.inputs.recording.mcap_file import McapFile
from persem_ros.inputs.recording.sqlite_file import SqliteFile
from persem_ros.inputs.recording.stamps import FIRST, offset

SHOWN = 4               # topics in a note
StorageFile = Union[McapFile, SqliteFile]


class Storage:
    """
    Opens the files of recordings, one recording after the other.

    Attributes
    ----------
    files : list of McapFile and SqliteFile
        In the order of the recordings; empty once it is closed.
    size : int
        Bytes on disk.
    notes : list of str
        What was wrong with them when they were opened, sentences.

    """

    def __init__(self) -> None:
        """Open nothing yet."""
        self.files: list[StorageFile] = []
        self.size = 0
        self.notes: list[str] = []
        self._damage: list[str] = []
        self._unpacked: TemporaryDirectory[str] | None = None
        self._packed: list[Path] = []
        self._recordings: list[tuple[str, int]] = []    # name, and where its files end

    @property
    def kinds(self) -> str:
        """Return 'mcap' or 'sqlite3' or both, with the kind of compression where there is one."""
        kinds = {'mcap' if isinstance(file, McapFile) else 'sqlite3' for file in self.files}
        return ' and '.join(sorted(kinds)) + (', compressed files' if self._packed else '')

    def damaged(self) -> list[str]:
        """Return the notes about files that are damaged, as far as they have been read."""
        return self._damage + [
            f'{file.path.name} is {", ".join(file.damage)}: what is readable was used'
            for file in self.files if file.damage]

    def close(self) -> None:
        """Close the files; what was found damaged stays known."""
        self._damage = self.damaged()
        for file in self.files:
            with suppress(OSError, sqlite3.Error):  # nothing was written, nothing can be lost
                file.close()
        self.files = []
        if self._unpacked is not None:
            self._unpacked.cleanup()
            self._unpacked = None

    def add(self, found: finding.Found) -> None:
        """
        Open the files of one recording; compare them with its metadata.yaml.

        Raises
        ------
        PersemError
            Where none of them can be read, or they are another system's.

        """
        opened: list[StorageFile] = []
        for path in found.files:
            self.size += path.stat().st_size
            file = self._file(path)
            if file is not None:
                opened.append(file)
                self.files.append(file)
        if not opened:
            for path in found.files:
                finding.check_file(path)
            why = self.notes[-1] if self.notes else 'no file'
            raise PersemError(f'{found.path} cannot be read as a recording ({why}); '
                              f'{finding.WANTED}')
        self.notes += found.notes
        self._check_encodings(found.path, opened)
        self._compare(found, opened)
        self._recordings.append((found.path.name, len(self.files)))

    def _file(self, path: Path) -> StorageFile | None:
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
            self.notes.append(f'{name} {why}')
            return None
        if not any(channel.count for channel in file.channels):
            file.close()
            self.notes.append(f'{name} holds no messages that can be read')
            return None
        if isinstance(file, SqliteFile) and file.journal:
            self.notes.append(f'{name}-wal holds {file.journal} messages that {name} does not '
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

    def _check_encodings(self, path: Path, opened: list[StorageFile]) -> None:
        """Refuse recordings of other systems; name topics that cannot be read among others."""
        strange = [c for file in opened for c in file.channels
                   if c not in channels_of(file)]
        if not strange:
            return
        forms = sorted({'ros1' if c.schema == 'ros1msg' else c.encoding for c in strange})
        topics = sorted({c.topic for c in strange})
        shown = ', '.join(topics[:SHOWN]) + (', …' if len(topics) > SHOWN else '')
        if any(channels_of(file) for file in opened):
            self.notes.append(f'{shown}: messages in {" and ".join(forms)} cannot be read and '
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

    def _compare(self, found: finding.Found, opened: list[StorageFile]) -> None:
        """Note what metadata.yaml promises and the files do not hold."""
        if found.missing:
            lost = sum(found.metadata.by_file.get(name, 0) for name in found.missing) \
                if found.metadata else 0
            few = ', '.join(found.missing[:SHOWN]) + (', …' if len(found.missing) > SHOWN else '')
            self.notes.append(
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
            self.notes.append(f'{found.path.name}: the files differ from what metadata.yaml '
                              f'counts: {shown}')

    def note_twice(self) -> None:
        """Note images and poses that several recordings of one input have under one name."""
        holders: dict[str, list[str]] = {}
        start = 0
        for name, end in self._recordings:
            for topic in {c.topic for file in self.files[start:end] for c in channels_of(file)
                          if c.count and offset(c.msgtype) == FIRST}:
                holders.setdefault(topic, []).append(name)
            start = end
        for topic, names in sorted(holders.items()):
            if len(names) > 1:
                self.notes.append(f'{topic} is in {" and in ".join(names)}: of messages with one '
                                  f'stamp that of {names[0]} is used')


def channels_of(file: StorageFile) -> list[Channel]:
    """Return the channels of ROS 2 messages."""
    return [c for c in file.channels if c.encoding == 'cdr' and c.schema != 'ros1msg']


def _line(error: Exception) -> str:
    """Return an exception as one line."""
    return ' '.join(str(error).split()) or type(error).__name__
