"""The noun legend: what a class id is called, its colour, its group."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.frames import UNKNOWN
from persem_ros.guard import yaml_text
from persem_ros.guard.words import short
from persem_ros.settings.legend_class import class_of, LegendClass, quoted
from persem_ros.settings.palette import Palette


@dataclass(frozen=True, eq=False)
class Legend:
    """
    The classes of a data set, in the order of its file.

    A legend without classes is a valid one: every id then has a made-up colour and name.
    unlabelled holds ids that the settings ignore: grey and called so, unless they are classes.

    """

    title: str = ''
    classes: tuple[LegendClass, ...] = ()
    unlabelled: tuple[int, ...] = ()

    def __eq__(self, other: object) -> bool:    # and therefore without a hash
        """Legends are equal when their classes are, whatever they are called."""
        return isinstance(other, Legend) and self.classes == other.classes

    @classmethod
    def from_yaml(cls, text: str, source: str = 'legend') -> Legend:
        """
        Read a legend from YAML text; *source* names it in refusals.

        Raises
        ------
        PersemError
            When the text is not a legend: one line that names the class and what is wrong.

        """
        content = yaml_text.load(text, source, yaml_text.LEGEND)
        rows = content.get('classes') if isinstance(content, dict) else None
        if not isinstance(rows, list) or not rows:
            raise PersemError(f"{source}: expected a mapping with a list 'classes' of "
                              '{id, name, color, group, ignored, dynamic, cost, las, height}')
        classes = tuple(class_of(row, f'{source}: {_entry(row, i)}') for i, row in enumerate(rows))
        seen: dict[int, str] = {}
        for item in classes:
            if item.id in seen:
                raise PersemError(f'{source}: id {item.id} is given twice, to '
                                  f'{short(seen[item.id])} and {short(item.name)}; ids are unique')
            seen[item.id] = item.name
        return cls(str(content.get('title', ''))[:1000], classes)

    def ignoring(self, ids: Iterable[int]) -> Legend:
        """Return the same legend, to which the *ids* that are no class of it are ignored ones."""
        return Legend(self.title, self.classes, unlabelled=tuple(
            c for c in ids if 0 <= c <= UNKNOWN and c not in self.ids))

    def to_yaml(self) -> str:
        """Return the legend as YAML text, one line a class; from_yaml reads it back."""
        lines = [f'title: {quoted(self.title)}', 'classes:']
        lines += [f'- {item.to_yaml()}' for item in self.classes]
        return '\n'.join(lines) + '\n' if self.classes else ''

    @property
    def ids(self) -> tuple[int, ...]:
        """All ids of the legend, in its order."""
        return tuple(item.id for item in self.classes)

    @property
    def ignored(self) -> tuple[int, ...]:
        """Return the ids that are not observations."""
        return tuple(item.id for item in self.classes if item.ignored)

    @property
    def dynamic(self) -> tuple[int, ...]:
        """Return the ids of things that move."""
        return tuple(item.id for item in self.classes if item.dynamic)

    def name(self, label: int) -> str:
        """Return the name of a class id, 'class 7' for an id that the legend does not know."""
        item = self._by_id.get(int(label))
        if item is None and int(label) in self.unlabelled:
            return 'ignored'
        return item.name if item else f'class {int(label)}'

    def numbers(self, key: str) -> dict[int, int]:
        """Return {id: value} of the classes that have the key 'cost' or 'las'."""
        return {item.id: getattr(item, key) for item in self.classes
                if getattr(item, key) is not None}

    def groups(self) -> dict[str, tuple[int, ...]]:
        """Return {group: ids}, ignored ids left out, in the order of the legend."""
        result: dict[str, tuple[int, ...]] = {}
        for item in self.classes:
            if not item.ignored:
                result[item.group] = result.get(item.group, ()) + (item.id,)
        return result

    def color(self, label: int) -> tuple[int, int, int]:
        """Return the colour (red, green, blue) of one class id."""
        red, green, blue = self.colors(np.array([label], np.int32))[0].tolist()
        return red, green, blue

    def colors(self, ids: NDArray[Any]) -> NDArray[np.uint8]:
        """Return the colour of each id, shape (*ids.shape, 3), uint8; see Palette."""
        return self._palette.colors(ids)

    @cached_property
    def _by_id(self) -> dict[int, LegendClass]:
        return {item.id: item for item in self.classes}

    @cached_property
    def _palette(self) -> Palette:
        return Palette({item.id: item.color for item in self.classes}, self.unlabelled,
                       self.title)


def _entry(row: object, i: int) -> str:
    """Return what a row of a legend's file is called in refusals: its place, its name or id."""
    called = [short(row[key]) for key in ('name', 'id') if row.get(key) is not None] \
        if isinstance(row, dict) else []
    return f'classes[{i}]' + (f' ({called[0]})' if called else '')
