"""Which voxels of a map are meant: by observations, by place, by class."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from persem_ros.errors import PersemError
from persem_ros.settings.config import nearest
from persem_ros.settings.legend import Legend


@dataclass(frozen=True)
class Choice:
    """
    Which voxels are meant; a box without an inside is refused (PersemError).

    Attributes
    ----------
    min_observations : int
    crop : tuple of 6 float, optional
        x0 y0 z0 x1 y1 z1 in metres in the map frame; a voxel's centre must lie within.
    labels : frozenset of int
        Only these refined labels; empty: all.
    gone : bool
        Whether voxels whose content moved away are among them.

    """

    min_observations: int = 1
    crop: tuple[float, ...] | None = None
    labels: frozenset[int] = frozenset()
    gone: bool = False

    def __post_init__(self) -> None:
        """Look at the box."""
        if self.crop is not None and not (len(self.crop) == 6 and all(
                low < high for low, high in zip(self.crop[:3], self.crop[3:]))):
            raise PersemError('a box: expected x0 y0 z0 x1 y1 z1 with x0 < x1, y0 < y1 and '
                              f'z0 < z1, got {" ".join(f"{x:g}" for x in self.crop)}')


def labels_of(words: Iterable[int | str], legend: Legend) -> frozenset[int]:
    """
    Return the ids of classes that are given by name or id.

    Raises
    ------
    PersemError
        For a name that the legend does not have.

    """
    by_name = {legend.name(c): c for c in legend.ids}
    found = set()
    for word in words:
        if isinstance(word, str) and word not in by_name and not word.isdigit():
            raise PersemError(f'there is no class {word!r}{nearest(word, by_name)}; the map has '
                              + (', '.join(list(by_name)[:20]) or 'no legend: give ids'))
        found.add(by_name.get(word, word) if isinstance(word, str) else word)
    return frozenset(map(int, found))
