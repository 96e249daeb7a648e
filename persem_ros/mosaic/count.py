"""A round of the method geometry over a tile: its sums, by the parameters of the round before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from persem_ros.core.geometry.columns import Columns
from persem_ros.core.geometry.groups import cells_listed
from persem_ros.core.geometry.kept import within
from persem_ros.core.geometry.looks import looks_from, model_of
from persem_ros.core.geometry.parameters import FIRST_RHO
from persem_ros.core.geometry.totals import arrays_of
from persem_ros.mosaic.folder import load_array, load_arrays, load_folder, save_arrays
from persem_ros.mosaic.plan import Tile
from persem_ros.mosaic.task import timed
from persem_ros.settings.config import Geometry


@dataclass(frozen=True)
class Counting:
    """
    A tile whose sums are wanted.

    Attributes
    ----------
    tile : Tile
    looks : str
        File of what look.look() wrote.
    constants : Geometry
    tiles, lowest, classes : str
        Files of arrays of the whole map: its core.geometry.columns.Columns, its classes.
    parameters : str
        Folder of those of the round before; '': there is none.
    path : str
        File of the sums, and of the cells by which they go.

    """

    tile: Tile
    looks: str
    constants: Geometry
    tiles: str
    lowest: str
    classes: str
    parameters: str = ''
    path: str = ''

    @property
    def name(self) -> str:
        """Return the tile's name."""
        return self.tile.name


@timed
def count(task: Counting) -> dict[str, Any]:
    """Write the sums of a tile; return what that took."""
    columns = Columns(load_array(task.tiles), load_array(task.lowest))
    model: Any = model_of(looks_from(load_arrays(task.looks)), columns,
                          np.array(load_array(task.classes)), task.constants)
    if task.parameters:
        sums = model.round(within(load_folder(task.parameters), model.cells))
    else:
        sums = model.start(FIRST_RHO)
    cells = [cells_listed(known) for known in model.cells]
    save_arrays(task.path, {**arrays_of(sums), 'cells': cells[0], 'shifted_cells': cells[1]})
    return {}
