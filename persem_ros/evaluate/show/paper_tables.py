"""The tables of an evaluation, in the form of the paper's."""

from __future__ import annotations

from typing import Any

from persem_ros.evaluate.measure.combine import mean
from persem_ros.evaluate.measure.counts import PLACES
from persem_ros.evaluate.measure.intervals import FEWEST
from persem_ros.evaluate.measure.measures import BETTER, MEASURES
from persem_ros.evaluate.show.table import Cell, Column, marked, Row, Table

NAMES = {'pixel_accuracy': 'PA', 'miou': 'mIoU', 'flicker': 'Flicker'}
ABLATION = ('majority', 'trust', 'context', 'history', 'persem')
PLACE_NAMES = {'all': 'all valid', 'boundary': 'boundary', 'difficult_core': 'difficult core',
               'high_switch': 'high switch'}
TRUTH = '(truth)'


def tables(evaluation: dict[str, Any]) -> list[Table]:
    """
    Return the tables that can be made of an evaluation, in the paper's order.

    Parameters
    ----------
    evaluation : dict
        combine.combined.

    """
    methods, several = evaluation['methods'], len(evaluation['sequences']) > 1
    found = [main(evaluation)]
    if several:
        found.append(by_sequence(evaluation))
    found += [gains(evaluation, base) for base in ('majority', 'raw2d')
              if evaluation['differences'].get(base, {}).get('all')]
    if len(evaluation['sequences']) >= FEWEST and \
            evaluation['differences'].get('majority', {}).get('all'):
        found.append(between(evaluation))
    if evaluation['macro']['all']['sequences']:
        found.append(by_class(evaluation))
    if sum(m in methods for m in ABLATION) > 2:
        found.append(ablation(evaluation))
    if {'context_history', 'persem'} <= set(methods):
        found.append(trust(evaluation))
    if {'majority', 'persem'} <= set(methods):
        found.append(difficult(evaluation))
    return [*found, runtime(evaluation)]


def measures(group: str = '', signed: bool = False) -> tuple[Column, ...]:
    """Return the three columns of measures."""
    return tuple(Column(('Δ' if signed else '') + NAMES[key], BETTER[key], group, signed=signed)
                 for key in MEASURES)


def main(evaluation: dict[str, Any]) -> Table:
    """Return Table 1: all methods, macro-averaged."""
    rows = _method_rows(evaluation['macro']['all'], evaluation['methods'])
    return marked(Table('main', f'Main results, {_of(evaluation)}', ('method',), measures(), rows,
                        notes(evaluation), _rules(rows)))


def by_sequence(evaluation: dict[str, Any]) -> Table:
    """Return Table 1 sequence by sequence."""
    columns: tuple[Column, ...] = ()
    parts = []
    for name, summary in evaluation['sequences'].items():
        columns += measures(name)
        parts.append(_method_rows(summary['regions']['all'], evaluation['methods']))
    rows = [(row[0][0], tuple(cell for _, cells in row for cell in cells))
            for row in zip(*parts)]
    return marked(Table('sequences', 'Main results by sequence', ('method',), columns, rows,
                        notes(evaluation), _rules(rows)))


def gains(evaluation: dict[str, Any], base: str) -> Table:
    """Return the gains of all methods over one, with intervals."""
    found = evaluation['differences'][base]['all']
    n = len(evaluation['sequences'])
    rows = [((name,), tuple(_interval(row[key]) for key in MEASURES))
            for name, row in found.items()]
    if n > 1:
        rows = [((*head, *(f'{max(r["rises"], r["falls"])} of {n} '
                           f'{"up" if r["rises"] >= r["falls"] else "down"}'
                           for r in found[head[0]].values())), cells) for head, cells in rows]
    head = ('method',) + (('PA in', 'mIoU in', 'flicker in') if n > 1 else ())
    title = f'Difference from {base}, points, {_of(evaluation)}'
    return Table(f'gains_over_{base}', title, head, measures(signed=True), rows,
                 notes(evaluation, True))


def between(evaluation: dict[str, Any]) -> Table:
    """Return the gains over majority with intervals from sequences drawn with replacement."""
    found = evaluation['between_sequences']['majority']['all']
    rows = [((name,), tuple(_interval(row[key]) for key in MEASURES))
            for name, row in found.items()]
    how = evaluation['interval']
    return Table('between_sequences', f'Difference from majority, points, {_of(evaluation)} drawn '
                 'with replacement', ('method',), measures(signed=True), rows,
                 (*notes(evaluation), f'In brackets: {how["covered_percent"]:.0f} % intervals, '
                  f'whole sequences drawn with replacement, {how["resamples"]} resamples.'))


def by_class(evaluation: dict[str, Any]) -> Table:
    """Return the intersection over union of each class, mean of the sequences that have it."""
    summaries, methods = list(evaluation['sequences'].values()), evaluation['methods']
    names = {c['id']: c['name'] for s in summaries for c in s['classes']}
    rows = []
    for c in sorted({int(i) for s in summaries for i in s['methods'][methods[0]]['iou']}):
        rows.append(((names.get(c, str(c)),), tuple(Cell(mean(
            s['methods'][m]['iou'].get(str(c)) for s in summaries)) for m in methods)))
    return Table('classes', f'Intersection over union by class, {_of(evaluation)}', ('class',),
                 tuple(Column(m, 1) for m in methods), rows)


def ablation(evaluation: dict[str, Any]) -> Table:
    """Return Table 2: the components of the refinement."""
    rows = _method_rows(evaluation['macro']['all'],
                        [m for m in ABLATION if m in evaluation['methods']])
    return marked(Table('ablation', f'Component ablation, {_of(evaluation)}', ('variant',),
                        measures(), rows, notes(evaluation), (len(rows) - 1,)))


