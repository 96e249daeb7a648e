"""Heights above the ground that classes keep to: hints for the method geometry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.guard.words import short

if TYPE_CHECKING:
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

NAME = 'refine.geometry.heights'
MAX_ID = 65534          # frames.MAX_ID, without the NumPy that frames imports: --help is instant
NONE, OF_LEGEND = 'none', 'legend:'     # no heights, whatever the legend says; those it said
EXAMPLE = "'3 -2 2; 5 4 inf' (class 3 from 2 voxels below the ground to 2 above it, 5 from 4 up)"


@lru_cache(maxsize=16)
def parsed(text: str) -> tuple[tuple[int, float, float], ...]:
    """
    Return (class, lowest, highest) of the setting refine.geometry.heights, in voxels.

    Raises
    ------
    PersemError
        For a text that does not say so.

    """
    found: dict[int, tuple[float, float]] = {}
    text = '' if text.strip() == NONE else text.removeprefix(OF_LEGEND)
    for part in filter(str.strip, text.split(';')):
        try:
            number, low, high = part.split()
            c, span = int(number), (float(low), float(high))
        except ValueError:
            raise PersemError(f'{NAME}: expected id, lowest and highest height in voxels, classes '
                              f'parted by ";", as in {EXAMPLE}, or {NONE}; got '
                              f'{short(part.strip())}') from None
        if not 0 <= c <= MAX_ID or not span[0] <= span[1] or c in found:     # false for NaN
            raise PersemError(f'{NAME}: expected each id (0 to {MAX_ID}) once and its lowest '
                              f'height first, as in {EXAMPLE}; got {short(part.strip())}')
        found[c] = span
    return tuple((c, low, high) for c, (low, high) in sorted(found.items()))


def hinted(config: Config, legend: Legend) -> Config:
    """
    Return the settings with the heights that a legend gives its classes, metres made voxels.

    What somebody typed for refine.geometry.heights goes before; what came of a legend is marked
    as such (OF_LEGEND), so that settings of a run can be given back with another one.

    """
    constants, size = config.refine.geometry, config.memory.voxel_size
    spans = [(item.id, item.height[0] / size, item.height[1] / size) for item in legend.classes
             if item.height is not None and item.id <= MAX_ID]
    if constants.heights and not constants.heights.startswith(OF_LEGEND):
        return config
    text = f'{OF_LEGEND} {_text(spans)}' if spans else ''
    if text == constants.heights:
        return config
    return replace(config, refine=replace(
        config.refine, geometry=replace(constants, heights=text)))


def canonical(text: str) -> str:
    """Return the same heights, however they were written."""
    return _text(parsed(text))


def _text(spans: Iterable[tuple[int, float, float]]) -> str:
    return '; '.join(f'{c} {low:.6g} {high:.6g}' for c, low, high in sorted(spans))
