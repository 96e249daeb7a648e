"""One recording becomes a map of its own, not refined: the part of a build that reads images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

import numpy as np
from persem_ros.ahead import read_ahead
from persem_ros.core import jit
from persem_ros.core.memory.capture import dump
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.core.warmup import warm_up
from persem_ros.inputs.recording.corrected import correct_all
from persem_ros.inputs.recording.recording import Recording
from persem_ros.mosaic.plan import Input, tiles_of
from persem_ros.outputs.map import store
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.emptiness import Emptiness
from persem_ros.settings.config import Config, updated


@dataclass(frozen=True)
class Observing:
    """
    A recording to be observed.

    Attributes
    ----------
    of : Input
    config : Config
        Of the map.
    side : int
        Blocks along a tile's edge.
    path : str
        Of the map file to write.

    """

    of: Input
    config: Config
    side: int
    path: str

    @property
    def name(self) -> str:
        """Return the recording's name."""
        return self.of.name


def observe(task: Observing, tick: Callable[..., Any] | None = None) -> dict[str, Any]:
    """
    Write the map of a recording, with all of its observations; return what it came to.

    Its frames are numbered from 0: the tiles add what came before.

    Raises
    ------
    PersemError
        When the recording gives no frame, or the file cannot be written.

    """
    warm_up(False)
    began = time.perf_counter()
    config = updated(task.config, {'memory.max_history': 0})
    memory = VoxelMemory(config.memory.voxel_size, config.map.origin)
    pipeline, empty = Pipeline(config, memory), Emptiness(
        config.memory, bool(config.depth.min_confidence))
    with Recording(task.of.path, task.of.config) as recording:
        if task.of.names.classes:
            recording.go_on(task.of.names)
        correct_all([recording], None)
        frames = recording.frames()
        for frame in read_ahead(frames) if jit.threads() > 1 else frames:
            pipeline.add(frame)
            if not memory.n_observations:
                empty.frame(frame)
            if tick is not None:
                tick()
        saved = dump(memory)
        store.save(task.path, saved, config)
        return {'recording': task.name, 'frames': len(memory.frames),
                'stamps': int(memory.frames.t.max()) + 1, 'voxels': memory.n_voxels,
                'observations': memory.n_observations, 'dropped': dict(recording.dropped),
                'notes': [note for note in recording.notes if note not in task.of.said],
                'empty': '' if memory.n_observations else empty.sentence(),
                'voted': np.flatnonzero(memory.voted_ids).tolist(),
                'tiles': tiles_of(saved.block_index, task.side),
                'seconds': round(time.perf_counter() - began, 3)}