def trust(evaluation: dict[str, Any]) -> Table:
    """Return Table 3: what trust replay adds to context and history, scene by scene."""
    rows: list[Row] = []
    rules = []
    for name, summary in evaluation['sequences'].items():
        here = summary['regions']['all']
        gain = evaluation['by_sequence'][name]['context_history']['all']['persem']
        rules.append(len(rows))
        pair = Table('', '', (), measures(), [
            ((name if k == 0 else '', text), tuple(Cell(here['methods'][m][key])
                                                   for key in MEASURES))
            for k, (m, text) in enumerate((('context_history', 'context + history'),
                                           ('persem', 'full (+ trust)')))])
        rows += marked(pair).rows
        rows.append((('', 'difference'), tuple(_interval(gain[key]) for key in MEASURES)))
        rows.append((('', TRUTH), _truth_cells(here)))
    return Table('trust', 'What trust replay adds to context and history', ('scene', 'variant'),
                 measures(), rows, notes(evaluation, True), tuple(rules[1:]))


def difficult(evaluation: dict[str, Any]) -> Table:
    """Return Table 4: gains over majority in the difficult regions."""
    found, rows = evaluation['differences']['majority'], []
    for place in PLACES:
        macro = evaluation['macro'][place]
        rows.append(((PLACE_NAMES[place],), (
            Cell(macro['share']), *(_interval(found[place]['persem'][key]) for key in MEASURES),
            Cell(macro['truth_flicker']))))
    columns = (Column('Pixels, %'), *measures(signed=True), Column('Truth flicker'))
    return Table('regions', 'Difference of persem from majority in difficult regions, '
                 + _of(evaluation), ('region',), columns, rows, notes(evaluation, True))


def runtime(evaluation: dict[str, Any]) -> Table:
    """Return Table 5: time and memory by stage."""
    columns = (Column('Frames', digits=0), Column('Voxels', digits=0),
               Column('History, s'), Column('Refinement, s', digits=3),
               Column('Reproj., s'), Column('Total, s', digits=1), Column('Map, MB', digits=1),
               Column('Peak, MB', digits=0), Column('Truth flicker'))
    rows = []
    for name, summary in evaluation['sequences'].items():
        run = summary['runtime']
        refinement = run['refinement_s']
        rows.append([name, summary['frames']['used'], summary['voxels'], run['history_s'],
                     refinement.get('persem', max(refinement.values(), default=None)),
                     run['reprojection_s'], run['total_s'], run['map_bytes'] / 1e6,
                     run['peak_bytes'] / 1e6, summary['truth_flicker']])
    if len(rows) > 1:
        rows.append(['mean', *(mean(row[k] for row in rows) for k in range(1, len(rows[0])))])
    threads = sorted({s['runtime']['threads'] for s in evaluation['sequences'].values()})
    note = (f'Threads: {", ".join(map(str, threads))}. Refinement is that of persem; total is '
            'the evaluation of all methods, reading included.')
    return Table('runtime', 'Time and peak memory', ('sequence',), columns,
                 [((str(row[0]),), tuple(Cell(v) for v in row[1:])) for row in rows], (note,))


def notes(evaluation: dict[str, Any], intervals: bool = False) -> tuple[str, ...]:
    """Return what the reader of a table must know."""
    macro, n = evaluation['macro']['all'], len(evaluation['sequences'])
    lines = []
    if not macro['sequences']:
        lines.append('No truth in the recordings: accuracy unknown, flicker only.')
    elif macro['sequences'] < n:
        lines.append(f'Truth in {macro["sequences"]} of {n} recordings only: accuracy is the '
                     'mean of those.')
    else:
        lines.append(f"The truth's own flicker, the floor that camera motion sets: "
                     f'{macro["truth_flicker"]:.2f}.' if macro['truth_flicker'] is not None
                     else 'Too few frames for flicker.')
    if evaluation['taxonomy'] != 'all ids':
        lines.append(f'Taxonomy: {evaluation["taxonomy"]}.')
    if intervals:
        how = evaluation['interval']
        lines.append(f'In brackets: {how["covered_percent"]:.0f} % intervals, '
                     f'{how["how"]}, {how["resamples"]} resamples.')
    return tuple(lines)


def _method_rows(region: dict[str, Any], methods: list[str]) -> list[Row]:
    """Return a row per method and the truth's, of a region of a summary or of the macro."""
    rows: list[Row] = [((name,), tuple(Cell(region['methods'][name][key]) for key in MEASURES))
                       for name in methods]
    return [*rows, ((TRUTH,), _truth_cells(region))]


def _truth_cells(region: dict[str, Any]) -> tuple[Cell, ...]:
    return tuple(Cell(region['truth_flicker'] if key == 'flicker' else None) for key in MEASURES)


def _of(evaluation: dict[str, Any]) -> str:
    """Return what a table is about: the sequence, or how many."""
    names = list(evaluation['sequences'])
    return names[0] if len(names) == 1 else f'mean of {len(names)} sequences'


def _interval(row: dict[str, float | None]) -> Cell:
    return Cell(row['value'], row['low'], row['high'])


def _rules(rows: list[Row]) -> tuple[int, ...]:
    """Return where the kinds of methods are set apart, as in the paper."""
    names = [head[0] for head, _ in rows]
    return tuple(names.index(name) for name in ('majority', 'trust', 'persem', TRUTH)
                 if name in names and names.index(name))
