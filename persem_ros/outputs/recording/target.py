"""The folder that a new recording gets: free, or an earlier recording and nothing else."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard import yaml_text

if TYPE_CHECKING:
    from pathlib import Path

METADATA = 'metadata.yaml'
NAMED = 5       # files in a refusal


def check_target(path: Path, force: bool = False) -> None:
    """
    Refuse a path that a new recording cannot have.

    Parameters
    ----------
    path : Path
        The recording's folder.
    force : bool
        Allow a recording that holds nothing but the files of its metadata.yaml.

    Raises
    ------
    PersemError
        For a file; for a folder that is not empty, unless *force* allows it.

    """
    try:
        if not path.exists():
            return
        if not path.is_dir():
            raise PersemError(f'{path} is a file; give the name of a new folder')
        entries = sorted(path.iterdir())
        if not entries:
            return
        if not force:
            raise PersemError(f'{path} is not empty; give another name, or --force to replace it')
        own = _files_of_recording(path)
        others = [f'{entry.name}/' if entry.is_dir() else entry.name for entry in entries
                  if entry.name not in own or entry.is_dir()]
    except OSError as error:
        raise PersemError(f'cannot write {path}: {error.strerror}') from error
    if own and others:
        shown = ', '.join(others[:NAMED]) + (', …' if len(others) > NAMED else '')
        verb = 'is' if len(others) == 1 else 'are'
        raise PersemError(f'{path} also holds {shown}, which {verb} not of the recording; --force '
                          f'does not delete {"it" if len(others) == 1 else "them"}; give another '
                          'name')
    if not own:
        raise PersemError(f'{path} is not empty and not a recording (no {METADATA} that lists its '
                          'files), --force does not replace it; give another name')


def _files_of_recording(path: Path) -> set[str]:
    """Return the names of a recording's files, its metadata among them; none for another one."""
    try:
        with open(path / METADATA, encoding='utf-8') as file:
            content = yaml_text.load(file.read(yaml_text.RECORDING.size + 1), METADATA,
                                     yaml_text.RECORDING)
        listed = content['rosbag2_bagfile_information']['relative_file_paths']
    except (FileNotFoundError, IsADirectoryError, UnicodeDecodeError, PersemError, KeyError,
            TypeError):
        return set()
    if not isinstance(listed, list) or not listed:
        return set()
    # The first versions of rosbag2 put the folder's name before the file's.
    names = [PurePosixPath(str(name)) for name in listed]
    return {METADATA} | {name.name for name in names if str(name.parent) in ('.', path.name)}
