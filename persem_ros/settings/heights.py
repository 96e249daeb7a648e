"""Heights above the ground that classes keep to: hints for the method geometry."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
import math
from typing import TYPE_CHECKING

from persem_ros.errors import PersemError
from persem_ros.frames import MAX_ID
from persem_ros.guard.words import short

if TYPE_CHECKING:
    from persem_ros.settings.config import Config
    from persem_ros.settings.legend import Legend

NAME = 'refine.geometry.heights'
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
    for part in filter(str.strip, text.split(';')):
        try:
            number, low, high = part.split()
            c, span = int(number), (float(low), float(high))
        except ValueError:
            raise PersemError(f'{NAME}: expected class, lowest and highest height in voxels, as '
                              f'in {EXAMPLE}; got {short(part.strip())}') from None
        if not 0 <= c <= MAX_ID or math.isnan(sum(span)) or span[0] > span[1] or c in found:
            raise PersemError(f'{NAME}: expected each class (0 to {MAX_ID}) once and its lowest '
                              f'height first, as in {EXAMPLE}; got {short(part.strip())}')
        found[c] = span
    return tuple((c, low, high) for c, (low, high) in sorted(found.items()))


def hinted(config: Config, legend: Legend) -> Config:
    """
    Return the settings with the heights that a legend gives its classes, metres made voxels.

    What refine.geometry.heights says goes before.

    """
    constants, size = config.refine.geometry, config.memory.voxel_size
    spans = [(item.id, *(edge / size for edge in item.height)) for item in legend.classes
             if item.height is not None and item.id <= MAX_ID]
    if constants.heights or not spans:
        return config
    text = '; '.join(f'{c} {low:.6g} {high:.6g}' for c, low, high in spans)
    return replace(config, refine=replace(
        config.refine, geometry=replace(constants, heights=text)))
