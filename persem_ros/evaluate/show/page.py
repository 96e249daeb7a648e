"""report.html of an evaluation: one file, in the style of the replay's."""

from __future__ import annotations

from datetime import datetime, timezone
import functools
from typing import Any, TYPE_CHECKING

import jinja2
from persem_ros.errors import PersemError
from persem_ros.evaluate.show import table
from persem_ros.evaluate.show.paper_tables import tables
from persem_ros.outputs.files import write_text
from persem_ros.outputs.report import page
from persem_ros.outputs.report.png import data_uri
from persem_ros.settings.config import IMAGE_METHODS, settings
from persem_ros.settings.legend import Legend

if TYPE_CHECKING:
    from pathlib import Path

    from persem_ros.evaluate.measure.result import Result

RASTER = ('panels', 'map')      # figures that are pictures: as PNG in the page


def write(folder: Path, evaluation: dict[str, Any],
          results: dict[str, Result]) -> None:
    """
    Draw all figures of an evaluation below *folder* and write its report.html.

    Parameters
    ----------
    folder : Path
        Of the evaluation.
    evaluation : dict
        combine.combined, with versions, hardware and settings.
    results : dict
        By sequence.

    Raises
    ------
    PersemError
        Where matplotlib is missing.

    """
    check()
    from persem_ros.evaluate.show import sequence_figures, style, summary_figures
    shown: dict[str, list[dict[str, str]]] = {'': []}
    with style.look():
        for name, caption, drawn in summary_figures.figures(evaluation):
            shown[''].append(figure(name, caption, style.save(
                drawn, folder / 'figures' / name)))
        for sequence, (summary, arrays) in results.items():
            legend = legend_of(summary)
            shown[sequence] = [figure(name, caption, style.save(
                drawn, folder / 'figures' / name)) for name, caption, drawn in
                sequence_figures.figures(sequence, summary, arrays, legend)]
    write_text(folder / 'report.html', render(evaluation, shown))


def check() -> None:
    """Refuse to draw without matplotlib."""
    try:
        import matplotlib  # noqa: F401 - only whether it is there
    except ImportError as error:
        raise PersemError(f'figures need matplotlib ({error}); install it with: pip install '
                          "'.[evaluate]', or leave them out with --no-figures") from None


def render(evaluation: dict[str, Any], figures: dict[str, list[dict[str, str]]]) -> str:
    """Return the page as text; figures: lists of figure() by sequence, '' for all together."""
    found = {item.key: item for item in tables(evaluation)}
    defaults = {name: list(v) if isinstance(v, tuple) else v for name, v, _ in settings()}
    return environment().get_template('evaluation.html').render(
        evaluation=evaluation, macro=evaluation['macro']['all'], tables=found, figures=figures,
        names=list(evaluation['sequences']), **common(),
        cards=_cards(evaluation), has_truth=bool(evaluation['macro']['all']['sequences']),
        changed=[(name, value, defaults.get(name)) for name, value in
                 evaluation['settings'].items() if value != defaults.get(name)])


def common() -> dict[str, Any]:
    """Return what all pages of this package need."""
    return {'text_of': table.text_of, 'arrows': table.ARROWS,
            'written': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC')}


@functools.lru_cache(maxsize=1)
def environment() -> jinja2.Environment:
    """Return our templates before the replay's; everything that they show is escaped."""
    ours = page.environment()
    assert ours.loader is not None, 'the templates of the replay are in the package'
    return ours.overlay(loader=jinja2.ChoiceLoader([
        jinja2.PackageLoader('persem_ros.evaluate.show', 'templates'), ours.loader]))


def legend_of(summary: dict[str, Any]) -> Legend:
    """Return the Legend that names and colours a sequence's classes."""
    return Legend.from_yaml(summary['legend']) if summary['legend'] else Legend()


def figure(name: str, caption: str, images: dict[str, bytes]) -> dict[str, str]:
    """Return what the page shows of a figure."""
    raster = name.partition('-')[0] in RASTER
    uri = data_uri('image/png', images['png']) if raster \
        else data_uri('image/svg+xml', images['svg'])
    return {'name': name, 'caption': caption, 'uri': uri}


def _cards(evaluation: dict[str, Any]) -> tuple[str, list[dict[str, float | str | None]]]:
    """Return the three numbers at the top: of raw2d and of the best method."""
    rows = evaluation['macro']['all']['methods']
    before = rows.get('raw2d')
    name = _best(rows)
    return name, [{'title': title, 'before': before and before[key], 'after': rows[name][key],
                   'gain': None if not before or before[key] is None else
                   sign * (rows[name][key] - before[key]),
                   'floor': evaluation['macro']['all']['truth_flicker']
                   if key == 'flicker' else None}
                  for key, title, sign in (('pixel_accuracy', 'pixel accuracy', 1),
                                           ('miou', 'mean IoU', 1), ('flicker', 'flicker', -1))]


def _best(rows: dict[str, dict[str, float | None]]) -> str:
    """Return the method on voxels with the highest mean IoU, or the least flicker, or the last."""
    names = [name for name in rows if name not in IMAGE_METHODS] or list(rows)
    for key, sign in (('miou', 1), ('flicker', -1)):
        known = {name: sign * value for name in names
                 if (value := rows[name][key]) is not None}
        if known:
            return max(known, key=lambda name: known[name])
    return names[-1]
