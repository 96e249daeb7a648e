"""What a map file holds, once it is read: a map that can go on, with its settings and legend."""

from __future__ import annotations

from dataclasses import dataclass, replace
import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.loading import load as load_memory
from persem_ros.errors import PersemError
from persem_ros.settings import config_file
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Config

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class StoredMap:
    """
    What a map file holds.

    Attributes
    ----------
    path : Path
    saved : persem_ros.core.memory.dump.MemoryDump
    map_frame : str
        The coordinate frame in which the voxels lie.
    settings : str
        YAML text of the settings in force when it was saved.
    legend : persem_ros.settings.legend.Legend

    """

    path: Path
    saved: MemoryDump
    map_frame: str
    settings: str
    legend: Legend

    def memory(self, config: Config | None = None) -> VoxelMemory:
        """
        Return a VoxelMemory that goes on exactly where the saved one stood.

        Parameters
        ----------
        config : Config, optional
            Settings with which mapping goes on.

        Raises
        ------
        PersemError
            Where voxels of these settings would not fit the map's.

        """
        saved = self.saved
        if config is not None:
            self.check_fits(config)
            self.warn_of_history(config)
            saved = replace(saved, max_history=config.memory.max_history)
        return load_memory(saved)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the corners (3,) of all voxels' centres, metres in the map frame."""
        saved = self.saved
        voxel = saved.voxels()
        return tuple((corner + 0.5) * saved.voxel_size + np.array(saved.origin)
                     for corner in (voxel.min(axis=0), voxel.max(axis=0)))

    def config(self) -> Config:
        """Return the Config in force when the map was saved."""
        return config_file.from_text(self.settings, f'settings in {self.path}')

    def check_fits(self, config: Config) -> None:
        """Refuse settings whose voxels are other ones."""
        for name, mine, other in (
                ('memory.voxel_size', self.saved.voxel_size, config.memory.voxel_size),
                ('map.origin', list(self.saved.origin), list(config.map.origin)),
                ('frames.map', self.map_frame, config.frames.map)):
            if mine != other:
                raise PersemError(f'{self.path} was made with {name} {mine}, now it is {other}; '
                                  f'give {name} {mine} or another map.path')

    def warn_of_history(self, config: Config) -> None:
        """Say where settings ask for observations that the map has let go of."""
        kept, wanted = self.saved.max_history, config.memory.max_history
        if kept and not 0 < wanted <= kept:
            log.warning('%s holds the newest %d observations of each voxel; older ones do '
                        'not come back with memory.max_history %d', self.path, kept, wanted)


@dataclass(frozen=True, eq=False)
class Head:
    """All of a map file but its blocks: a StoredMap without any, the table about, the schema."""

    stored: StoredMap
    about: dict[str, Any]
    schema: int
