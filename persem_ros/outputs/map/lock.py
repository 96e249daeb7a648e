"""One writer at a time: a lock file beside a map file, which names who holds it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import sys

from persem_ros.errors import PersemError


class WriterLock:
    """
    The right to write a map file; it ends with close(), or with the process however that ends.

    Not a lock on the file itself: SQLite's own would be lost when that is closed.

    Parameters
    ----------
    path : Path
        The map file.

    Raises
    ------
    PersemError
        When another process, or another part of this one, has it.

    """

    def __init__(self, path: Path) -> None:
        self._path = path.with_name(f'.{path.name}.lock')
        while True:
            try:
                self._handle = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
                                       | os.O_NOFOLLOW, 0o644)  # a link leads to others' files
            except OSError as error:
                raise PersemError(f'{path} cannot be written, nor can its folder '
                                  f'({error.strerror}); copy it elsewhere first') from error
            try:
                fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                holder = os.read(self._handle, 200).decode('utf-8', 'replace').strip()
                os.close(self._handle)
                raise PersemError(f'{path} is being written by {holder or "another process"}; '
                                  'end that first, or give another map.path') from None
            if self._same():
                break
            os.close(self._handle)      # whoever held it has just removed it
        os.ftruncate(self._handle, 0)
        name = Path(sys.argv[0] or 'python').name
        os.write(self._handle, f'{name} (process {os.getpid()})\n'.encode())

    def close(self) -> None:
        """Give the right back."""
        if self._same():
            os.unlink(self._path)
        os.close(self._handle)

    def _same(self) -> bool:
        """Return whether the lock file is still the one that was opened."""
        try:
            return os.path.samestat(os.stat(self._path), os.fstat(self._handle))
        except OSError:
            return False
