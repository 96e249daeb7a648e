"""The parameters of the method geometry: a map and a reduce a round, over the tiles of a build."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.geometry.columns import Columns, merged
from persem_ros.core.geometry.kept import from_arrays
from persem_ros.core.geometry.looks import Pairs
from persem_ros.core.geometry.schedule import Schedule
from persem_ros.core.geometry.totals import sums_from, Totals, Whole
from persem_ros.mosaic import folder as folders
from persem_ros.mosaic.count import count, Counting
from persem_ros.mosaic.look import look, Looking
from persem_ros.mosaic.surroundings import Surrounded
from persem_ros.settings.config import Refine


@dataclass(frozen=True)
class Fitted:
    """
    What the method geometry goes by, in files.

    Attributes
    ----------
    tiles, lowest : str
        Of the map's Columns.
    parameters : str
        Folder of the parameters' arrays.

    """

    tiles: str
    lowest: str
    parameters: str

    def columns(self) -> Columns:
        """Return the Columns of the map."""
        return Columns(folders.load_array(self.tiles), folders.load_array(self.lowest))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the parameters of the map, as core.geometry.kept.within() takes them."""
        return folders.load_folder(self.parameters)


def fitted(folder: folders.Folder, tiles: dict[str, Surrounded],
           settings: Refine) -> tuple[Fitted, dict[str, Any]]:
    """
    Run the schedule of section 12.5 over the tiles of a map.

    Parameters
    ----------
    folder : Folder
        Of the build.
    tiles : dict of str to Surrounded
        By their names.
    settings : Refine
        up and geometry.

    Returns
    -------
    Fitted
    seconds : dict
        What every task took.

    Raises
    ------
    PersemError
        For votes of too many classes in a voxel.

    """
    files = {name: str(folder.path('looks', f'{name}.npz')) for name in tiles}
    looked = folder.finished('looks', {
        name: Looking(of, files[name]) for name, of in tiles.items()}, look, [1] * len(tiles),
        'looking at shapes', 'tiles')
    columns = merged([Columns(*folders.load_arrays(path, 'tiles', 'lowest').values())
                      for path in files.values()])
    classes = np.unique(np.concatenate([one['classes'] for one in looked.values()])) \
        .astype(np.uint16)
    reduce(Pairs.and_those, (Pairs(*one['pairs']) for one in looked.values())).check(len(classes))
    arrays = {name: str(folder.path('arrays', f'{name}.npy'))
              for name in ('tiles', 'lowest', 'classes')}
    for name, values in {**columns._asdict(), 'classes': classes}.items():
        folders.save_array(Path(arrays[name]), values)
    whole = Whole(classes, columns.cells(settings.geometry.cell),
                  sum(one['voxels'] for one in looked.values()), settings.geometry.shrink)
    parameters, seconds = _rounds(folder, whole, settings.geometry.rounds, {
        name: Counting(of.tile, files[name], settings.geometry, **arrays)
        for name, of in tiles.items()})
    return Fitted(arrays['tiles'], arrays['lowest'], parameters), {
        'looks': [one['seconds'] for one in looked.values()], 'rounds': seconds}


def _rounds(folder: folders.Folder, whole: Whole, rounds: int,
            tasks: dict[str, Counting]) -> tuple[str, list[float]]:
    """Return the folder of the parameters after all rounds, and what the tasks took."""
    schedule, path = Schedule(rounds, whole.estimate), ''
    seconds: list[float] = []
    while not schedule.ended:
        number = schedule.taken
        place = folder.path('parameters', str(number))
        if place.exists():
            known = {name: np.array(a) for name, a in folders.load_folder(place).items()}
            schedule = Schedule(rounds, whole.estimate, number + 1, from_arrays(known))
        else:
            todo = {name: replace(task, parameters=path, path=str(
                folder.path(f'round{number}', f'{name}.npz'))) for name, task in tasks.items()}
            done = folder.finished(f'round{number}', todo, count, [1] * len(todo),
                                   f'round {number} of {rounds}', 'tiles')
            seconds += [one['seconds'] for one in done.values()]
            totals = Totals(whole.cells)
            for task in todo.values():
                arrays = folders.load_arrays(task.path)
                totals.add(sums_from(arrays), (arrays['cells'], arrays['shifted_cells']))
            schedule.take(totals.sums())
            assert schedule.parameters is not None
            folders.save_folder(place, schedule.parameters.arrays())
            shutil.rmtree(folder.work / f'round{number}', ignore_errors=True)
        path = str(place)
    return path, seconds
