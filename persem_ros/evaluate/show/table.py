"""The noun table: cells of numbers, written for a terminal, Markdown, LaTeX, CSV and JSON."""

from __future__ import annotations

from collections.abc import Sequence
import csv
from dataclasses import dataclass
import io
from typing import Any

ARROWS = {1: '↑', -1: '↓', 0: ''}
LATEX_ARROWS = {1: r' $\uparrow$', -1: r' $\downarrow$', 0: ''}


@dataclass(frozen=True)
class Column:
    """A column: its name, whether more (1) or less (-1) is better, its group's name."""

    name: str
    better: int = 0
    group: str = ''
    digits: int = 2
    signed: bool = False


@dataclass(frozen=True)
class Cell:
    """A number with an interval; best: to be set in bold."""

    value: float | str | None = None        # None: unknown
    low: float | None = None
    high: float | None = None
    best: bool = False


Row = tuple[tuple[str, ...], tuple[Cell, ...]]      # text in front, then the cells


@dataclass(frozen=True)
class Table:
    """
    A table.

    Attributes
    ----------
    key : str
        Name of its files.
    title : str
    head : tuple
        Names of the columns in front, which hold text.
    columns : tuple of Column
    rows : sequence of Row
    notes : tuple
    rules : tuple
        Rows before which a line is drawn.

    """

    key: str
    title: str
    head: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: Sequence[Row]
    notes: tuple[str, ...] = ()
    rules: tuple[int, ...] = ()


def marked(table: Table, floor: str = '(truth)') -> Table:
    """Return the table with the best cell of each column marked; the truth takes no part."""
    rows = [list(cells) for _, cells in table.rows]
    for k, column in enumerate(table.columns):
        known = [(value * column.better, i) for i, row in enumerate(rows)
                 for value in [row[k].value]
                 if column.better and isinstance(value, (int, float))
                 and floor not in table.rows[i][0]]
        rounded = [round(value, column.digits) for value, _ in known]
        if len(set(rounded)) < 2:
            continue
        for value, (_, i) in zip(rounded, known):
            if value == max(rounded):
                cell = rows[i][k]
                rows[i][k] = Cell(cell.value, cell.low, cell.high, True)
    return Table(table.key, table.title, table.head, table.columns,
                 [(head, tuple(row)) for (head, _), row in zip(table.rows, rows)],
                 table.notes, table.rules)


def text_of(cell: Cell, column: Column, minus: str = '-') -> str:
    """Return a cell as text: the number, its interval in brackets, a dash for unknown."""
    if cell.value is None:
        return '-'
    if isinstance(cell.value, str):
        return cell.value
    form = f'{{:{"+" if column.signed else ""},.{column.digits}f}}'
    text = form.format(cell.value).replace(',', ' ')
    if cell.low is not None:
        text += f' [{form.format(cell.low)}, {form.format(cell.high)}]'
    return text.replace('-', minus)


def console(table: Table) -> str:
    """Return the table as aligned plain text."""
    names = [f'{c.name} {ARROWS[c.better]}'.strip() for c in table.columns]
    groups = [c.group for c in table.columns]
    lines = [[*table.head, *names]]
    if any(groups):
        shown = ['' if k and g == groups[k - 1] else g for k, g in enumerate(groups)]
        lines.insert(0, [''] * len(table.head) + shown)
    for head, cells in table.rows:
        lines.append([*head, *(text_of(cell, column) + ('*' if cell.best else ' ')
                               for cell, column in zip(cells, table.columns))])
    n_head = len(table.head)
    top = len(lines) - len(table.rows)
    widths = [max(len(line[k]) for line in lines[top - 1:]) for k in range(len(lines[-1]))]
    out = [table.title]
    for i, line in enumerate(lines):
        if i == top or i - top in table.rules:
            out.append('-' * (sum(widths) + 2 * len(widths) - 2))
        out.append('  '.join(
            text.ljust(w) if k < n_head or i < top - 1 else text.rjust(w)
            for k, (text, w) in enumerate(zip(line, widths))).rstrip())
    return '\n'.join([*out, *table.notes])


