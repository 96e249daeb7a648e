"""A recording becomes a refined map, refined images and metrics: `persem replay`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, ExitStack
from pathlib import Path
from typing import Any, TYPE_CHECKING

from persem_ros.choices import chosen_legend, chosen_methods, pages
from persem_ros.core.jit import Compiling
from persem_ros.core.warmup import warm_up
from persem_ros.inputs.recording import finding
from persem_ros.inputs.recording.corrected import correct_all
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.inputs.recording.sessions import Sessions
from persem_ros.outputs.map import store
from persem_ros.outputs.report.watcher import ReportWatcher
from persem_ros.outputs.results import rundir
from persem_ros.outputs.results.mapped import attached, start_map
from persem_ros.outputs.results.paged import Paged
from persem_ros.passes import Replay, Watcher
from persem_ros.preflight.look import opened_all
from persem_ros.settings.config import Config
from persem_ros.settings.heights import hinted

if TYPE_CHECKING:
    from persem_ros.core.trajectory import Trajectory


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
        correct_all(recording.recordings, trajectory)
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


def compile_kernels(methods: tuple[str, ...]) -> None:
    """Compile or load the kernels of *methods*, once a process; say so when it takes long."""
    geometry = 'geometry' in methods
    with Compiling(*['geometry'] if geometry else []):
        warm_up(geometry)
