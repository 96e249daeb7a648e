"""Writing rosbag2 recordings (mcap or sqlite3) without ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import functools
from pathlib import Path
import shutil
import sqlite3
import tempfile
from types import TracebackType
from typing import Any, Literal, ParamSpec, TypeVar, Union

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.outputs.recording.messages import MessageFactory
from persem_ros.outputs.recording.target import check_target
from rosbags.interfaces import (
    Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

# Of metadata.yaml. Version 9 only spells QoS profiles in another way, which ROS 2 before Jazzy
# cannot open; Humble reads 8, and nothing is lost.
VERSION: Literal[8] = 8
STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
FILE_ERRORS = (OSError, sqlite3.Error)

Data = Union[bytes, memoryview]
Arguments = ParamSpec('Arguments')
Result = TypeVar('Result')


class RecordingWriter:
    """
    A rosbag2 recording that appears under its name only when it is whole.

    Topic names get a leading slash where they have none. The log time of a message is its
    stamp. A stamp of None (legends, static transforms) means "when the recording starts": the
    header has stamp 0, the log time is that of the first message with a stamp.

    With sqlite3 all calls must come from the thread that entered the context.

    Parameters
    ----------
    path : str or Path
        The recording's folder.
    storage : str
        'mcap' or 'sqlite3'.
    compress : bool
        Zstandard: whole chunks in mcap, single messages in sqlite3.
    force : bool
        Replace a recording of that name that holds no other files; other folders are never
        replaced.

    Raises
    ------
    PersemError
        When the folder is in the way, cannot be written, or the disk is full.

    """

    def __init__(self, path: Path | str, storage: str = 'mcap', compress: bool = False,
                 force: bool = False) -> None:
        if storage not in STORAGES:
            raise PersemError(f'storage {storage!r}: expected one of {", ".join(STORAGES)}')
        self.path = Path(path)
        self.typestore = _types()
        self.make = MessageFactory(self.typestore.types)
        self._storage, self._compress, self._force = storage, compress, force
        self._connections: dict[tuple[str, str], Connection] = {}
        # Messages without a stamp, until the recording starts.
        self._waiting: list[tuple[Connection, Data]] = []
        self._work: Path | None = None
        self._writer: Writer | None = None
        check_target(self.path, force)

    def __enter__(self) -> RecordingWriter:
        target = self.path.absolute()
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            # Built under its final name inside a hidden folder: rosbag2 names files after it.
            self._work = Path(tempfile.mkdtemp('.partial', f'.{target.name}.', target.parent))
            writer = self._writer = Writer(self._work / target.name, version=VERSION,
                                           storage_plugin=STORAGES[self._storage])
            if self._compress:
                writer.set_compression(
                    CompressionMode.STORAGE if self._storage == 'mcap'
                    else CompressionMode.MESSAGE, CompressionFormat.ZSTD)
            writer.open()
        except FILE_ERRORS as error:
            self._discard()
            raise self._refusal(error) from error
        return self

    def __exit__(
            self, kind: type[BaseException] | None, value: BaseException | None,
            traceback: TracebackType | None) -> None:
        if kind is not None:
            self._discard()
            return
        writer, work = self._opened()
        try:
            self._start(0)
            writer.close()
            self._move(work)
        except BaseException as error:
            self._discard()
            if isinstance(error, FILE_ERRORS):
                raise self._refusal(error) from error
            raise
        shutil.rmtree(work, ignore_errors=True)

    def _opened(self) -> tuple[Writer, Path]:
        """Return the writer and its hidden folder, which are there once the context is entered."""
        assert self._writer is not None and self._work is not None, 'write inside of "with"'
        return self._writer, self._work

    def image(
            self, topic: str, stamp: int, frame_id: str, array: NDArray[Any], encoding: str
    ) -> None:
        """Write a sensor_msgs/Image of an (H, W) or (H, W, 3) array."""
        message = self.make.image(stamp, frame_id, array, encoding)
        self.message(topic, stamp, 'sensor_msgs/msg/Image', message)

    def compressed(
            self, topic: str, stamp: int, frame_id: str, image_format: str, data: bytes) -> None:
        """Write a sensor_msgs/CompressedImage of encoded bytes."""
        message = self.make.compressed(stamp, frame_id, image_format, data)
        self.message(topic, stamp, 'sensor_msgs/msg/CompressedImage', message)

    def camera_info(self, topic: str, stamp: int, frame_id: str, width: int, height: int,
                    K: NDArray[np.float64], D: NDArray[np.float64] | Sequence[float] = (),
                    model: str = 'plumb_bob', P: NDArray[np.float64] | None = None) -> None:
        """Write a sensor_msgs/CameraInfo; P is [K 0] where none is given."""
        message = self.make.camera_info(stamp, frame_id, width, height, K, D, model, P)
        self.message(topic, stamp, 'sensor_msgs/msg/CameraInfo', message)

    def pose(self, topic: str, stamp: int, frame_id: str, T: NDArray[np.float64],
             kind: str = 'PoseStamped', child_frame: str = '') -> None:
        """Write a pose, a 4x4 matrix from the posed frame to *frame_id*, as a message *kind*."""
        self.message(topic, stamp, *self.make.pose(stamp, frame_id, T, kind, child_frame))

    def trajectory(self, topic: str, stamp: int, frame_id: str,
                   poses: list[tuple[int, NDArray[np.float64]]]) -> None:
        """Write a nav_msgs/Path of (stamp, 4x4 matrix from what is posed to *frame_id*)."""
        self.message(topic, stamp, 'nav_msgs/msg/Path', self.make.path(stamp, frame_id, poses))

    def tf(self, stamp: int | None, parent: str, child: str, T: NDArray[np.float64],
           static: bool = False) -> None:
        """Write a transform from *child* to *parent* to /tf, or latched to /tf_static."""
        transform = self.make.transform(stamp or 0, parent, child, T)
        self.message('/tf_static' if static else '/tf', stamp, 'tf2_msgs/msg/TFMessage',
                     self.make.make('tf2_msgs/msg/TFMessage', [transform]), latched=static)

    def cloud(self, topic: str, stamp: int, frame_id: str, points: NDArray[np.void],
              latched: bool = False) -> None:
        """Write a sensor_msgs/PointCloud2 of a structured array."""
        message = self.make.cloud(stamp, frame_id, points)
        self.message(topic, stamp, 'sensor_msgs/msg/PointCloud2', message, latched)

    def text(self, topic: str, text: str, latched: bool = False,
             stamp: int | None = None) -> None:
        """Write a std_msgs/String."""
        message = self.make.make('std_msgs/msg/String', text)
        self.message(topic, stamp, 'std_msgs/msg/String', message, latched)

    def message(self, topic: str, stamp: int | None, typename: str, message: Any,
                latched: bool = False) -> None:
        """
        Write any message of the type *typename* at log time *stamp*.

        A topic is latched (reliable, transient local) when its first message is.

        """
        data = self.typestore.serialize_cdr(message, typename)
        connection = self._connection(topic, typename, latched)
        if stamp is None:
            self._waiting.append((connection, data))
            return
        self._start(stamp)
        self._write(connection, stamp, data)

    def _connection(self, topic: str, typename: str, latched: bool) -> Connection:
        topic = topic if topic.startswith('/') else f'/{topic}'
        if (topic, typename) not in self._connections:
            depth = 100 if topic in ('/tf', '/tf_static') else 1 if latched else 10
            self._connections[topic, typename] = self._guarded(
                self._opened()[0].add_connection, topic, typename, typestore=self.typestore,
                offered_qos_profiles=[_qos(depth, latched)])
        return self._connections[topic, typename]

    def _start(self, stamp: int) -> None:
        """Write what waited for the first stamp."""
        waiting, self._waiting = self._waiting, []
        for connection, data in waiting:
            self._write(connection, stamp, data)

    def _write(self, connection: Connection, stamp: int, data: Data) -> None:
        self._guarded(self._opened()[0].write, connection, int(stamp), data)

    def _guarded(self, function: Callable[Arguments, Result], *args: Arguments.args,
                 **kwargs: Arguments.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except FILE_ERRORS as error:
            raise self._refusal(error) from error

    def _refusal(self, error: BaseException) -> PersemError:
        reason = getattr(error, 'strerror', None) or error
        return PersemError(f'cannot write {self.path}: {reason}')

    def _move(self, work: Path) -> None:
        """Put the finished folder in its place; the old one goes only when it is there."""
        target = self.path.absolute()
        check_target(target, self._force)
        old = work / f'{target.name}.replaced'
        try:
            if target.exists():
                target.rename(old)
            (work / target.name).rename(target)
        except BaseException:       # an interrupt, too: what goes wrong here keeps the old one
            if old.exists() and not target.exists():
                old.rename(target)
            raise

    def _discard(self) -> None:
        if self._writer is not None:
            with suppress(Exception):       # the error that led here is the one to report
                self._writer.abort()
        if self._work is not None:
            shutil.rmtree(self._work, ignore_errors=True)


@functools.cache
def _types() -> Typestore:
    """Return the types, once a process: it compiles how each of them is written."""
    return get_typestore(Stores.ROS2_JAZZY)


def _qos(depth: int, latched: bool) -> Qos:
    unset = QosTime(0, 0)
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    return Qos(QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE, durability, unset, unset,
               QosLiveliness.AUTOMATIC, unset, False)
