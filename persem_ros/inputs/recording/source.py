"""A rosbag2 recording as a stream of raw messages, whatever its storage, name or damage."""

from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from persem_ros.errors import PersemError
from persem_ros.inputs.decode.serialized import Decoder
from persem_ros.inputs.recording import salvage
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

IMAGES = ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.pgm', '.npy', '.exr')
LOOKED_AT = 10_000      # files, to see whether there are images
SUFFIXES = ('.mcap', '.db3')
ZSTD = b'\x28\xb5\x2f\xfd'      # a message of a recording with message compression, whose
#                               metadata.yaml (which would say so) was not given or is lost


class TopicInfo(NamedTuple):
    """A topic of a recording; a topic with two types is two of them."""

    name: str
    msgtype: str        # 'sensor_msgs/msg/Image'
    count: int
    latched: bool = False


class Source:
    """
    An open recording.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder, or a single .mcap or .db3 file.

    Attributes
    ----------
    path : Path
        The same.
    storage : str
        'mcap' or 'sqlite3', with the kind of compression where it is known.
    topics : list of TopicInfo
        By name.
    notes : list of str
        What was wrong with the recording and did not prevent its use.

    Raises
    ------
    PersemError
        Where there is no recording, or nothing in it can be read.

    """

    def __init__(self, path):
        """Open the recording."""
        self.path = Path(path)
        self.notes = []
        self._decode = Decoder()
        self._readers = self._opened()
        found = {}
        for reader in self._readers:
            for c in reader.connections:
                latched = any(qos.durability == QosDurability.TRANSIENT_LOCAL
                              for qos in c.ext.offered_qos_profiles)
                count = found[c.topic, c.msgtype].count if (c.topic, c.msgtype) in found else 0
                found[c.topic, c.msgtype] = TopicInfo(c.topic, c.msgtype, count + c.msgcount,
                                                      latched)
        self.topics = sorted(found.values())

    def __enter__(self):
        """Return the open recording."""
        return self

    def __exit__(self, *_):
        """Close the recording."""
        self.close()

    def close(self):
        """Close the files."""
        for reader in self._readers:
            with suppress(Exception):   # nothing was written, so nothing can be lost
                reader.close()
        self._readers = []

    @property
    def size(self):
        """Bytes on disk."""
        files = [self.path] if self.path.is_file() else self._files()
        return sum(file.stat().st_size for file in files)

    def messages(self, names):
        """
        Read messages in the order of the recording.

        Parameters
        ----------
        names : collection of str
            Topics.

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
        for reader in self._readers:
            chosen = [c for c in reader.connections if c.topic in names]
            if not chosen:
                continue
            try:
                for connection, time, data in reader.messages(chosen):
                    if data[:4] == ZSTD:
                        data = salvage.DECOMPRESSORS['zstd'](data, 0)
                    yield connection.topic, connection.msgtype, time, data
            # Damaged bytes make the parsers below raise anything from KeyError to zstd's own.
            except Exception as error:
                self._note(f'{self.path.name} is damaged, what follows the damage was not read '
                           f'({_line(error)})')
            self._note_damage(reader)

    def decode(self, data, typename):
        """Deserialize a message; BadMessage where its bytes are damaged."""
        return self._decode(data, typename)

    def _opened(self):
        path = self.path
        if not path.exists():
            raise PersemError(f'{path} does not exist; expected a rosbag2 folder, .mcap or .db3 '
                              'file')
        if path.suffix == '.bag' and path.is_file():
            raise PersemError(f"{path} is a ROS 1 recording, expected a rosbag2 one; 'rosbags-"
                              f"convert --src {path} --dst {path.stem}' makes one")
        whole = path / 'metadata.yaml'
        if path.is_file() and path.suffix not in SUFFIXES or \
                path.is_dir() and not whole.exists() and not self._files():
            what = 'folder without metadata.yaml, .mcap or .db3 files' if path.is_dir() \
                else f'file of type {path.suffix!r}'
            raise PersemError(f'{path} is no recording: it is a {what}; expected a rosbag2 '
                              f'folder, .mcap or .db3 file{_to_make_one(path)}')
        try:
            reader = Reader(path)
            reader.open()
        # As in messages(): whatever a damaged file makes the parsers raise.
        except Exception as error:
            return self._salvaged(error)
        self.storage = _storage(self._files())
        if reader.compression_mode:
            self.storage += f', {reader.compression_mode} compression {reader.compression_format}'
        return [reader]

    def _salvaged(self, error):
        """Open the files one by one, each as far as it can be read."""
        readers = []
        for file in self._files():
            reader = salvage.opened(file)
            if reader is None:
                self._note(f'{file.name} cannot be read')
                continue
            self._note_damage(reader)
            readers.append(reader)
        if not readers:
            raise PersemError(f'{self.path} cannot be read as a recording ({_line(error)}); '
                              'expected a rosbag2 folder, .mcap or .db3 file')
        if self.path.is_dir() and not (self.path / 'metadata.yaml').exists():
            self._note(f'{self.path.name} has no metadata.yaml (the recorder was interrupted?): '
                       'its files were read without')
        self.storage = _storage(self._files())
        return readers

    def _files(self):
        """Return the storage files in order: name_2 before name_10."""
        if self.path.is_file():
            return [self.path]
        files = [f for f in self.path.iterdir()
                 if f.suffix in SUFFIXES or f.suffixes[-2:-1] and f.suffixes[-2] in SUFFIXES]
        return sorted(files, key=lambda f: (len(f.name), f.name))

    def _note_damage(self, reader):
        damage = getattr(reader, 'damage', '')
        if damage:
            self._note(f'{reader.path.name} is {damage}: what is readable was used')

    def _note(self, text):
        if text not in self.notes:
            self.notes.append(text)


def _storage(files):
    return 'mcap' if any('.mcap' in file.name for file in files) else 'sqlite3'


def _to_make_one(path):
    """Return what to type where a folder, or one in it, holds images; '' where none does."""
    if not path.is_dir():
        return ''
    with suppress(OSError):
        files = chain(path.iterdir(), path.glob('*/*'), path.glob('*/*/*'))
        if any(file.suffix.lower() in IMAGES for file in islice(files, LOOKED_AT)):
            return f'; to make one of its images: persem convert frames {quote(str(path))} OUT'
    return ''


def _line(error):
    """Return an exception as one line."""
    return ' '.join(str(error).split()) or type(error).__name__
