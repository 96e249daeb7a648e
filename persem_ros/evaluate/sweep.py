"""The same recordings under many settings: `persem sweep`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import itertools
import json
import math
from typing import Any, TYPE_CHECKING, Union

from persem_ros.errors import PersemError
from persem_ros.evaluate import run
from persem_ros.evaluate.measure.combine import mean
from persem_ros.evaluate.measure.measures import BETTER, MEASURES
from persem_ros.evaluate.show import sweep_page, table
from persem_ros.evaluate.work import manifest
from persem_ros.evaluate.work.stream import Disturbance
from persem_ros.evaluate.work.task import Task
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.outputs.files import write_json, write_text
from persem_ros.outputs.results import timing
from persem_ros.settings import config_file
from persem_ros.settings.config import nearest, settings, updated
from persem_ros.settings.parameter_file import parse

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.evaluate.show.table import Table
    from persem_ros.settings.config import Config

METHODS = ('raw2d', 'ema2d', 'majority', 'persem', 'geometry')
DISTURB = 'disturb.'
MOST = 2000         # points; more is a mistake in the command line
# Settings of a node, of maps as files, of what is drawn: no number of an evaluation has them.
IDLE = ('refine.period', 'refine.sweep', 'sync.queue', 'sync.queue_bytes', 'pose.max_ahead',
        'topics.color')
IDLE_ROOMS = ('map', 'grid', 'qos', 'render')
BUT = ('map.origin',)
OF_METHODS = {'refine.geometry.': 'geometry', 'ema.': 'ema2d'}  # what they alone look at

Value = Union[float, str, tuple[int, ...]]      # of a setting or a disturbance; float: int, bool


def parse_vary(
        items: list[str], config: Config, each: bool = False) -> dict[str, list[Value]]:
    """
    Return {name: list of values} of options like refine.eta=0,0.1,0.3; *each* as of sweep().

    Raises
    ------
    PersemError
        For a setting that does not exist (the nearest is named) or a value that does not fit.

    """
    axes = {}
    for item in items:
        name, equals, text = item.partition('=')
        name = name.strip()
        if not equals or not text.strip():
            raise PersemError(f'--vary {item}: expected NAME=A,B,C, as in refine.eta=0,0.3,0.6')
        if name in axes:
            raise PersemError(f'--vary {name}: given twice; put all values into one list')
        known = [n for n, _, _ in settings(config)] + [
            DISTURB + n for n in Disturbance.__dataclass_fields__]
        if name not in known:
            raise PersemError(f'--vary: unknown setting {name!r}{nearest(name, known)}; '
                              "'persem config' lists all settings, besides them there is "
                              f'{", ".join(n for n in known if n.startswith(DISTURB))}')
        _refuse_idle(name, text)
        axes[name] = list(dict.fromkeys(_checked(name, word, config) for word in _split(text)))
    count = (sum if each else math.prod)(map(len, axes.values()))
    if not axes or count > MOST:
        raise PersemError(f'--vary: expected 1 to {MOST} points, got {count if axes else 0}')
    return axes


def _refuse_idle(name: str, text: str) -> None:
    """Refuse a setting that changes no number of an evaluation: all rows would be alike."""
    if name == 'refine.method':
        raise PersemError(f'--vary {name}: an evaluation measures several methods at once; use '
                          f'--methods {",".join(_split(text))}')
    if name in IDLE or name.partition('.')[0] in IDLE_ROOMS and name not in BUT:
        raise PersemError(f'--vary {name}: no measure depends on it, all rows would be alike; '
                          'leave it out')


def _refuse_without_method(axes: dict[str, list[Value]], methods: Sequence[str]) -> None:
    """Refuse a setting of one method where that is not measured."""
    for name in axes:
        for start, method in OF_METHODS.items():
            if name.startswith(start) and method not in methods:
                raise PersemError(f'--vary {name}: only {method} depends on it, all rows would be '
                                  f'alike; use --methods {",".join([*methods, method])}')


def _split(text: str) -> list[str]:
    """Return the words between commas; commas in brackets part nothing."""
    words, depth = [''], 0
    for c in text:
        depth += (c == '[') - (c == ']')
        if c == ',' and depth == 0:
            words.append('')
        else:
            words[-1] += c
    return [word.strip() for word in words if word.strip()]


def _checked(name: str, text: str, config: Config) -> Value:
    """Return the value that a text means for a setting; refuse what does not fit."""
    if name.startswith(DISTURB):
        try:
            value: Value = parse(text)
        except ValueError:
            raise PersemError(f'--vary {name}: cannot read {text!r}') from None
        Disturbance().with_value(name[len(DISTURB):], value)
        return value
    changed = updated(config, dict([config_file.parse_item(f'{name}={text}')]))
    return next(v for n, v, _ in settings(changed) if n == name)


def sweep(recordings: list[Path | str], out: Path | str, config: Config,
          axes: dict[str, list[Value]], methods: Sequence[str] = METHODS, labels: str = '',
          grouped: bool = False, dynamic: bool = True, predictions: str = '', workers: int = 0,
          scheduler: str = '', force: bool = False, figures: bool = True,
          excerpt: Excerpt = WHOLE, each: bool = False) -> dict[str, Any]:
    """
    Evaluate recordings at every combination of the values of *axes* (parse_vary).

    With *each* one setting is varied at a time, after a point with nothing changed. The other
    parameters are those of run.evaluate. Points that are finished in the folder are not computed
    again, also those of a sweep over other values.

    Returns
    -------
    dict
        The content of sweep.json: axes {name: values}, each, methods, points [{values, sequences:
        {name: row}, mean: row}]; a row has truth_flicker, voxels, times and methods.

    """
    if figures:
        sweep_page.check()
    methods = run.chosen_methods(methods)
    _refuse_without_method(axes, methods)
    paths = run.named(recordings)
    base = {name: Task(str(path), config, methods, str(labels), grouped, dynamic,
                       run.predictions_of(predictions, name, len(paths)), pictures=False,
                       excerpt=excerpt)
            for name, path in paths.items()}
    frames = [run.check(task) for task in base.values()]
    points = [{}, *({name: value} for name, values in axes.items() for value in values)] \
        if each else [dict(zip(axes, values)) for values in itertools.product(*axes.values())]
    folder = run.prepare(out, _request(next(iter(base.values())), axes), force)
    tasks = {}
    for k, values in enumerate(points):
        for name, task in base.items():
            tasks[k, name] = with_values(task, values)
    folders = {place: folder / 'points' / manifest.key_of(manifest.identity(task))
               for place, task in tasks.items()}
    found = run.compute(folder, {folders[place]: task for place, task in tasks.items()}, workers,
                        scheduler, frames * len(points))
    for k, values in enumerate(points):
        at = _at(values)
        run.warn({f'{name} at {at}': found[folders[k, name]] for name in paths})
    result = {
        'axes': {name: [_plain(v) for v in values] for name, values in axes.items()},
        'each': each, 'methods': list(methods),
        'taxonomy': next(iter(found.values()))[0]['taxonomy'],
        'recordings': list(paths),
        'points': [_point(values, {name: found[folders[k, name]][0] for name in paths})
                   for k, values in enumerate(points)],
        'settings': manifest.identity(next(iter(base.values())))['settings'],
        'versions': timing.versions(), 'hardware': timing.hardware()}
    write_json(folder / 'sweep.json', result)
    item = points_table(result)
    for suffix, form in table.FORMATS.items():
        write_text(folder / f'sweep.{suffix}', form(item))
    if figures:
        sweep_page.write(folder, result, item)
    return result


def with_values(task: Task, values: dict[str, Value]) -> Task:
    """Return a task with some settings and disturbances changed."""
    disturbance = task.disturbance
    for name, value in values.items():
        if name.startswith(DISTURB):
            disturbance = disturbance.with_value(name[len(DISTURB):], value)
    config = updated(task.config, {name: value for name, value in values.items()
                                   if not name.startswith(DISTURB)})
    return replace(task, config=config, disturbance=disturbance)


def points_table(result: dict[str, Any]) -> Table:
    """Return all points as a Table: the values in front, then measures by method."""
    columns = tuple(table.Column({'pixel_accuracy': 'PA', 'miou': 'mIoU', 'flicker': 'Flicker'}[k],
                                 BETTER[k], method) for method in result['methods']
                    for k in MEASURES)
    columns += (table.Column('Truth flicker'), table.Column('Voxels', digits=0),
                table.Column('History, s'), table.Column('Refinement, s', digits=3))
    rows = [(tuple(str(v) for v in point['values'].values()), tuple(
        table.Cell(v) for v in (
            *(point['mean']['methods'][m][k] for m in result['methods'] for k in MEASURES),
            point['mean']['truth_flicker'], point['mean']['voxels'],
            point['mean']['history_s'], point['mean']['refinement_s'])))
            for point in result['points']]
    names = result['recordings']
    heads = tuple(result['axes'])
    if result['each']:
        heads = 'changed',
        rows = [((_at(point['values']),), cells)
                for point, (_, cells) in zip(result['points'], rows)]
    title = f'Sweep over {", ".join(result["axes"])}, ' + (
        names[0] if len(names) == 1 else f'mean of {len(names)} sequences')
    return table.marked(table.Table(
        'sweep', title, heads, columns, rows))


def _at(values: dict[str, Value]) -> str:
    """Return a point's values as text."""
    return ', '.join(f'{name}={_plain(value)}' for name, value in values.items()) or 'nothing'


