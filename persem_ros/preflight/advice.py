"""What a user should know of a run that went through: ids, legend, voxel size, far places."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import MAX_ID
from persem_ros.preflight.heights import about_heights, about_overruled
from persem_ros.preflight.voxel_fit import VoxelFit

if TYPE_CHECKING:
    from persem_ros.core.geometry.overruled import Overruled
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Frame
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

SIGNED = ('16SC1', '32SC1')     # encodings with ids that are out of range and not "no label"
IDS = 20                        # in a sentence
COARSE = 0.05                   # share of a voxel to which map points should be exact


class Advice:
    """
    Sentences with what to type; nothing here changes a setting.

    Parameters
    ----------
    config : Config
    legend : Legend
    methods : sequence of str
        What is measured besides refine.method.

    """

    def __init__(self, config: Config, legend: Legend, methods: Sequence[str] = ()) -> None:
        self._config, self._legend = config, legend
        self._methods = {*methods, config.refine.method}
        # Ids of things that move that no legend knows and no image has had so far.
        self._unmet = {c for c in config.memory.dynamic_labels if c >= 0 and c not in legend.ids}
        self._odd: Counter[str] = Counter()
        self._far: NDArray[np.float64] | None = None
        self._fit = VoxelFit(config.memory)

    def frame(self, frame: Frame) -> None:
        """Look at one that was integrated, a persem_ros.frames.Frame."""
        if frame.encoding in SIGNED:
            self._count(frame.labels)
        self._unmet = {c for c in self._unmet if not (frame.labels == c).any()}
        self._fit.frame(frame)
        position = frame.T_map_camera[:3, 3]
        if self._far is None and self._step(position) > COARSE * self._config.memory.voxel_size:
            self._far = position

    def sentences(self, seen_ids: NDArray[np.uint8],
                  overruled: Iterable[Overruled] = ()) -> list[str]:
        """
        Return what there is to say: sentences.

        Parameters
        ----------
        seen_ids : ndarray, shape (65536,), uint8
            Whether an id was integrated (VoxelMemory.seen_ids).
        overruled : iterable of Overruled
            What heights did to the votes, where that is known.

        """
        return [*self._about_ids(), *self._about_flags(seen_ids),
                *about_heights(self._config, self._legend, self._methods, seen_ids),
                *about_overruled(self._config, self._legend, overruled), *self._about_places()]

    def about_voxels(self, memory: VoxelMemory, voxels: int) -> list[str]:
        """Return what there is to say of the voxels' size, so many in the whole map."""
        return list(self._fit.sentences(memory, voxels))

    def _count(self, labels: NDArray[np.int32]) -> None:
        odd = (labels < 0) | (labels > MAX_ID)
        if odd.any():
            odd &= ~np.isin(labels, self._config.memory.ignore_labels)
            self._odd['pixels'] += int(np.count_nonzero(odd))
            self._odd['frames'] += bool(odd.any())

    def _about_ids(self) -> Iterator[str]:
        if self._odd['pixels']:
            yield (f'{self._odd["pixels"]} pixels in {self._odd["frames"]} frames have ids below '
                   f'0 or above {MAX_ID}; they were ignored')

    def _about_flags(self, seen_ids: NDArray[np.uint8]) -> Iterator[str]:
        """Compare the legend's flags with the settings, as far as the ids occur."""
        memory = self._config.memory
        dynamic = tuple(c for c in memory.dynamic_labels if c >= 0 and c not in self._unmet)
        if self._unmet:
            ids = np.flatnonzero(seen_ids).tolist()
            there = ', '.join(f'{c} ({self._legend.name(c)})' for c in ids[:IDS])
            more = f' and {len(ids) - IDS} more' if len(ids) > IDS else ''
            yield (f'memory.dynamic_labels {", ".join(map(str, sorted(self._unmet)))}: no label '
                   'image has such ids and no legend knows them; expected ids that occur: '
                   f'{there}{more}')
        for flag, name, given in (('dynamic', 'dynamic_labels', dynamic),
                                  ('ignored', 'ignore_labels', memory.ignore_labels)):
            marked = [c for c in getattr(self._legend, flag) if seen_ids[c]]
            if marked and not (flag == 'dynamic' and dynamic):
                names = ', '.join(f'{c} ({self._legend.name(c)})' for c in marked)
                value = ','.join(str(c) for c in (*given, *marked))
                yield (f'the legend marks {names} as {flag}, the map holds what was seen of it; '
                       f'to leave it out: --set memory.{name}={value}')

    def _about_places(self) -> Iterator[str]:
        if self._far is not None:
            proposal = ','.join(f'{round(x, -3) + 0.0:.0f}' for x in self._far)
            yield (f'positions are so large that map points (float32) are exact to '
                   f'{self._step(self._far):.3g} m only; move the origin with '
                   f'--set map.origin={proposal}')

    def _step(self, position: NDArray[np.float64]) -> float:
        """Return the spacing of float32 numbers at a position (3,), metres."""
        return float(np.spacing(np.float32(np.abs(position - self._config.map.origin).max())))
