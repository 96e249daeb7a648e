"""The file that map.path names: which one it is, whether it can be written, its second name."""

from __future__ import annotations

import os
from pathlib import Path
import tempfile
import time

from persem_ros.errors import PersemError
from persem_ros.settings.config import Config


def path_of(config: Config) -> Path:
    """Return the absolute path of map.path; refuse an empty one."""
    if not config.map.path:
        raise PersemError('map.path is empty; name a file: ros2 param set <node> map.path '
                          '/absolute/path/map.persem')
    return Path(config.map.path).expanduser().absolute()


def unusable(config: Config) -> str:
    """Return why map.save could not be done at the end, '' where it can."""
    if not config.map.save:
        return ''
    if not config.map.path:
        return 'map.save needs a file: --set map.path=/absolute/path/map.persem'
    problem = not_writable(path_of(config))
    return f'{problem}; map.save needs a file that can be written: --set map.path=' \
           '/absolute/path/map.persem' if problem else ''


def not_writable(path: Path) -> str:
    """Return why a file could not be written, '' where it can be; nothing is left behind."""
    if path.is_dir():
        return f'{path} is a folder'
    folder = path.parent
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        return f'{path} cannot be written: {folder} is not a folder'
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ''
    except OSError as error:
        return f'{path} cannot be written ({folder}: {error.strerror or error})'


def identity(path: Path) -> tuple[int, ...] | None:
    """Return which file *path* is and in which state, None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def second_name(path: Path) -> Path:
    """
    Give the file *path* a second name with the date; return it.

    The file keeps its own name until another takes it, so that it is never without one.

    """
    name = f'{path.name}.{time.strftime("%Y-%m-%dT%H-%M-%S")}'
    aside, number = path.with_name(name), 1
    while os.path.lexists(aside):
        number += 1
        aside = path.with_name(f'{name}_{number}')
    try:
        try:
            os.link(path, aside)
        except OSError:         # a file system without second names
            os.rename(path, aside)
    except OSError as error:
        raise PersemError(f'{path} cannot be moved aside to {aside.name} '
                          f'({error.strerror or error}); nothing was saved') from error
    return aside


def take_back(aside: Path, path: Path) -> None:
    """Undo `second_name`."""
    if path.exists():
        aside.unlink()
    else:
        os.rename(aside, path)
