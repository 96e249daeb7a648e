"""The map file of a node: when it is read, what may take its place, one save at a time."""

from collections.abc import Callable
import logging
from pathlib import Path
import threading
from typing import Any, NamedTuple

from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.dump import MemoryDump
from persem_ros.core.memory.paging import Pager
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.outputs.map import store
from persem_ros.outputs.map.living import LivingMap
from persem_ros.ros.map_path import (
    identity, not_writable, path_of, second_name, take_back, unusable)
from persem_ros.settings.config import Config
from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)


class _Held(NamedTuple):
    """A file whose content is part of a map."""

    file: tuple[int, ...]       # which one, by identity
    memory: VoxelMemory
    forgotten: int              # voxels that the map had let go by then


class MapFile:
    """
    Loads and saves the map of a node.

    A save never replaces a file by a map that does not contain it: neither by an empty one nor by
    one that began without it, was reset, or has let go of voxels since. Such a file is moved
    aside first, under its name and the date.

    Parameters
    ----------
    forgotten : callable
        forgotten() gives how many voxels the map has let go of.
    legend : callable
        legend() gives the Legend in force.

    Attributes
    ----------
    legend : Legend or None
        Of the file that was loaded last, None where it has none.

    """

    def __init__(self, forgotten: Callable[[], int], legend: Callable[[], Legend]) -> None:
        self._forgotten, self._legend = forgotten, legend
        self.legend: Legend | None = None
        self._saving = threading.Lock()
        self._held: dict[Path, _Held] = {}
        self._living: LivingMap | None = None
        self._pager: Pager | None = None

    def begin(self, config: Config) -> VoxelMemory | None:
        """
        Return the memory of map.path where map.load asks for it, else None.

        Says at the start what a save at the end would do, and refuses what it could not do.

        """
        if config.map.attached:
            return self._attach(config)
        problem = unusable(config)
        if problem:
            raise PersemError(problem)
        if not config.map.path:
            return None
        path = path_of(config)
        if not config.map.save and not_writable(path):
            log.warning('%s: ~/save_map will fail', not_writable(path))
        if config.map.load and not (config.map.save and not path.exists()):
            return self.load(config)
        if config.map.load:
            log.info('%s does not exist yet: an empty map begins', path)
        elif path.exists():
            log.warning('%s holds a map already, which this run does not go on with; a save moves '
                        'it aside to %s.<date> first; to go on with it: --set map.load=true',
                        path, path.name)
        return None

    def renew(self, config: Config) -> VoxelMemory | None:
        """Return the memory of an empty map where one is attached; its file is moved aside."""
        if self._living is None:
            return None
        path = path_of(config)
        self._detach()
        aside = second_name(path)
        path.unlink(missing_ok=True)
        log.warning('%s is now %s; an empty map begins', path, aside)
        return self._attach(config)

    def described(self) -> str:
        """Return what the attached file holds, in one sentence."""
        assert self._living is not None
        return f'saved {self._living.voxels} voxels to {self._living.path}'

    def _attach(self, config: Config) -> VoxelMemory:
        """Return a memory of which map.path holds the rest."""
        if not config.map.path:
            raise PersemError('map.attached needs a file: --set map.path=/absolute/path/'
                              'map.persem')
        self._living = LivingMap(path_of(config), config, self._legend)
        memory = self._living.memory()
        self._pager = Pager(memory, self._living)
        found = self._living.stored_legend
        self.legend = found if found.classes else None
        log.info('%s is attached, with %d voxels', self._living.path, self._living.voxels)
        return memory

    def _detach(self) -> bool:
        """Save and close the attached file; return whether the save went well."""
        assert self._living is not None and self._pager is not None
        try:
            self._pager.save()
            return True
        except PersemError as error:
            log.error('%s', error)
            return False
        finally:
            self._living.close()
            self._living = None

    def load(self, config: Config) -> VoxelMemory:
        """Return the memory of map.path, in a new session."""
        path = path_of(config)
        file = identity(path)
        stored = store.load(path)
        memory = stored.memory(config)
        memory.new_session()
        self.legend = stored.legend if stored.legend.classes else None
        if file is not None and not _shortened(stored.saved, config.memory.max_history):
            self._held[path] = _Held(file, memory, self._forgotten())
        return memory

    def save(self, config: Config, copy: Callable[[], tuple[MemoryDump, VoxelMemory, int]]
             ) -> str:
        """
        Save to map.path; who calls meanwhile waits. Return what was done, in one sentence.

        Parameters
        ----------
        config : Config
            The settings in force.
        copy : callable
            copy() gives `copied` of the memory, at one moment.

        """
        path = path_of(config)
        with self._saving:
            saved, memory, forgotten = copy()
            if not len(saved.cell):
                keeps = f', {path} stays as it is' if path.exists() else ''
                raise PersemError(f'the map is empty, nothing was saved{keeps}')
            aside = None if self._contains(path, memory, forgotten) else second_name(path)
            try:
                store.save(path, saved, config, self._legend())
            except BaseException:
                if aside is not None:
                    take_back(aside, path)
                raise
            file = identity(path)
            if file is not None:
                self._held[path] = _Held(file, memory, forgotten)
        kept = f'; what was there is now {aside}' if aside is not None else ''
        return f'saved {len(saved.cell)} voxels to {path}{kept}'

    def follow(self, old: VoxelMemory, new: VoxelMemory) -> None:
        """Take note that a map goes on in another memory, with all that it held."""
        for path, held in self._held.items():
            if held.memory is old:
                self._held[path] = held._replace(memory=new)

    def copied(self, memory: VoxelMemory) -> tuple[MemoryDump, VoxelMemory, int]:
        """Return a dump of the memory, the memory and what it had let go of by now."""
        return dump(memory), memory, self._forgotten()

    def end(self, config: Config, memory: VoxelMemory, mapped: bool) -> bool:
        """Save at the end where map.save asks for it; return whether that went well."""
        if self._living is not None:
            living, well = self._living, self._detach()
            if well:
                log.info('saved %d voxels to %s', living.voxels, living.path)
            return well
        if not config.map.save:
            return True
        path = config.map.path
        if not mapped or not memory.n_voxels:
            log.info('nothing was mapped, so nothing is saved%s',
                     f'; {path} stays as it is' if path and path_of(config).exists() else '')
            return True
        try:
            log.info('%s', self.save(config, lambda: self.copied(memory)))
        except PersemError as error:
            log.error('%s', error)
            return False
        return True

    def _contains(self, path: Path, memory: VoxelMemory, forgotten: int) -> bool:
        """Whether nothing is lost when *memory* takes the place of the file *path*."""
        file = identity(path)
        held = self._held.get(path)
        return file is None or held is not None and held.file == file \
            and held.memory is memory and held.forgotten == forgotten


def _shortened(saved: Any, max_history: int) -> bool:
    """Whether a map that goes on with *max_history* lets go of observations that are stored."""
    stored = saved.history_start[1:] - saved.history_start[:-1]
    return bool(max_history and len(stored) and stored.max() > max_history)
