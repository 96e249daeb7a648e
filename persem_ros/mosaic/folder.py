"""The folder of a build: one build at a time, and what of it is finished."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import json
import logging
from pathlib import Path
import shutil
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.evaluate.work.manifest import changes
from persem_ros.outputs.files import replacing, write_json
from persem_ros.outputs.results import rundir
from persem_ros.workers import Crew

log = logging.getLogger(__name__)
WORK = '.persem-build'      # in the folder: what is removed when the map is whole
REQUEST = 'request.json'    # in it: what the build is of
MAP, RESULT, SETTINGS = 'map.persem', 'build.json', 'config.yaml'
Key = TypeVar('Key')


class Folder:
    """
    Where a build works.

    Parameters
    ----------
    out : Path
    crew : persem_ros.workers.Crew
        Who does the work.

    """

    def __init__(self, out: Path, crew: Crew) -> None:
        self.out, self.work = out, out / WORK
        self._crew = crew

    def path(self, kind: str, name: str) -> Path:
        """Return where a piece of the work goes, absolute: workers may be elsewhere."""
        return (self.work / kind / name).resolve()

    def finished(self, kind: str, tasks: dict[str, Any], work: Callable[..., dict[str, Any]],
                 units: Sequence[int], what: str, unit: str) -> dict[str, dict[str, Any]]:
        """
        Return what *work* gives for tasks by their names; what is finished is taken from here.

        Parameters
        ----------
        kind : str
            Of the work.
        tasks : dict of str to task
            By names, of which notes are made.
        work : function
            As of Crew.results; gives what JSON has.
        units, what, unit
            As of Crew.results.

        """
        notes = {name: self.work / kind / f'{name}.json' for name in tasks}
        found = {name: _noted(note) for name, note in notes.items()}
        missing = [name for name, result in found.items() if result is None]
        if len(missing) < len(tasks):
            log.info('%s: %d of %d are finished already', what, len(tasks) - len(missing),
                     len(tasks))
        size = dict(zip(tasks, units))
        (self.work / kind).mkdir(exist_ok=True)
        for place, result in self._crew.results(
                work, [tasks[name] for name in missing], [size[name] for name in missing], what,
                unit):
            write_json(notes[missing[place]], result)
            found[missing[place]] = result
        return {name: result for name, result in found.items() if result is not None}


@contextmanager
def opened(out: Path | str, identity: dict[str, Any], force: bool = False,
           keep: Sequence[str | Path] = (), processes: int = 0,
           scheduler: str = '') -> Iterator[Folder]:
    """
    Give the Folder of a build, new or with a part of the same one.

    Raises
    ------
    PersemError
        When *out* holds something else and *force* is not set, or an input, or cannot be written,
        or another build writes there.

    """
    path, identity = Path(out), json.loads(json.dumps(identity))
    rundir.check_inputs(path, keep)
    if path.exists() and not path.is_dir():
        raise PersemError(f'{path} is a file; give the name of a folder with --out')
    try:
        path.mkdir(parents=True, exist_ok=True)
        with rundir.locked(path), Crew(processes, scheduler) as crew:
            _begin(path, identity, force)
            yield Folder(path, crew)
    except OSError as error:
        raise PersemError(f'cannot write to {path}: {error.strerror or error}') from error


def result_of(out: Path | str, identity: dict[str, Any]) -> dict[str, Any] | None:
    """Return the content of build.json where *out* holds the whole map of that build."""
    found = _noted(Path(out) / RESULT)
    same = found is not None and found.get('of') == json.loads(json.dumps(identity))
    return found if same and (Path(out) / MAP).exists() else None


def save_array(path: Path, values: NDArray[Any]) -> None:
    """Write an array that all workers read, whole or not at all."""
    with replacing(path) as work, open(work, 'wb') as out:
        np.save(out, values, allow_pickle=False)


def load_array(path: str | Path) -> NDArray[Any]:
    """Return such an array, read as far as it is used."""
    values: NDArray[Any] = np.load(path, mmap_mode='r', allow_pickle=False)
    return values


def save_arrays(path: str | Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays that one task reads, by their names, whole or not at all."""
    with replacing(path) as work, open(work, 'wb') as out:
        np.savez(out, allow_pickle=False, **arrays)


def load_arrays(path: str | Path, *names: str) -> dict[str, NDArray[Any]]:
    """Return such arrays, those of some names or all."""
    with np.load(path, allow_pickle=False) as found:
        return {name: found[name] for name in names or found.files}


def save_folder(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays of which all workers read a part, by their names, whole or not at all."""
    work = path.with_name(f'{path.name}.partial')
    shutil.rmtree(work, ignore_errors=True)
    for name, values in arrays.items():
        save_array(work / f'{name}.npy', values)
    work.rename(path)


def load_folder(path: str | Path) -> dict[str, NDArray[Any]]:
    """Return such arrays, read as far as they are used."""
    return {found.stem: load_array(found) for found in sorted(Path(path).glob('*.npy'))}


def _begin(path: Path, identity: dict[str, Any], force: bool) -> None:
    """Make the folder of this build where it holds none, or a part of it; refuse another."""
    before = _noted(path / WORK / REQUEST)
    if before is None:
        done = _noted(path / RESULT)
        before = None if done is None else done.get('of')
    if before is None and any(path.iterdir()) and not force:
        raise PersemError(f'{path} is not empty and holds no build; give another folder with '
                          '--out, or --force to write there all the same')
    if before is not None and before != identity:
        if not force:
            found = [_differs(line) for line in changes(before, identity)]
            more = f' and {len(found) - 3} more' if len(found) > 3 else ''
            raise PersemError(f'{path} holds another build ({"; ".join(found[:3])}{more}); give '
                              'another folder with --out, or --force to begin it anew')
        shutil.rmtree(path / WORK, ignore_errors=True)
    (path / WORK).mkdir(exist_ok=True)
    write_json(path / WORK / REQUEST, identity)


def _differs(line: str) -> str:
    """Return what manifest.changes() says without its ends of long lists."""
    name = line.partition(':')[0]
    return f'other {name}' if name in ('recordings', 'settings', 'readings', 'legend') else line


def _noted(path: Path) -> dict[str, Any] | None:
    """Return the JSON object in a file, None where there is none."""
    try:
        found = json.loads(path.read_text('utf-8'))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
