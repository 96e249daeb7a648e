"""When the map is shown: to whom listens, where it has changed, no oftener than it may be."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from persem_ros.ros.forgetting import last_position

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.ros.map import MapOutputs
    from persem_ros.settings.config import Map

LOOK = 0.1              # s between two looks at who listens to the map
CHANGES = 1.0           # s after which changes are told however busy the node is
ALL = frozenset(('map', 'changes'))


class MapSchedule:
    """
    Hands the map to its publishers, on the worker's thread.

    Parameters
    ----------
    outputs : MapOutputs

    Attributes
    ----------
    stale : set of str
        What the topics have not shown yet: 'map', 'changes'.

    """

    def __init__(self, outputs: MapOutputs) -> None:
        """Nothing is to be shown yet."""
        self.stale: set[str] = set()
        self._map = outputs
        self._mapped = self._looked = self._changed = time.monotonic()
        self._shown = False         # an empty map is shown only after one that was not
        self._stamp = 0             # of the last frame

    def step(self, memory: VoxelMemory, settings: Map, busy: bool) -> None:
        """
        Hand the map to its publishers when somebody listens and it is time.

        *busy*: images wait to be mapped, so changes may wait as well.

        """
        now = time.monotonic()
        if self._map.busy or now - self._looked < LOOK:
            return
        self._looked = now
        wanted, new = self._map.wanted()
        if not wanted:
            self._map.forget()
            return
        self.stale |= new
        if self._map.waiting:
            self.stale.add('changes')
        due = self._due(wanted, now, settings.rate, busy)
        if not due and self._map.whole or not memory.n_voxels and not self._shown:
            return
        if memory.frames:
            self._stamp = memory.frames[-1].stamp
        due = self._map.publish(due, 'changes' in new, memory, self._stamp,
                                last_position(memory), settings)
        if 'map' in due:
            self._mapped = now
        if 'changes' in due:
            self._changed = now
        self._shown = True
        if self._map.caught_up:
            self.stale -= due
        if not self._map.whole:
            self.stale.add('changes')

    def _due(self, wanted: set[str], now: float, rate: float, busy: bool) -> set[str]:
        """Return what of *wanted* is to be shown now."""
        due = wanted & self.stale
        if not rate or now - self._mapped < 1.0 / rate:
            due.discard('map')
        if busy and now - self._changed < CHANGES:      # nothing is late for them
            due.discard('changes')
        return due
