"""The passes of a replay over its frames: mapping and rendering, one after another or at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
import logging
from pathlib import Path
from typing import Any, Protocol, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.ahead import read_ahead, WriteBehind
from persem_ros.choices import chosen_legend
from persem_ros.core.jit import give_back
from persem_ros.core.refine.regions import region_image
from persem_ros.errors import PersemError
from persem_ros.inputs.recording.sessions import Sessions
from persem_ros.outputs.files import write_json, write_text
from persem_ros.outputs.progress import progress
from persem_ros.outputs.recording.refined import RefinedWriter
from persem_ros.outputs.results import timing
from persem_ros.outputs.results.mapped import Mapped
from persem_ros.outputs.results.metrics import Metrics
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.advice import Advice
from persem_ros.preflight.emptiness import Emptiness
from persem_ros.rendering import Renderer
from persem_ros.settings import config_file
from persem_ros.settings.config import Config

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.geometry.overruled import Overruled
    from persem_ros.frames import Frame
    from persem_ros.rendering import Rendering

log = logging.getLogger(__name__)


class Watcher(Protocol):
    """Who is told of every rendered frame, and at the end of the content of metrics.json."""

    def frame(self, replay: Replay, frame: Frame, rendering: Rendering) -> None:
        """Hear of a rendered frame."""

    def finish(self, replay: Replay, result: dict[str, Any]) -> None:
        """Hear of the end."""


class Replay:
    """
    One replay of one or more recordings into one folder.

    Parameters
    ----------
    recording : Sessions
    folder : Path
        Where the results go (outputs.results.rundir.building).
    config : Config
    methods : sequence
        Methods to be measured; refine.method is among them.
    watchers : sequence of Watcher
    mapped : Mapped, optional
        A map to go on with.

    """

    def __init__(self, recording: Sessions, folder: Path, config: Config,
                 methods: Sequence[str], watchers: Sequence[Watcher] = (),
                 mapped: Mapped | None = None) -> None:
        self.recording, self.folder, self.config = recording, folder, config
        self.out = folder       # where the folder's files end up
        self.methods, self.watchers = tuple(methods), tuple(watchers)
        self.watch = timing.Stopwatch()
        self.legend = chosen_legend(config, recording)
        self.advice = Advice(config, self.legend, self.methods)
        self.mapped = mapped or Mapped(None, config, self.legend)
        self.pipeline = Pipeline(config, self.mapped.memory)
        self.renderer = Renderer(self.pipeline, self.methods)
        self.metrics = Metrics(list(self.methods))
        self.frames, self.causal = 0, False
        self.storage = 'mcap'   # of refined/
        self.overruled: list[Overruled] = []    # votes that heights of classes overrule
        self._session = self._measured = 0
        self._before = self.pipeline.memory.n_observations     # of a map that goes on
        self._emptiness = Emptiness(config.memory, bool(config.depth.min_confidence))

    def run(self) -> dict[str, Any]:
        """Build the map, refine it, render every frame from it; return metrics.json's content."""
        with self._read('integrating') as frames:
            for session, frame in frames:
                self._begin(session)
                self._integrate(frame)
                self._make_room(frame)
        self._check_map()
        self._refine()
        with self.watch('label'):
            self.renderer.classify()
        with self._refined() as refined, self._behind() as later:
            # Where nothing moves any more, much is done beside the rendering.
            paged = self.mapped.paged
            then = at_once if paged else later
            with WriteBehind() as beside, \
                    self._read('rendering', truth=True, color=bool(self.watchers)) as frames:
                (at_once if paged else beside)(self._write_map)
                for session, frame in frames:
                    if self._begins_measuring(session):
                        then(self.metrics.restart)
                    rendering = self._render(frame)
                    then(self._measure, frame, rendering, self.renderer.codes)
                    later(refined.frame, frame, rendering.published)
                    self._make_room(frame)
            later(refined.map, self.mapped.points(), self.pipeline.memory.frames[-1].stamp)
        return self._finish()

    def run_causal(self) -> dict[str, Any]:
        """Integrate, refine when it is time, render: what a node would have published."""
        self.causal, period = True, int(self.config.refine.period * 1e9)
        refined_at: int | None = None
        with self._refined() as refined, self._behind() as later:
            with self._read('mapping', truth=True, color=bool(self.watchers)) as frames:
                for session, frame in frames:
                    if session != self._session:
                        refined_at = None
                    self._begin(session)
                    if self._begins_measuring(session):
                        self.metrics.restart()
                    observations = self._integrate(frame)
                    refined_at = frame.stamp if refined_at is None else refined_at
                    if frame.stamp - refined_at >= period:
                        self._refine(full=False)
                        refined_at = frame.stamp
                    rendering = self._render(frame, observations)
                    self._measure(frame, rendering)
                    later(refined.frame, frame, rendering.published)
                    self._make_room(frame)
            self._check_map()
            self._refine()
            self._write_map()
            later(refined.map, self.mapped.points(), self.pipeline.memory.frames[-1].stamp)
        return self._finish()

    def without_truth(self) -> str:
        """Return why accuracy is unknown, a main clause; '' where it is known."""
        if not self.recording.has('truth'):
            return 'the recording holds no truth'
        if not self.metrics.has_truth:
            return 'no frame has a true label image of its own'
        if not any(row['iou'] for row in self.metrics.result()['methods'].values()):
            return 'no pixel has depth, a label that counts and a truth that counts'
        return ''

    def _read(
            self, what: str, truth: bool = False, color: bool = False
    ) -> AbstractContextManager[Iterable[tuple[int, Frame]]]:
        """Give the recording's frames, read ahead, with a progress bar on a terminal."""
        frames = read_ahead(self.watch.iterate('read', self.recording.frames(truth, color)))
        return progress(frames, what, self.recording.expected)

    def _begin(self, session: int) -> None:
        """Begin a session of the map where the next recording begins."""
        if session != self._session:
            self._session = session
            self.pipeline.memory.new_session()

    def _begins_measuring(self, session: int) -> bool:
        """Return whether another recording begins, with no frame of which one is compared."""
        begins = session != self._measured
        if begins:
            self._measured = session
            self.renderer.restart()
        return begins

    def _integrate(self, frame: Frame) -> Observations:
        """Add a frame to the map; return its observations."""
        with self.watch('integrate'):
            observations = self.pipeline.add(frame)
        self.frames += 1
        self.advice.frame(frame)
        if self.pipeline.memory.n_observations == self._before:
            self._emptiness.frame(frame)
        return observations

    def _make_room(self, frame: Frame) -> None:
        """Keep to the bounds of memory."""
        if self.mapped.paged:
            with self.watch('page'):
                self.mapped.make_room(frame.T_map_camera[:3, 3])

    def _check_map(self) -> None:
        """Refuse a recording of which nothing went into the map; log what its voxels are like."""
        memory = self.pipeline.memory
        give_back()
        self.mapped.settle()
        if memory.n_observations == self._before:
            raise PersemError(f'{self.recording.name}: nothing went into the map, '
                              f'{self._emptiness.sentence()}')
        for note in self.advice.about_voxels(memory, self.mapped.n_voxels):
            log.warning(note)

    def _refine(self, full: bool = True) -> None:
        """Refine the map, or what is next in turn; label it by the other methods."""
        with self.watch('refine'):
            if full:
                self.pipeline.refine(full=True)
            else:
                self.pipeline.refine_next()
        with self.watch('label'):
            self.renderer.relabel()

    def _render(self, frame: Frame, observations: Observations | None = None) -> Rendering:
        """Render a frame by every method."""
        with self.watch('render'):
            return self.renderer.render(frame, observations)

    def _measure(
            self, frame: Frame, rendering: Rendering, codes: NDArray[np.uint8] | None = None
    ) -> None:
        """Count a rendered frame and show it to the watchers."""
        with self.watch('measure'):
            self.metrics.update(rendering.valid, rendering.images, rendering.truth,
                                None if codes is None else region_image(codes, rendering.voxels),
                                frame.sensor if frame.has_grid else None)
        with self.watch('watch'):
            for watcher in self.watchers:
                watcher.frame(self, frame, rendering)

    def _refined(self) -> RefinedWriter:
        """Return the writer of refined/."""
        return RefinedWriter(self.folder / 'refined', self.legend, self.config, self.watch,
                             self.storage)

    def _behind(self) -> AbstractContextManager[Callable[..., None]]:
        """Return what writes beside the rendering; sqlite3 is bound to one thread."""
        return WriteBehind() if self.storage == 'mcap' else nullcontext(at_once)

    def _write_map(self) -> None:
        """Write map.ply, map.persem and the settings."""
        with self.watch('write map'):
            write_text(self.folder / 'config.yaml', config_file.to_yaml(self.config))
            self.mapped.write(self.folder)
        give_back()

    def _finish(self) -> dict[str, Any]:
        """Write metrics.json and timing.json; tell the watchers; log what a user should know."""
        memory = self.pipeline.memory
        give_back()
        frames: dict[str, Any] = {'used': self.frames, 'dropped': dict(self.recording.dropped)}
        if self.config.memory.stride == 0:
            frames['strides'] = dict(sorted(self.pipeline.strides.items()))
        result = {'frames': frames,
                  'voxels': self.mapped.n_voxels, 'observations': memory.n_observations,
                  **self.metrics.result()}
        write_json(self.folder / 'metrics.json', result)
        self.overruled = self.mapped.overruled(self.renderer.labelled('geometry'))
        self.timing = timing.content(self.watch, self.frames, memory.nbytes())
        write_json(self.folder / 'timing.json', self.timing)
        for watcher in self.watchers:
            watcher.finish(self, result)
        for note in (*self.recording.unsaid,
                     *self.advice.sentences(memory.seen_ids, self.overruled)):
            log.warning(note)
        return result


def at_once(function: Callable[..., object], *arguments: Any) -> None:
    """Call a function, as WriteBehind does later."""
    function(*arguments)
