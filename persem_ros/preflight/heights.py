"""What a user should know of the heights of classes: whether they count, and whether they fit."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.settings import heights

if TYPE_CHECKING:
    from persem_ros.core.geometry.overruled import Overruled
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

SHOWN = 5       # classes in a sentence
IDS = 20        # ids in a sentence


def about_heights(config: Config, legend: Legend, methods: Collection[str],
                  seen_ids: NDArray[np.uint8]) -> Iterator[str]:
    """
    Yield what heights count for, and of which classes in vain.

    Parameters
    ----------
    config : Config
        All settings.
    legend : Legend
        What classes are called.
    methods : collection of str
        The methods that are measured, refine.method among them.
    seen_ids : ndarray, shape (65536,), uint8
        Whether an id was integrated.

    """
    given = config.refine.geometry.heights
    spans = heights.parsed(given)
    here = [one for one in spans if seen_ids[one[0]]]
    if 'geometry' not in methods:
        if here:
            names = _list([legend.name(c) for c, _, _ in here])
            yield (f'heights of {names} are given, by which the method geometry alone goes: '
                   '--set refine.method=geometry')
        return
    if here:
        said = _list([_span(legend, c, low, high, config) for c, low, high in here])
        yield (f'geometry goes by the heights of {said} above the ground; without them: '
               f'--set {heights.NAME}={heights.NONE}')
    missing = [str(c) for c, _, _ in spans if not seen_ids[c]]
    if missing and (not here or not given.startswith(heights.OF_LEGEND)):
        ids = np.flatnonzero(seen_ids).tolist()
        there = ', '.join(f'{c} ({legend.name(c)})' for c in ids[:IDS])
        more = f' and {len(ids) - IDS} more' if len(ids) > IDS else ''
        yield (f'{heights.NAME} or the legend give heights of classes that do not occur: '
               f'{", ".join(missing)}; expected ids that do: {there}{more}')


def about_overruled(config: Config, legend: Legend,
                    overruled: Iterable[Overruled]) -> Iterator[str]:
    """Name the classes whose heights the map contradicts."""
    found = [f'{_span(legend, one.label, one.low, one.high, config)} '
             f'({one.out / one.voxels:.0%} of its voxels by votes lie beyond, '
             f'{one.kept / one.out:.0%} of these keep the name)'
             for one in overruled if one.doubtful]
    if found:
        size = config.memory.voxel_size
        unit = 'metres' if _in_metres(config) else f'voxels (of {size:g} m)'
        yield (f'the votes contradict the heights of {_list(found)}: expected '
               f'{unit} above the ground, with a metre or two to spare, of the right class '
               '(or most labels of it are wrong, or the map holds a few seconds only); without '
               f'them: --set {heights.NAME}={heights.NONE}')


def _span(legend: Legend, c: int, low: float, high: float, config: Config) -> str:
    """Return a class and its heights, given in voxels, in the unit in which somebody said them."""
    size, unit = (config.memory.voxel_size, 'm') if _in_metres(config) else (1.0, 'voxels')
    return f'{legend.name(c)} {low * size:.3g} to {high * size:.3g} {unit}'


def _in_metres(config: Config) -> bool:
    """Return whether heights are those of a legend, and not of refine.geometry.heights."""
    return config.refine.geometry.heights.startswith(heights.OF_LEGEND)


def _list(words: list[str]) -> str:
    more = f' and {len(words) - SHOWN} more classes' if len(words) > SHOWN else ''
    return ', '.join(words[:SHOWN]) + more
