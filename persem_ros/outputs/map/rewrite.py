"""A map file that is changed as a whole: locked, what a killed writer left brought in, read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.refine.whole import refine
from persem_ros.outputs.map import store
from persem_ros.outputs.map.lock import WriterLock


@contextmanager
def held(path: Path | str) -> Iterator[store.StoredMap]:
    """
    Give a map that nobody else writes to meanwhile.

    Raises
    ------
    PersemError
        Where the file is no map, is damaged, or another writer has it.

    """
    path = store.head(path).stored.path
    with closing(WriterLock(path)):
        store.fold_log(path, locked=True)
        yield store.load(path)


def put_back(stored: store.StoredMap, memory: VoxelMemory) -> None:
    """Refine *memory* anew with the map's own settings and write it in the map's place."""
    config = stored.config()
    refine(memory, config.refine)
    store.save(stored.path, memory, config, stored.legend)
