"""Files that appear under their name only when they are whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
import json
import os
from pathlib import Path
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """
    Give a temporary name beside *path*; when the block ends well, that file takes its place.

    Whatever happens, *path* is the old file or the new one, never a part of it: the new one is
    written to disk (fsync) before the name changes hands, which the file system does at once.

    Parameters
    ----------
    path : str or Path
        The file to write; its folder is made where it is missing.

    Yields
    ------
    Path
        The name to write to, in the same folder; removed if the block fails.

    Raises
    ------
    PersemError
        When the folder cannot be written or the disk is full; the old file is untouched.

    """
    path = Path(os.path.abspath(path))
    work = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise PersemError(f'cannot write {path}: it is a folder; give the name of a file')
        _remove_left_behind(path)
        yield work
        _sync(work)
        os.replace(work, path)
        _sync(path.parent)
    except OSError as error:
        raise PersemError(f'cannot write {path}: {error.strerror or error}') from error
    finally:
        with suppress(OSError):
            work.unlink()


def write_bytes(path: Path | str, *parts: bytes | memoryview | NDArray[Any]) -> None:
    """Write *parts* one after the other as the file *path*, whole or not at all."""
    with replacing(path) as work:
        with open(work, 'wb') as out:
            for part in parts:
                out.write(part if isinstance(part, (bytes, memoryview)) else part.data)


def write_text(path: Path, text: str) -> None:
    """Write *text* as the file *path* (UTF-8), whole or not at all."""
    # Names of files that the locale cannot decode go out as the bytes that they are.
    write_bytes(path, text.encode('utf-8', 'surrogateescape'))


def write_json(path: Path, value: dict[str, Any]) -> None:
    """
    Write *value* as JSON, whole or not at all; None becomes null.

    Raises
    ------
    ValueError
        For NaN and infinity, which JSON does not have.

    """
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + '\n')


def _sync(path: Path) -> None:
    """Have the system write a file's or folder's content to the disk now."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove_left_behind(path: Path) -> None:
    """Remove what writers of *path* left that were killed."""
    for left in path.parent.glob(f'.{escape(path.name)}.*.partial*'):
        pid = left.name[len(path.name) + 2:].partition('.')[0]
        if pid.isdigit() and not Path('/proc', pid).exists() and Path('/proc').is_dir():
            with suppress(OSError):
                left.unlink()
