"""Recordings become a folder of tables, figures and a report: `persem evaluate`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import json
import logging
from pathlib import Path
from typing import Any, TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.evaluate.measure import combine
from persem_ros.evaluate.measure.result import Result
from persem_ros.evaluate.measure.taxonomy import taxonomy
from persem_ros.evaluate.show import page, table
from persem_ros.evaluate.show.paper_tables import tables
from persem_ros.evaluate.work import jobs, manifest
from persem_ros.evaluate.work.called import called
from persem_ros.evaluate.work.task import ALL_METHODS, Task
from persem_ros.inputs.recording import finding
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.outputs.files import write_json, write_text
from persem_ros.outputs.results import rundir, timing
from persem_ros.preflight.look import opened
from persem_ros.settings import config_file
from persem_ros.settings.config import nearest

if TYPE_CHECKING:
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

log = logging.getLogger(__name__)
REQUEST = 'request.json'        # what the folder is an evaluation of


def evaluate(recordings: list[Path | str], out: Path | str, config: Config,
             methods: Sequence[str] = ALL_METHODS, labels: str = '', grouped: bool = False,
             dynamic: bool = True, predictions: str = '', workers: int = 0, scheduler: str = '',
             force: bool = False, figures: bool = True,
             excerpt: Excerpt = WHOLE) -> dict[str, Any]:
    """
    Evaluate recordings into a folder; what is finished there is not computed again.

    Parameters
    ----------
    recordings : sequence of str or Path
        With the same settings for all.
    out : str or Path
        The folder of the results.
    config : persem_ros.settings.config.Config
        All settings.
    methods : sequence of str
        Some of ALL_METHODS.
    labels, grouped, dynamic
        As of taxonomy.taxonomy.
    predictions : str
        Folder of label images that replace the recorded ones, as of stream.prediction_files;
        with several recordings: a folder of folders with the recordings' names.
    workers, scheduler
        As of jobs.results.
    force : bool
        Give up what an evaluation with other settings left in the folder.
    figures : bool
        Draw figures and write report.html.
    excerpt : persem_ros.inputs.recording.excerpt.Excerpt
        Which frames of each recording are used.

    Returns
    -------
    dict
        The content of evaluation.json.

    Raises
    ------
    PersemError
        When a recording or the folder cannot be used: one sentence.

    """
    methods = chosen_methods(methods)
    if figures:
        page.check()            # before the work
    paths = named(recordings)
    tasks = {name: Task(str(path), config, methods, str(labels), grouped, dynamic,
                        predictions_of(predictions, name, len(paths)), pictures=figures,
                        excerpt=excerpt)
             for name, path in paths.items()}
    frames = {name: check(task) for name, task in tasks.items()}
    folder = prepare(out, request_of(next(iter(tasks.values()))), force)
    done = compute(folder, {folder / 'sequences' / name: task for name, task in tasks.items()},
                   workers, scheduler, list(frames.values()))
    results = {path.name: result for path, result in done.items()}
    warn(results)
    evaluation = {**combine.combined(results), 'versions': timing.versions(),
                  'hardware': timing.hardware(),
                  'settings': request_of(next(iter(tasks.values())))['settings']}
    write_text(folder / 'config.yaml', config_file.to_yaml(config))
    write(folder, evaluation)
    if figures:
        page.write(folder, evaluation, results)
    return evaluation


def write(folder: Path, evaluation: dict[str, Any]) -> None:
    """Write evaluation.json and the tables in all forms."""
    write_json(folder / 'evaluation.json', evaluation)
    found = tables(evaluation)
    for item in found:
        for suffix, form in table.FORMATS.items():
            write_text(folder / 'tables' / f'{item.key}.{suffix}', form(item))
    write_json(folder / 'tables.json', {item.key: table.as_json(item) for item in found})
    write_text(folder / 'tables.md', '\n'.join(table.markdown(item) for item in found))


def compute(
        out: Path, tasks: dict[Path, Task], workers: int = 0, scheduler: str = '',
        frames: list[int] | None = None
) -> dict[Path, Result]:
    """
    Return what is left of tasks by their folder in *out*, in their order.

    Results that lie there are taken, the others computed and saved at once. Meanwhile nobody
    else computes there.

    """
    identities = {folder: manifest.identity(task) for folder, task in tasks.items()}
    loaded = {folder: manifest.load(folder, identities[folder]) for folder in tasks}
    found = {folder: result for folder, result in loaded.items() if result is not None}
    missing = [folder for folder in tasks if folder not in found]
    if len(missing) < len(tasks):
        log.info('%d of %d are finished already', len(tasks) - len(missing), len(tasks))
    by_folder = dict(zip(tasks, frames or [1] * len(tasks)))
    with rundir.locked(out):
        for place, summary, arrays in jobs.results(
                [tasks[f] for f in missing], workers, scheduler, [by_folder[f] for f in missing]):
            folder = missing[place]
            manifest.save(folder, identities[folder], summary, arrays)
            found[folder] = Result(summary, arrays)
    return {folder: found[folder] for folder in tasks}


def prepare(out: Path | str, request: dict[str, Any], force: bool = False) -> Path:
    """
    Return the folder *out*, new or with a part of the same evaluation.

    Raises
    ------
    PersemError
        When it holds something else and *force* is not set.

    """
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise PersemError(f'{folder} is a file; give the name of a folder with --out')
    request = json.loads(json.dumps(request))
    try:
        before = json.loads((folder / REQUEST).read_text('utf-8'))
    except (OSError, ValueError):
        before = None
    if before is None and folder.exists() and any(folder.iterdir()) and not force:
        raise PersemError(f'{folder} is not empty and holds no evaluation; give another folder '
                          'with --out, or --force to write there all the same')
    if before is not None and before != request and not force:
        found = manifest.changes(before, request)
        more = f' and {len(found) - 3} more' if len(found) > 3 else ''
        raise PersemError(f'{folder} holds an evaluation with other settings '
                          f'({"; ".join(found[:3])}{more}); give another folder with --out, or '
                          '--force to replace it')
    folder.mkdir(parents=True, exist_ok=True)
    with rundir.locked(folder):
        write_json(folder / REQUEST, request)
    return folder


def check(task: Task) -> int:
    """Return the frames that a task will read; refuse what cannot be used, before the work."""
    if task.config.map.path:
        raise PersemError('map.path: an evaluation begins with an empty map; leave it out')
    with opened(task.recording, task.config, excerpt=task.excerpt) as recording:
        names = called(recording, task.labels)
        found = taxonomy(task.labels, task.grouped, task.dynamic, names.legend)
        if found.table is not None and not found.table:
            raise PersemError(f'{recording.path}: --grouped and --no-dynamic need a legend with '
                              'classes; name one with --labels')
        if names.said:
            log.warning('%s: %s', recording.name, names.said)
        if not recording.has('truth'):
            log.warning('%s has no truth: accuracy unknown, flicker only', recording.name)
        return 2 * recording.expected


def warn(results: dict[str, Result]) -> None:
    """Say what was left out of the sequences."""
    for name, (summary, _) in results.items():
        outside = summary['outside_taxonomy']
        if outside:
            legend = page.legend_of(summary)
            log.warning('%s: true ids outside the taxonomy are ignored: %s', name, ', '.join(
                f'{i} {_quoted(legend, int(i))}({n} pixels)' for i, n in outside.items()))
        if summary['frames']['without_prediction']:
            log.warning('%s: %d frames have no prediction and were left out', name,
                        summary['frames']['without_prediction'])
        for note in summary['notes']:
            log.warning('%s: %s', name, note)


def _quoted(legend: Legend, number: int) -> str:
    """Return a class's name in quotes and a space, '' where the legend has none."""
    return f"'{legend.name(number)}' " if number in legend.ids else ''


