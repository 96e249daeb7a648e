"""The numbers of the page, made ready to be shown: plain lists and dicts of text and numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import shlex
from typing import Any, TYPE_CHECKING

from persem_ros.settings.config import Config, settings
from persem_ros.settings.parameter_file import scalar

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.core.geometry.overruled import Overruled
    from persem_ros.settings.legend import Legend

BETTER = {'pixel_accuracy': 1, 'miou': 1, 'flicker': -1}
MEASURES = ('pixel_accuracy', 'miou', 'flicker')


def headlines(result: dict[str, Any], method: str) -> list[dict[str, float | str | None]]:
    """
    Return the three numbers at the top: raw2d, then the method, with what there is.

    Returns
    -------
    list of dict
        title, before, after (percent or None), gain (points, positive is better), floor.

    """
    rows = result['methods']
    before, after = rows.get('raw2d', {}), rows[method]
    return [{'title': title, 'before': before.get(key), 'after': after[key],
             'gain': _gain(key, after[key], before.get(key)),
             'floor': result['truth_flicker'] if key == 'flicker' else None}
            for key, title in zip(MEASURES, ('pixel accuracy', 'mean IoU', 'flicker'))]


def methods_table(rows: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """
    Return the table of methods.

    Parameters
    ----------
    rows : dict
        metrics.json's methods, or a region's.

    Returns
    -------
    list of dict
        name and cells: value, best, and gains [(method, points or None)] against raw2d and
        majority (raw2d itself: against nothing); positive is better.

    """
    best = {key: _best(rows, key) for key in MEASURES}
    bases = [name for name in ('raw2d', 'majority') if name in rows]
    return [{'name': name, 'cells': [
        {'value': row[key], 'best': row[key] is not None and row[key] == best[key],
         'gains': [(base, _gain(key, row[key], rows[base][key]))
                   for base in bases[:0 if name == 'raw2d' else None] if base != name]}
        for key in MEASURES]} for name, row in rows.items()]


def _best(rows: dict[str, dict[str, Any]], key: str) -> float | None:
    """Return the best value of a measure if there is something to compare."""
    values: list[float] = [row[key] for row in rows.values() if row[key] is not None]
    if len(values) < 2:
        return None
    return (max if BETTER[key] > 0 else min)(values)


def _gain(key: str, value: float | None, base: float | None) -> float | None:
    return None if value is None or base is None else BETTER[key] * (value - base)


def iou_rows(result: dict[str, Any], legend: Legend) -> list[dict[str, Any]]:
    """Return per class: id, name, color and {method: IoU in percent}, in the legend's order."""
    rows = result['methods']
    ids = sorted({int(c) for row in rows.values() for c in row.get('iou', {})},
                 key=_legend_order(legend))
    return [{'id': i, 'name': legend.name(i), 'color': legend.color(i),
             'iou': {name: row['iou'].get(str(i)) for name, row in rows.items()}} for i in ids]


def legend_rows(
        legend: Legend, voxels: dict[int, int], shown: Sequence[int] = (),
        overruled: Sequence[Overruled] = (), voxel_size: float = 1.0) -> list[dict[str, Any]]:
    """
    Return the legend: classes that it knows, ids that the map has beside them, ignored ones.

    Parameters
    ----------
    legend : persem_ros.settings.legend.Legend
        In force.
    voxels : dict
        Number of voxels by label.
    shown : collection of int
        Ids that pictures show; the ignored ones among them have a row.
    overruled : sequence of Overruled
        What heights of classes did to their votes.
    voxel_size : float
        Metres.

    """
    told = {one.label: one for one in overruled}
    known = {item.id: item for item in legend.classes}
    rows = []
    ignored = set(legend.unlabelled) & set(shown)
    for i in sorted({*known, *voxels, *ignored}, key=_legend_order(legend)):
        item = known.get(i)
        marks = [mark for mark in ('ignored', 'dynamic') if item and getattr(item, mark)]
        rows.append({'id': i, 'name': legend.name(i), 'color': legend.color(i),
                     'group': item.group if item and item.group != item.name else '',
                     'marks': marks if item or i in ignored
                     else ['not in the legend'] * bool(known),
                     'voxels': voxels.get(i, 0),
                     'heights': _heights(told[i], voxel_size) if i in told else ''})
    return rows


def _heights(one: Overruled, size: float) -> str:
    """Return what the heights of a class did to its votes."""
    text = (f'{one.low * size:.3g} to {one.high * size:.3g} m above the ground: '
            f'{one.out / one.voxels:.1%} of its {one.voxels} voxels by votes lie beyond')
    if one.out:
        text += f', {one.kept / one.out:.0%} of these keep the name'
    return f'{text}; the votes contradict these heights' if one.doubtful else text


def _legend_order(legend: Legend) -> Callable[[int], tuple[int, int]]:
    places = {c: place for place, c in enumerate(legend.ids)}
    return lambda i: (places.get(i, len(places)), i)


def changed_settings(config: Config) -> list[dict[str, str]]:
    """Return name, value, default, unit and help of the settings that are not at the default."""
    defaults = {name: value for name, value, _ in settings(Config())}
    return [{'name': name, 'value': scalar(value), 'unit': meta['unit'],
             'default': scalar(defaults[name]) if name in defaults else '',
             'help': meta['help']}
            for name, value, meta in settings(config)
            if name not in defaults or value != defaults[name]]


def command(
        inputs: list[str], folder: Path, config: Config, methods: tuple[str, ...], causal: bool
) -> str:
    """Return the command line that does this replay, of *inputs* (words), again."""
    words = ['persem', 'replay', *inputs, '--out', str(folder)]
    usual = ('raw2d', 'majority', config.refine.method)
    if tuple(methods) != tuple(dict.fromkeys(usual)):
        words += ['--methods', ','.join(methods)]
    words += ['--causal'] * bool(causal)
    words.append('--force')         # the folder is there: this run made it
    values = {name: value for name, value, _ in settings(config)}
    for row in changed_settings(config):
        value = values[row['name']]
        text = value if isinstance(value, str) else row['value']
        words += ['--set', f'{row["name"]}={text}']
    return shlex.join(words)


def stages(timing: dict[str, Any]) -> list[dict[str, float | str]]:
    """Return name, seconds, calls, milliseconds a call and share of the longest, in order."""
    longest = max((row['s'] for row in timing['stages'].values()), default=0) or 1.0
    return [{'name': name, 's': row['s'], 'calls': row['calls'],
             'ms': 1e3 * row['s'] / max(1, row['calls']), 'share': 100 * row['s'] / longest}
            for name, row in timing['stages'].items()]


def memory_rows(timing: dict[str, Any], voxels: int) -> list[dict[str, float | str]]:
    """Return what of the map takes how many bytes, the largest first, with bytes a voxel."""
    sizes = timing['memory']['map_bytes']
    largest = max(sizes.values(), default=0) or 1
    return [{'name': name, 'bytes': size, 'each': size / max(1, voxels),
             'share': 100 * size / largest}
            for name, size in sorted(sizes.items(), key=lambda item: -item[1])]


def bytes_text(size: int) -> str:
    """Return a number of bytes for people: 41.3 MB."""
    if size < 1000:
        return f'{size:.0f} B'
    shown = size / 1000
    for unit in ('kB', 'MB'):
        if shown < 1000:
            return f'{shown:.1f} {unit}'
        shown /= 1000
    return f'{shown:.1f} GB'
