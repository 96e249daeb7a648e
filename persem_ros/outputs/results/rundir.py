"""A run is a folder: what lies in it, built beside the old files and swapped when it is whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, ExitStack, suppress
import fcntl
import os
from pathlib import Path
import shutil

from persem_ros.errors import PersemError
from persem_ros.outputs.recording.target import check_target

FILES = ('map.ply', 'map.persem', 'refined', 'metrics.json', 'config.yaml', 'timing.json',
         'report.html')
REFINED = 'refined'         # of them a folder, a recording
WORK = '.persem-run.'       # + process id + '.partial': what is being built
OLD, DONE = 'replaced', 'done'      # in it: the old files, while they are swapped and after


@contextmanager
def building(path: Path | str, force: bool = False,
             keep: Iterable[Path | str] = ()) -> Iterator[Path]:
    """
    Give a folder to build a run in; its files take their place in *path* when the block ends well.

    The old files stay until the new ones are whole, and come back if anything goes wrong: a run
    that fails or is interrupted leaves the folder as it was. Nothing but the files that a run
    writes is ever moved or removed, and a folder of such a name is none of them.

    Parameters
    ----------
    path : str or Path
        The folder of a run.
    force : bool
        Allow a folder that is not empty.
    keep : iterable of str or Path
        What the run itself reads, and must not replace; '' for nothing.

    Yields
    ------
    Path
        The folder to write to, inside *path*: the same file system.

    Raises
    ------
    PersemError
        When it is not empty and *force* is not set, when it is a file or cannot be written, when
        it holds somebody else's folder of the name of a file of ours, when another run writes
        there, when an input lies among the files that *force* would replace or is a recording
        that *path* lies in.

    """
    path = Path(path)
    check_inputs(path, keep)
    missing = [folder for folder in (path, *path.parents) if not os.path.lexists(folder)]
    with ExitStack() as stack:
        stack.callback(_remove_empty, missing)
        try:
            path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(path))
            _recover(path)
            if any(path.iterdir()) and not force:
                raise PersemError(f'{path} is not empty; give another folder with --out, or '
                                  '--force to replace the files of an earlier run')
            _check_names(path)
            work = path / f'{WORK}{os.getpid()}.partial'
            work.mkdir()
        except FileExistsError:
            raise PersemError(f'{path} is a file; give the name of a folder with --out') from None
        except OSError as error:
            raise PersemError(f'cannot write to {path}: {error.strerror}') from error
        stack.callback(shutil.rmtree, work, ignore_errors=True)
        try:
            yield work
            _swap(path, work)
        except PersemError as error:    # what cannot be written has its name in the folder
            raise PersemError(str(error).replace(f'/{work.name}', '')) from error
        except OSError as error:
            raise PersemError(f'cannot write to {path}: {error.strerror or error}') from error


def check_extra(path: Path | str, option: str, force: bool,
                keep: Iterable[Path | str] = ()) -> None:
    """
    Refuse a file that an option names besides the run's folder.

    Parameters
    ----------
    path : str or Path
        The file.
    option : str
        '--figure', for the refusal.
    force : bool
        Allow a file that exists.
    keep : iterable of str or Path
        Inputs and outputs of the run, which it must not replace.

    """
    path = Path(path)
    for name in map(Path, filter(None, map(str, keep))):
        if name.resolve() in (path.resolve(), *path.resolve().parents):
            raise PersemError(f'{option} {path} would replace {name} or a part of it; give '
                              'another name')
    if path.is_dir():
        raise PersemError(f'{option} {path} is a folder; give the name of a file')
    if os.path.lexists(path) and not force:
        raise PersemError(f'{path} exists; give another name with {option}, or --force to '
                          'replace it')


def check_inputs(path: Path, keep: Iterable[Path | str]) -> None:
    """Refuse a folder that is an input, lies in one, or holds one among the files of a run."""
    target = path.resolve()
    for name in filter(None, map(str, keep)):
        source = Path(name).resolve()
        if source == target or source.is_dir() and source in target.parents:
            raise PersemError(f'{path} is {name}, which this run reads, or lies in it; give '
                              'another folder with --out')
        if target in source.parents and _is_ours(_first(path, name)):
            raise PersemError(f'{name} lies in {path}, whose files this run would replace; give '
                              'another folder with --out')


def _check_names(path: Path) -> None:
    """Refuse a folder in which somebody else's folder has the name of a file of a run."""
    for name in FILES:
        entry = path / name
        if name != REFINED and entry.is_dir() and not entry.is_symlink():
            raise PersemError(f'{entry} is a folder, not the file of an earlier run; --force does '
                              'not replace it; give another folder with --out')
    if not (path / REFINED).is_symlink():
        check_target(path / REFINED, force=True)


@contextmanager
def locked(path: Path) -> Iterator[Path]:
    """Give a folder, held for this process; the system lets go of it however that ends."""
    handle = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PersemError(f'another run is writing into {path}; wait for its end, or give '
                              'another folder with --out') from None
        except OSError:         # a file system without locks
            pass
        yield path
    finally:
        os.close(handle)


def _swap(path: Path, work: Path) -> None:
    """Put new files in the place of old ones: two renames each, all undone if one fails."""
    _check_names(path)
    old = work / OLD
    old.mkdir()
    moved: list[tuple[Path, Path]] = []
    try:
        for name in FILES:
            if os.path.lexists(path / name):
                moved.append((path / name, old / name))
                os.rename(*moved[-1])
            if os.path.lexists(work / name):
                moved.append((work / name, path / name))
                os.rename(*moved[-1])
        old.rename(work / DONE)
    except BaseException:       # an interrupt, too
        for source, target in reversed(moved):
            if os.path.lexists(target) and not os.path.lexists(source):
                os.rename(target, source)
        raise


def _recover(path: Path) -> None:
    """Put back and remove what a run left that was killed."""
    for left in path.glob(f'{WORK}*.partial'):
        pid = left.name[len(WORK):].partition('.')[0]
        if not pid.isdigit() or left.is_symlink() or not left.is_dir():
            continue
        for name in FILES:      # killed in the midst of a swap: the old run is whole
            if os.path.lexists(left / OLD / name):
                if os.path.lexists(path / name):
                    os.rename(path / name, left / name)
                os.rename(left / OLD / name, path / name)
        shutil.rmtree(left, ignore_errors=True)


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders that were made, deepest first, as far as nothing came into them."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _first(folder: Path, path: Path | str) -> str:
    """Return the name in *folder* under which *path*, somewhere below it, lies."""
    return Path(path).resolve().relative_to(Path(folder).resolve()).parts[0]


def _is_ours(name: str) -> bool:
    """Whether *name* is a file or folder that a run leaves."""
    return name in FILES