def chosen_methods(methods: Sequence[str]) -> tuple[str, ...]:
    """Return methods in the usual order; refuse unknown ones."""
    for name in methods:
        if name not in ALL_METHODS:
            raise PersemError(f'unknown method {name!r}{nearest(name, ALL_METHODS)}; expected '
                              f'all or some of {", ".join(ALL_METHODS)}')
    return tuple(name for name in ALL_METHODS if name in methods)


def named(recordings: list[Path | str]) -> dict[str, Path]:
    """Return {name: path} of recordings, the names made different."""
    names: Counter[str] = Counter()
    result = {}
    for given in recordings:
        parts = [path.resolve() for path in finding.split(given)]
        stem = '+'.join(path.name if path.is_dir() else path.stem for path in parts)
        names[stem] += 1
        name = stem if names[stem] == 1 else f'{stem}-{names[stem]}'
        result[name] = Path('+'.join(map(str, parts)))
    return result


def predictions_of(folder: str, name: str, recordings: int) -> str:
    """Return the folder of one recording's predictions."""
    if folder and recordings > 1:
        own = Path(folder) / name
        if not own.is_dir():
            raise PersemError(f'--predictions: {own} does not exist; with several recordings '
                              'the folder holds one folder each, of the same name')
        return str(own)
    return str(folder)


def request_of(task: Task) -> dict[str, Any]:
    """Return what all sequences of a folder share, as JSON."""
    found = manifest.identity(task)
    return {name: found[name] for name in (
        'settings', 'methods', 'taxonomy', 'grouped', 'dynamic', 'pictures', 'excerpt')
        if name in found}
