"""Two results side by side: what differs in their making and in their numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.errors import PersemError
from persem_ros.evaluate.measure.combine import BLOCK_ARRAYS
from persem_ros.evaluate.measure.intervals import COVERED, resampled, RESAMPLES
from persem_ros.evaluate.measure.measures import BETTER, MEASURES, number
from persem_ros.evaluate.show import table
from persem_ros.evaluate.show.paper_tables import NAMES
from persem_ros.evaluate.work import manifest
from persem_ros.inputs.recording.excerpt import Excerpt
from persem_ros.outputs.files import write_text
from persem_ros.settings.config import nearest
from persem_ros.settings.parameter_file import read

if TYPE_CHECKING:
    from persem_ros.evaluate.show.table import Table


def load(folder: Path | str) -> dict[str, Any]:
    """
    Return a result as a dict: sequences {name: metrics}, settings, versions, blocks, origin.

    Parameters
    ----------
    folder : str or Path
        What persem evaluate or persem replay left.

    Raises
    ------
    PersemError
        When it holds neither.

    """
    folder = Path(folder)
    try:
        if (folder / 'evaluation.json').is_file():
            found = json.loads((folder / 'evaluation.json').read_text('utf-8'))
            done = {name: manifest.load(folder / 'sequences' / name)
                    for name in found['sequences']}
            return {'sequences': found['sequences'], 'settings': found['settings'],
                    'versions': found['versions'], 'taxonomy': found['taxonomy'],
                    'blocks': {name: one.arrays for name, one in done.items() if one},
                    'inputs': {name: manifest.inputs(folder / 'sequences' / name)
                               for name in done}}
        if (folder / 'metrics.json').is_file():
            timing = json.loads((folder / 'timing.json').read_text('utf-8'))
            values = read(folder / 'config.yaml')
            return {'sequences': {'replay': json.loads(
                        (folder / 'metrics.json').read_text('utf-8'))},
                    'settings': {name: value for name, (value, _) in values.items()},
                    'versions': timing['versions'], 'taxonomy': 'all ids', 'blocks': {},
                    'inputs': {}}
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PersemError(f'{folder}: damaged: {" ".join(str(error).split())}') from None
    raise PersemError(f'{folder} holds no result: expected evaluation.json of persem evaluate or '
                      'metrics.json of persem replay')


def compare(
        a: Path | str, b: Path | str, out: str | None = None
) -> tuple[list[str], list[Table]]:
    """
    Compare two results; draw both where *out* is given.

    Returns
    -------
    differences : list of str
        What differs in settings, versions and sequences.
    tables : list of table.Table
        One per sequence that both have.

    """
    first, second = load(a), load(b)
    pairs = _pairs(first, second, a, b)
    lines = [line for key in ('settings', 'versions')
             for line in manifest.changes(first[key], second[key])]
    lines += manifest.changes({'taxonomy': first['taxonomy']}, {'taxonomy': second['taxonomy']})
    for one, other, name in ((first, second, a), (second, first, b)):
        alone = [s for s in one['sequences'] if s not in {p[one is second] for p in pairs}]
        lines += [f'sequences in {name} only: {", ".join(alone)}'] if alone else []
    lines += [line for names in pairs for line in unlike(first, second, *names)]
    found = [_table(first, second, *names) for names in pairs]
    if out:
        _draw(Path(out), pairs, first, second, (str(a), str(b)))
        for item in found:
            for suffix, form in table.FORMATS.items():
                write_text(Path(out) / f'{item.key}.{suffix}', form(item))
    return lines, found


def unlike(first: dict[str, Any], second: dict[str, Any], name: str, other: str) -> list[str]:
    """
    Return why the numbers of a sequence are of different pixels, and what makes them alike.

    Other frames, another recording or voxels of another size change every row, raw2d or majority
    too, and hide what a method does.

    """
    used = [result['sequences'][key]['frames']['used']
            for result, key in ((first, name), (second, other))]
    one, two = (result['inputs'].get(key, {}) for result, key in ((first, name), (second, other)))
    stamps = [result['blocks'][key]['frame/stamp'] for result, key in (
        (first, name), (second, other)) if key in result['blocks']]
    lines = []
    if used[0] != used[1] or len(stamps) == 2 and not np.array_equal(*stamps):
        cuts = [one.get('excerpt') for one in (one, two)]
        how = 'use the same --start, --end and --every for both' if cuts[0] == cuts[1] else (
            f'A has {_options(cuts[0])}, B {_options(cuts[1])}: use the same for both')
        count = f'{used[0]} frames against {used[1]}' if used[0] != used[1] else 'other frames'
        lines.append(f'{name}: {count}, B - A is no gain of a method; to compare, {how}')
    if one and two and one['recording'] != two['recording']:
        lines.append(f'{name}: the recordings hold different data, B - A is no gain of a method; '
                     'to compare, evaluate one recording twice')
    sizes = [result['settings'].get('memory.voxel_size') for result in (first, second)]
    others = [key for key in sorted({*first['settings'], *second['settings']})
              if first['settings'].get(key) != second['settings'].get(key)]
    if sizes[0] != sizes[1] and len(others) > 1:
        lines.append(f'{name}: voxels of {sizes[0]} m against {sizes[1]} m beside '
                     'other settings; to see what those do, give both --set '
                     f'memory.voxel_size={sizes[0]}')
    return lines


def _options(excerpt: dict[str, Any] | None) -> str:
    """Return the options of an excerpt."""
    return ' '.join(Excerpt(**excerpt).words()) if excerpt else 'no --start, --end or --every'


def _pairs(
        first: dict[str, Any], second: dict[str, Any], a: Path | str, b: Path | str
) -> list[tuple[str, str]]:
    """Return the names of sequences that belong together, (in the first, in the second)."""
    ours, theirs = list(first['sequences']), list(second['sequences'])
    both = [(name, name) for name in ours if name in theirs]
    if not both and len(ours) == len(theirs) == 1:
        both = [(ours[0], theirs[0])]
    if not both:
        raise PersemError(f'{a} and {b} have no sequence in common: {", ".join(ours)} and '
                          f'{", ".join(theirs)}{nearest(ours[0], theirs)}')
    return both


def _table(first: dict[str, Any], second: dict[str, Any], name: str, other: str) -> Table:
    """Return the measures of one sequence in both, and their difference."""
    one, two = first['sequences'][name], second['sequences'][other]
    methods = [m for m in one['methods'] if m in two['methods']]
    sure = _intervals(first, second, name, other, methods)
    columns = tuple(table.Column(word, BETTER[key], NAMES[key], signed=word == 'B - A')
                    for key in MEASURES for word in ('A', 'B', 'B - A'))
    rows = []
    for m in methods:
        cells = []
        for key in MEASURES:
            x, y = one['methods'][m][key], two['methods'][m][key]
            gap = None if x is None or y is None else y - x
            cells += [table.Cell(x), table.Cell(y),
                      table.Cell(gap, *(sure.get((m, key), (None, None))))]
        rows.append(((m,), tuple(cells)))
    x, y = one['truth_flicker'], two['truth_flicker']
    gap = None if x is None or y is None else y - x
    rows.append((('(truth)',), (table.Cell(),) * 6 + tuple(map(table.Cell, (x, y, gap)))))
    notes = (f'In brackets: {COVERED:.0f} % intervals, paired block bootstrap.',) if sure else ()
    title = name if name == other else f'{name} (A) and {other} (B)'
    return table.Table(f'compare-{name}', title, ('method',), columns, rows, notes,
                       (len(rows) - 1,))


def _intervals(first: dict[str, Any], second: dict[str, Any], name: str, other: str,
               methods: list[str]) -> dict[tuple[str, str], tuple[float, float]]:
    """Return {(method, measure): (low, high)} of B - A where both looked at the same frames."""
    blocks = [result['blocks'].get(key) for result, key in ((first, name), (second, other))]
    if None in blocks or not np.array_equal(blocks[0]['frame/stamp'], blocks[1]['frame/stamp']):
        return {}
    drawn = [resampled({key: arrays[key] for key in BLOCK_ARRAYS}, 0, RESAMPLES)[:, 0]
             for arrays in blocks]
    found = {}
    for m in methods:
        a, b = (list(r['sequences'][key]['methods_order']).index(m)
                for r, key in ((first, name), (second, other)))
        edges = np.percentile(drawn[1][:, b] - drawn[0][:, a],
                              [(100 - COVERED) / 2, (100 + COVERED) / 2], axis=0)
        for k, key in enumerate(MEASURES):
            if number(edges[0, k]) is not None:
                found[m, key] = float(edges[0, k]), float(edges[1, k])
    return found


def _draw(folder: Path, pairs: list[tuple[str, str]], first: dict[str, Any],
          second: dict[str, Any], names: tuple[str, str]) -> None:
    """Draw both results: arrows from A to B, flicker against mean IoU."""
    from persem_ros.evaluate.show import page
    page.check()
    from persem_ros.evaluate.show import style
    with style.look():
        for name, other in pairs:
            figure = style.new_figure(6.2, 4.2)
            axes = figure.subplots()
            one, two = first['sequences'][name]['methods'], second['sequences'][other]['methods']
            measure = 'miou' if all(row['miou'] is not None for row in one.values()) else None
            for k, m in enumerate([m for m in one if m in two]):
                color, marker = style.STYLES[m]
                ends = [(row[m]['flicker'], row[m][measure] if measure else k)
                        for row in (one, two)]
                if None in ends[0] + ends[1]:
                    continue
                axes.annotate('', ends[1], ends[0],
                              arrowprops={'arrowstyle': '->', 'color': color})
                axes.plot(*ends[0], marker, color=color, markerfacecolor='white', markersize=7)
                axes.plot(*ends[1], marker, color=color, label=m, markersize=7)
            axes.set(xlabel=style.WORDS['flicker'], title=f'{names[0]} (hollow) to {names[1]}',
                     ylabel=style.WORDS[measure] if measure else 'method')
            figure.legend(loc='outside right upper')
            style.save(figure, folder / f'compare-{name}')
