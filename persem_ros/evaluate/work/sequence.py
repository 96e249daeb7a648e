"""One sequence: a recording read twice becomes the counts of all methods."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros import ahead
from persem_ros.core import jit
from persem_ros.core.frame.images import counted, on_depth
from persem_ros.core.frame.smoothing import EmaImages
from persem_ros.core.refine import snapshot
from persem_ros.core.refine.labelled import labelled
from persem_ros.core.refine.regions import regions
from persem_ros.core.warmup import warm_up
from persem_ros.evaluate.measure.classes import Classes
from persem_ros.evaluate.measure.counts import stacked
from persem_ros.evaluate.measure.frame_counter import Counter
from persem_ros.evaluate.measure.measures import summary
from persem_ros.evaluate.measure.result import Result
from persem_ros.evaluate.measure.taxonomy import taxonomy
from persem_ros.evaluate.measure.voxel_kinds import kinds_of
from persem_ros.evaluate.work.called import called
from persem_ros.evaluate.work.pictures import Panels, top_view
from persem_ros.evaluate.work.stream import Stream
from persem_ros.outputs.results.peak import PeakMemory
from persem_ros.outputs.results.timing import Stopwatch
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.look import opened
from persem_ros.preflight.voxel_fit import VoxelFit
from persem_ros.settings.config import IMAGE_METHODS, METHODS
from persem_ros.settings.heights import hinted

if TYPE_CHECKING:
    from persem_ros.evaluate.work.task import Task
    from persem_ros.frames import Frame
    from persem_ros.inputs.recording.recording import Recording
    from persem_ros.settings.config import Memory

BLOCKS = 30         # stretches of frames that intervals are made of


def evaluate_sequence(
        task: Task, tick: Callable[[], object] | None = None) -> Result:
    """
    Evaluate one recording.

    Parameters
    ----------
    task : Task
        What is wanted.
    tick : callable, optional
        Called after each frame of both readings.

    Raises
    ------
    PersemError
        When the recording cannot be used.

    """
    with PeakMemory() as peak, opened(task.recording, task.config, True,
                                      task.excerpt) as recording:
        warm_up('geometry' in task.methods)
        sequence = Sequence(task, recording, tick)
        sequence.integrate()
        sequence.label()
        sequence.measure()
        return sequence.result(peak.bytes())


class Sequence:
    """An evaluation under way; parameters as of evaluate_sequence."""

    def __init__(
            self, task: Task, recording: Recording, tick: Callable[[], object] | None = None
    ) -> None:
        self.task, self.recording, self._tick = task, recording, tick
        names = called(recording, task.labels)
        self.stream = Stream(recording, task.predictions, task.disturbance, names.new)
        self.watch = Stopwatch()
        self.pipeline = Pipeline(recording.config)
        self.images = [m for m in task.methods if m in IMAGE_METHODS]
        self.methods = (*self.images, *(m for m in task.methods if m in METHODS))
        self.taxonomy = taxonomy(task.labels, task.grouped, task.dynamic, names.legend)
        self.names = names
        self.refine = hinted(task.config, names.legend).refine
        self.classes = Classes(self.taxonomy.table)
        self.fit = VoxelFit(task.config.memory)
        self.frames = 0

    def integrate(self) -> None:
        """Read the recording and build the map."""
        order = self.task.disturbance.order
        waiting = []
        for frame in self._read():
            with self.watch('history'):
                observations = self.pipeline.observe(frame)
                if order == 'recorded':
                    self.pipeline.memory.add(observations)
                else:
                    waiting.append(observations)
            self.fit.frame(frame)
            self.frames += 1
        if order == 'reversed':
            waiting.reverse()
        elif order == 'shuffled':
            np.random.default_rng(self.task.disturbance.seed).shuffle(waiting)
        for observations in waiting:
            with self.watch('history'):
                self.pipeline.memory.add(observations)
        self.dropped = dict(self.recording.dropped)

    def label(self) -> None:
        """Label the map by every method, from one snapshot, and find the kinds of voxels."""
        memory, config = self.pipeline.memory, self.task.config
        with self.watch('snapshot'):
            taken = snapshot.take(memory)
            rho, n_ids = memory.volatility(), int(np.count_nonzero(memory.seen_ids))
        voxel_methods = self.methods[len(self.images):]
        labels = np.empty((len(voxel_methods), memory.n_voxels), np.uint16)
        self.sources = np.zeros(memory.n_voxels, np.uint8)
        for row, method in zip(labels, voxel_methods):
            with self.watch(f'label {method}'):
                found, sources = labelled(memory, taken, method, self.refine, rho, n_ids)[:2]
                row[taken.number] = found
            if method == config.refine.method:
                self.sources[taken.number] = sources
        with self.watch('regions'):
            codes, self.entropy, self.switch_rate = regions(memory, config.refine.neighbours)
        with self.watch('kinds'):
            dynamic = config.memory.dynamic_labels
            self.classes.meet(np.flatnonzero(memory.seen_ids).astype(np.int32))
            self.classes.meet(np.array(dynamic, np.int32))
            kinds = kinds_of(labels, codes, self.classes.index, dynamic)
        self.labels = labels
        self.counter = Counter(kinds, self.classes, self.methods, len(self.images),
                               config.memory)
        self.panels = Panels(self, kinds) if self.task.pictures else None

    def measure(self) -> None:
        """Read the recording again and count every frame."""
        smoothers: dict[str, EmaImages] = {}
        blocks, changed, pairs, stamps = [], [], [], []
        ends = {self.frames * (b + 1) // min(BLOCKS, self.frames) for b in range(BLOCKS)}
        for number, frame in enumerate(
                self._read(truth=True, color=self.panels is not None), 1):
            with self.watch('reprojection'):
                voxels = self.pipeline.voxel_image(frame)
            labels = on_depth(frame, frame.labels)
            truth = None if frame.truth is None else on_depth(frame, frame.truth)
            with self.watch('smoothing in the image'):
                images = [self._smoothed(frame.sensor, labels, smoothers)
                          if m == 'ema2d' else labels for m in self.images]
            with self.watch('count'):
                new = self.counter.frame(labels, frame.depth, voxels, truth, images,
                                         frame.sensor)
                changed.append(new[0])
                pairs.append(new[1])
                stamps.append(frame.stamp)
                if number in ends:
                    blocks.append(self.counter.block())
            if self.panels is not None:
                self.panels.offer(frame, labels, truth, voxels, images)
        self.blocks = stacked(blocks, len(self.classes))
        self.series = {'frame/changed': np.array(changed), 'frame/compared': np.array(pairs),
                       'frame/stamp': np.array(stamps, np.int64)}

    def result(self, peak: int) -> Result:
        """Return what evaluate_sequence() returns."""
        memory, ids = self.pipeline.memory, self.classes.ids
        matrix = self.blocks.pop('matrix')
        method = self.task.config.refine.method     # of the map that is shown
        method = method if method in self.methods else 'majority'
        known = self.taxonomy.legend.ids        # those that it ignores are no surprise
        outside = [c for c in np.flatnonzero(self.classes.outside) if c not in known]
        seconds = self.watch.seconds
        result = {
            'name': self.recording.name, 'methods_order': list(self.methods),
            'taxonomy': self.taxonomy.name, 'has_truth': self.counter.has_truth,
            'frames': {'used': self.frames, 'dropped': self.dropped,
                       'without_prediction': self.stream.unpredicted},
            'voxels': memory.n_voxels, 'observations': memory.n_observations,
            'outside_taxonomy': {str(c): int(self.classes.outside[c]) for c in outside},
            **summary(self.blocks, self.methods, ids),
            'classes': [{'id': int(i), 'name': self.taxonomy.legend.name(i),
                         'color': list(self.taxonomy.legend.color(i))}
                        for i in ids[1:]],
            'legend': self.names.beside(self.taxonomy.legend).to_yaml(),
            'names': self.names.said, 'map_method': method,
            'notes': [*self.recording.notes, *self.fit.sentences(memory)],
            'runtime': {
                'history_s': seconds['history'],
                'refinement_s': {m: seconds[f'label {m}'] + seconds['snapshot']
                                 for m in self.methods[len(self.images):]},
                'reprojection_s': seconds['reprojection'], 'peak_bytes': peak,
                'map_bytes': int(sum(memory.nbytes().values())),
                'stages': {name: round(s, 4) for name, s in seconds.items()},
                'total_s': round(self.watch.total(), 3), 'threads': jit.threads()}}
        arrays: dict[str, NDArray[Any]] = {**self.blocks, **self.series, 'matrix': matrix,
                                           'ids': np.array(ids, np.int32)}
        if self.panels is not None:
            arrays.update(self.panels.arrays())
            arrays.update(top_view(memory, self.labels_of(method),
                                   self.sources, self.entropy, self.switch_rate))
        return Result(result, arrays)

    def labels_of(self, method: str) -> NDArray[np.uint16]:
        """Return a method's labels by voxel number; the majority where it was not asked for."""
        voxel_methods = self.methods[len(self.images):]
        if method in voxel_methods:
            return self.labels[voxel_methods.index(method)]
        memory = self.pipeline.memory
        return np.ascontiguousarray(memory.m.voxels['majority'][:memory.n_voxels])

    def _read(self, **wanted: Any) -> Iterator[Frame]:
        """Yield the frames, read ahead where there is more than one thread."""
        frames = self.watch.iterate('read', self.stream.frames(**wanted))
        for frame in ahead.read_ahead(frames) if jit.threads() > 1 else frames:
            yield frame
            if self._tick:
                self._tick()

    def _smoothed(
            self, sensor: str, labels: NDArray[np.int32], smoothers: dict[str, EmaImages]
    ) -> NDArray[np.uint16]:
        """Return the labels of ema2d; dynamic things are smoothed like all others."""
        if sensor not in smoothers:
            smoothers[sensor] = EmaImages(self.task.config.ema.alpha)
        return smoothers[sensor].update(counted(labels, _everything(self.task.config.memory)))


def _everything(settings: Memory) -> Memory:
    """Return the settings that say which ids count, for whole images."""
    return replace(settings, dynamic_labels=(-1,))