def _point(values: dict[str, Value], summaries: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return what sweep.json has of one point."""
    rows = {name: {
        'truth_flicker': s['truth_flicker'], 'voxels': s['voxels'],
        'history_s': s['runtime']['history_s'],
        'refinement_s': max(s['runtime']['refinement_s'].values(), default=None),
        'peak_bytes': s['runtime']['peak_bytes'],
        'methods': {m: {k: row[k] for k in MEASURES} for m, row in s['methods'].items()}}
        for name, s in summaries.items()}
    first = next(iter(rows.values()))
    average: dict[str, Any] = {
        key: mean(row[key] for row in rows.values()) for key in first if key != 'methods'}
    average['methods'] = {m: {k: mean(row['methods'][m][k] for row in rows.values())
                              for k in MEASURES} for m in first['methods']}
    return {'values': {name: _plain(v) for name, v in values.items()}, 'sequences': rows,
            'mean': average}


def _request(task: Task, axes: dict[str, list[Value]]) -> dict[str, Any]:
    """Return what all points of a folder share, as JSON."""
    request = run.request_of(task)
    request['settings'] = {name: value for name, value in request['settings'].items()
                           if name not in axes}
    return json.loads(json.dumps({**request, 'axes': sorted(axes)}))


def _plain(value: Value) -> float | str | list[int]:
    return list(value) if isinstance(value, tuple) else value
