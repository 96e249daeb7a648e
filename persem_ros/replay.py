"""A recording becomes a refined map, refined images and metrics: `persem replay`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, closing, ExitStack, nullcontext
import logging
from pathlib import Path
from typing import Any, Protocol, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.ahead import read_ahead, WriteBehind
from persem_ros.core.jit import Announcement, give_back
from persem_ros.core.refine.labelled import SWEPT
from persem_ros.core.refine.regions import region_image
from persem_ros.core.warmup import warm_up
from persem_ros.errors import PersemError
from persem_ros.inputs.recording import corrected, finding
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.sessions import Sessions
from persem_ros.outputs.files import write_json, write_text
from persem_ros.outputs.map import store
from persem_ros.outputs.progress import progress
from persem_ros.outputs.recording.refined import RefinedWriter
from persem_ros.outputs.report.watcher import ReportWatcher
from persem_ros.outputs.results import rundir
from persem_ros.outputs.results.mapped import attached, Mapped, start_map
from persem_ros.outputs.results.metrics import Metrics
from persem_ros.outputs.results.paged import Paged
from persem_ros.pipeline import Pipeline
from persem_ros.preflight.advice import Advice
from persem_ros.preflight.emptiness import Emptiness
from persem_ros.preflight.files import as_one
from persem_ros.preflight.look import opened
from persem_ros.rendering import Renderer
from persem_ros.settings import config_file
from persem_ros.settings.config import Config, IMAGE_METHODS, METHODS, nearest
from persem_ros.settings.heights import hinted
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.trajectory import Trajectory
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
        self.watch = rundir.Stopwatch()
        self.legend = chosen_legend(config, recording)
        self.advice = Advice(config, self.legend)
        self.mapped = mapped or Mapped(None, config, self.legend)
        self.pipeline = Pipeline(config, self.mapped.memory)
        self.renderer = Renderer(self.pipeline, self.methods)
        self.metrics = Metrics(list(self.methods))
        self.frames, self.causal = 0, False
        self.storage = 'mcap'   # of refined/
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
        result = {'frames': {'used': self.frames, 'dropped': dict(self.recording.dropped)},
                  'voxels': self.mapped.n_voxels, 'observations': memory.n_observations,
                  **self.metrics.result()}
        write_json(self.folder / 'metrics.json', result)
        self.timing = rundir.timing(self.watch, self.frames, memory.nbytes())
        write_json(self.folder / 'timing.json', self.timing)
        for watcher in self.watchers:
            watcher.finish(self, result)
        for note in (*self.recording.unsaid, *self.advice.sentences(memory.seen_ids)):
            log.warning(note)
        return result


def at_once(function: Callable[..., object], *arguments: Any) -> None:
    """Call a function, as WriteBehind does later."""
    function(*arguments)


def replay(path: Path | str | Sequence[Path | str], out: Path | str, config: Config,
           methods: Sequence[str] | None = None, causal: bool = False, force: bool = False,
           watchers: Sequence[Watcher] = (), report: bool = True, excerpt: Excerpt = WHOLE,
           trajectory: Trajectory | None = None,
           storage: str = 'mcap') -> dict[str, Any]:
    """
    Replay a recording into a folder (spec section 8).

    Parameters
    ----------
    path : path, or sequence of these
        A rosbag2 recording, or several in a row: each is a session of one map.
    out : path
        The folder of the results.
    config : Config
        All settings.
    methods : sequence, optional
        What is measured besides refine.method, ('all',) for everything; raw2d and majority by
        default.
    causal : bool
        Render each frame from the map as it stood then.
    force : bool
        Replace the files of an earlier run.
    watchers : sequence
        See Replay; the report is one more.
    report : bool
        Write report.html.
    excerpt : Excerpt
        Which frames of each recording are used.
    trajectory : Trajectory, optional
        Corrects the poses of the recording of its time; else that on topics.trajectory, where
        there is one, does.
    storage : str
        Of the recording refined/: 'mcap', or 'sqlite3', which every ROS 2 opens without a plugin.

    Returns
    -------
    dict
        The content of metrics.json.

    Raises
    ------
    PersemError
        When the recording or the folder cannot be used: one sentence.

    """
    methods = chosen_methods(methods, config)
    paths = [path] if isinstance(path, (str, Path)) else list(path)
    with ExitStack() as stack:
        recording = stack.enter_context(Sessions(opened_all(paths, config, excerpt)))
        config = recording.recordings[-1].config    # with what the looks before took over
        correct_poses(recording.recordings, trajectory)
        stack.enter_context(attached(config))
        inputs = [part for given in paths for part in finding.split(given)]
        watchers = [*watchers, *([ReportWatcher()] if report else [])]
        legend = chosen_legend(config, recording)
        config = hinted(config, legend)
        mapped = None if pages(config, methods, watchers, causal) else start_map(config, legend)
        with rundir.building(out, force, keep=(*inputs, config.map.path)) as folder:
            with closing(mapped or Paged(folder, config, legend)) as mapped:
                compile_kernels(methods)
                job = Replay(recording, folder, config, methods, watchers, mapped)
                job.out, job.storage = Path(out), storage
                result = job.run_causal() if causal else job.run()
            if config.map.attached:     # the whole session, or nothing of it
                store.copy(folder / 'map.persem', Path(config.map.path))
            return result


def opened_all(paths: Sequence[str | Path], config: Config,
               excerpt: Excerpt = WHOLE) -> list[Recording]:
    """Return the open recordings of some inputs; what is decided for one holds for the next."""
    recordings: list[Recording] = []
    try:
        for path in paths:
            recordings.append(opened(path, config, excerpt=excerpt))
            config = recordings[-1].config
    except BaseException as error:
        for recording in recordings:
            recording.close()
        if isinstance(error, PersemError) and (
                sentence := as_one(paths, config) if len(paths) > 1 else ''):
            raise PersemError(f'{error}; {sentence}') from None
        raise
    return recordings


def correct_poses(recordings: Sequence[Recording], trajectory: Trajectory | None) -> None:
    """Have recordings give their frames by corrected poses, where there are any."""
    if trajectory is None:
        for recording in recordings:
            own = corrected.named(recording)
            if own is not None:
                log.info('%s', corrected.correct(recording, own))
        return
    errors = []
    for recording in recordings:
        try:
            log.info('%s', corrected.correct(recording, trajectory))
        except PersemError as error:
            errors.append(error)
    if len(errors) == len(recordings):
        raise errors[0]


def compile_kernels(methods: tuple[str, ...]) -> None:
    """Compile or load the kernels of *methods*, once a process; say so when it takes long."""
    geometry = 'geometry' in methods
    with Announcement(*['geometry'] if geometry else []):
        warm_up(geometry)


def chosen_methods(methods: Sequence[str] | None, config: Config) -> tuple[str, ...]:
    """Return the methods to be measured, refine.method among them; refuse unknown ones."""
    known = IMAGE_METHODS + METHODS
    methods = list(methods or ('raw2d', 'majority', config.refine.method))
    if methods == ['all']:
        methods = list(known)
    for name in methods:
        if name not in known:
            raise PersemError(f'unknown method {name!r}{nearest(name, known)}; expected all, or '
                              f'some of {", ".join(known)}')
    return tuple(dict.fromkeys(methods + [config.refine.method]))


def chosen_legend(config: Config, recording: Recording | Sessions) -> Legend:
    """Return the legend of labels.legend, else the recording's, else one of made-up colours."""
    text = recording.legend_text        # that of labels.legend where it is set
    legend = Legend.from_yaml(text, "the recording's legend") if text else Legend()
    return legend.ignoring(config.memory.ignore_labels)


def pages(config: Config, methods: Sequence[str], watchers: Sequence[Watcher], causal: bool,
          ) -> bool:
    """
    Return whether a replay does with a part of the map in memory; warn where one cannot.

    Refuses an attached file that does not fit the settings.

    """
    if not config.map.attached:
        return False
    others = {*methods} - {*IMAGE_METHODS, 'majority', config.refine.method}
    why = ''
    if not others <= SWEPT:
        why = 'the method geometry beside another is measured on the whole map'
    elif causal and others:
        why = f'--causal measures {", ".join(sorted(others))} on the whole map'
    elif any(getattr(watcher, 'whole_map', False) for watcher in watchers):
        why = '--rerun follows the whole map'
    if why:
        if config.memory.max_voxels or config.memory.keep_radius:
            log.warning('%s is held in memory as a whole: %s', config.map.path, why)
        return False
    if Path(config.map.path).exists():
        stored = store.head(config.map.path).stored
        stored.check_fits(config)
        stored.warn_of_history(config)
    return True