def markdown(table: Table) -> str:
    """Return the table as GitHub's Markdown, the best in bold."""
    names = [f'{c.group}<br>{c.name} {ARROWS[c.better]}'.strip() if c.group
             else f'{c.name} {ARROWS[c.better]}'.strip() for c in table.columns]
    lines = [f'**{table.title}**', '', '| ' + ' | '.join([*table.head, *names]) + ' |',
             '|' + '---|' * len(table.head) + '---:|' * len(table.columns)]
    for head, cells in table.rows:
        texts = [text_of(cell, column, '−') for cell, column in zip(cells, table.columns)]
        texts = [f'**{t}**' if cell.best else t for t, cell in zip(texts, cells)]
        lines.append('| ' + ' | '.join([*(h.replace('|', r'\|') for h in head), *texts]) + ' |')
    return '\n'.join([*lines, *(f'\n{note}' for note in table.notes)]) + '\n'


def latex(table: Table) -> str:
    """Return the table as LaTeX for the package booktabs, in the paper's form."""
    groups = [c.group for c in table.columns]
    lines = [r'\begin{table}[t]', r'\centering',
             rf'\caption{{{escaped(" ".join([table.title + ".", *table.notes]))}}}',
             rf'\label{{tab:{table.key}}}', r'\setlength{\tabcolsep}{4pt}',
             rf'\begin{{tabular}}{{@{{}}{"l" * len(table.head)}{"c" * len(table.columns)}@{{}}}}',
             r'\toprule']
    if any(groups):
        lines += _spans(groups, len(table.head))
    lines.append(_row([*map(escaped, table.head),
                       *(escaped(c.name) + LATEX_ARROWS[c.better] for c in table.columns)]))
    lines.append(r'\midrule')
    for i, (head, cells) in enumerate(table.rows):
        if i in table.rules:
            lines.append(r'\midrule')
        texts = [escaped(text_of(c, column)) for c, column in zip(cells, table.columns)]
        texts = [f'${t}$' if column.signed and cell.value is not None else t
                 for t, cell, column in zip(texts, cells, table.columns)]
        lines.append(_row([*map(escaped, head), *(rf'\textbf{{{t}}}' if c.best else t
                                                  for t, c in zip(texts, cells))]))
    return '\n'.join([*lines, r'\bottomrule', r'\end{tabular}', r'\end{table}', ''])


def _spans(groups: list[str], offset: int) -> list[str]:
    """Return the line of group names above the columns and its rules."""
    spans, at = [], 0
    while at < len(groups):
        end = at
        while end < len(groups) and groups[end] == groups[at]:
            end += 1
        spans.append((groups[at], at + offset + 1, end + offset))
        at = end
    cells = [rf'\multicolumn{{{b - a + 1}}}{{c}}{{{escaped(name)}}}' for name, a, b in spans]
    return [_row([''] * offset + cells),
            ' '.join(rf'\cmidrule(lr){{{a}-{b}}}' for name, a, b in spans if name)]


def _row(cells: list[str]) -> str:
    return ' & '.join(cells) + r' \\'


def escaped(text: str) -> str:
    """Return text that LaTeX shows as it is."""
    special = {'\\': r'\textbackslash{}', '~': r'\textasciitilde{}', '^': r'\textasciicircum{}',
               'Δ': r'$\Delta$', '−': '$-$', '↑': r'$\uparrow$', '↓': r'$\downarrow$'}
    special |= {c: '\\' + c for c in '&%$#_{}'}
    return ''.join(special.get(c, c) for c in text)


def comma_separated(table: Table) -> str:
    """Return the table as CSV: full precision, an interval as two columns, unknown empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator='\n')
    with_interval = [any(cells[k].low is not None for _, cells in table.rows)
                     for k in range(len(table.columns))]
    names = [f'{c.group} {c.name}'.strip() for c in table.columns]
    writer.writerow([*table.head, *(title for name, wide in zip(names, with_interval)
                                    for title in [name] + [f'{name} low', f'{name} high'] * wide)])
    for head, cells in table.rows:
        values: list[float | str | None] = []
        for cell, wide in zip(cells, with_interval):
            values += [cell.value] + [cell.low, cell.high] * wide
        writer.writerow([*head, *('' if v is None else v for v in values)])
    return out.getvalue()


def as_json(table: Table) -> dict[str, Any]:
    """Return the table as a dict for JSON."""
    return {'title': table.title, 'head': list(table.head),
            'columns': [{'name': c.name, 'group': c.group, 'better': c.better}
                        for c in table.columns],
            'rows': [{'head': list(head), 'cells': [
                {'value': c.value} if c.low is None else
                {'value': c.value, 'low': c.low, 'high': c.high} for c in cells]}
                for head, cells in table.rows], 'notes': list(table.notes)}


FORMATS = {'md': markdown, 'tex': latex, 'csv': comma_separated}
