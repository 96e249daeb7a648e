"""The noun legend: what a class id is called, its colour, its group."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
import logging
import math
import os
from pathlib import Path
import site
import sys
import sysconfig
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.frames import MAX_ID, UNKNOWN
from persem_ros.guard import yaml_text
from persem_ros.guard.words import short
from persem_ros.settings.config import nearest
import yaml

LOG = logging.getLogger(__name__)
GREY = 96, 96, 96       # of ids that the settings ignore
FIELDS = ('id', 'name', 'color', 'group', 'ignored', 'dynamic', 'cost', 'las', 'height')
NUMBERS = {'cost': 100, 'las': 255}     # the largest; the least is 0


@dataclass(frozen=True)
class LegendClass:
    """
    One class.

    Attributes
    ----------
    id : int
        0 .. 65535 (65535 and 255 usually stand for "no label").
    name : str
        As shown to people; not trusted, escape it in HTML.
    color : tuple of int
        Red, green, blue, 0 .. 255.
    group : str
        The coarser class it belongs to; its own name where the file names none.
    ignored : bool
        Not a class but the absence of one: neither mapped nor counted.
    dynamic : bool
        A thing that moves by itself: vehicles, people.
    cost : int or None
        What crossing it costs a vehicle on the ground, 0 (free) .. 100 (lethal); None: not said.
    las : int or None
        Its code in LAS files, 0 .. 255 (ASPRS: 2 ground, 5 high vegetation, 6 building, 9 water,
        11 road, 64 and above free to use); None: not said.
    height : (float, float) or None
        Lowest and highest height above the ground where it is found, metres; None: not said.

    """

    id: int         # noqa: A003 - the word of the file format
    name: str
    color: tuple[int, int, int]
    group: str = ''
    ignored: bool = False
    dynamic: bool = False
    cost: int | None = None
    las: int | None = None
    height: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Legend:
    """
    The classes of a data set, in the order of its file.

    A legend without classes is a valid one: every id then has a made-up colour and name.
    unlabelled holds ids that the settings ignore: grey and called so, unless they are classes.

    """

    title: str = ''
    classes: tuple[LegendClass, ...] = ()
    _warned: list[int] = field(default_factory=list, repr=False)
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
        classes = tuple(_class(row, f'{source}: classes[{i}]') for i, row in enumerate(rows))
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
        lines = [f'title: {_scalar(self.title)}', 'classes:']
        for item in self.classes:
            flags = ''.join(f', {flag}: true' for flag in ('ignored', 'dynamic')
                            if getattr(item, flag))
            flags += ''.join(f', {key}: {getattr(item, key)}' for key in NUMBERS
                             if getattr(item, key) is not None)
            if item.height is not None:
                flags += f', height: [{", ".join(map(_edge, item.height))}]'
            lines.append(f'- {{id: {item.id}, name: {_scalar(item.name)}, '
                         f'color: {list(item.color)}, group: {_scalar(item.group)}{flags}}}')
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
        """
        Return the colours of an array of ids.

        An id that the legend does not know has a colour of its own, the same in every run, and
        is warned about once. Negative ids and ids above 65535 are black.

        Parameters
        ----------
        ids : ndarray of integers, any shape
            Class ids.

        Returns
        -------
        ndarray, shape (*ids.shape, 3), uint8
            Red, green, blue.

        """
        ids = np.asarray(ids)
        if ids.dtype == np.uint8 and ids.ndim == 2 and ids.size:
            return self._colors_of_bytes(ids)
        if ids.dtype not in (np.uint8, np.uint16):
            ids = ids.astype(np.int64)      # NumPy 2.5 refuses 65535 among int16
            ids = np.where((ids < 0) | (ids > UNKNOWN), UNKNOWN, ids).astype(np.uint16)
        packed = self._palette.take(ids)            # four bytes a pixel: one move, not three
        if self.classes and not self._warned:
            self._warn(packed, ids)
        if not packed.size:
            return np.zeros((*ids.shape, 3), np.uint8)
        # OpenCV drops the fourth byte forty times as fast as a slice of NumPy's.
        pixels = np.ascontiguousarray(packed).view(np.uint8).reshape(1, -1, 4)
        colors: NDArray[np.uint8] = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB), np.uint8)
        return colors.reshape(*ids.shape, 3)

    def _colors_of_bytes(self, ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return colors() of an image of bytes, by OpenCV."""
        packed = self._palette[:256]
        table = packed.view(np.uint8).reshape(256, 1, 4)
        if self.classes and not self._warned and not cv2.LUT(ids, table[:, 0, 3].copy()).all():
            self._warn(packed.take(ids), ids)
        return np.asarray(cv2.applyColorMap(ids, table[..., :3].copy()), np.uint8)

    def _warn(self, packed: NDArray[np.uint32], ids: NDArray[Any]) -> None:
        """Log the ids that the legend does not know, once in its life."""
        strange = packed.view(np.uint8).reshape(*ids.shape, 4)[..., 3] == 0
        if strange.any():
            self._warned.extend(np.unique(ids[strange]).tolist())
            LOG.warning('ids %s are not in the legend%s, their colours are made up',
                        ', '.join(map(str, self._warned[:20])),
                        f' {self.title!r}' if self.title else '')

    @cached_property
    def _by_id(self) -> dict[int, LegendClass]:
        return {item.id: item for item in self.classes}

    @cached_property
    def _palette(self) -> NDArray[np.uint32]:
        """Red, green, blue and "known" of every id as one uint32, shape (65536,)."""
        table = np.zeros((UNKNOWN + 1, 4), np.uint8)
        table[:, :3] = _made_up()
        table[list(self.unlabelled)] = *GREY, 1
        table[UNKNOWN] = 0, 0, 0, 1
        for item in self.classes:
            table[item.id] = *item.color, 1
        return table.view(np.uint32).ravel()


def made_up_colors(ids: NDArray[np.integer[Any]] | list[int]) -> NDArray[np.uint8]:
    """Return distinct colours, shape (n, 3), uint8, for ids without a legend; fixed per id."""
    ids = np.asarray(ids, np.int64)
    hue = ids * 0.6180339887498949 % 1.0            # the golden ratio never comes near itself
    value = np.choose(ids % 3, (0.95, 0.72, 0.5))
    chroma = value * np.choose(ids // 3 % 2, (0.75, 0.5))
    ramp = np.abs((hue[:, None] * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1
    return np.rint(255 * (value[:, None] - chroma[:, None] * (1 - ramp.clip(0, 1)))) \
        .astype(np.uint8)


@cache
def _made_up() -> NDArray[np.uint8]:
    """Return the made-up colours of all ids, once a process: 40 ms."""
    return made_up_colors(np.arange(UNKNOWN + 1))


def load_legend(name: Path | str) -> Legend:
    """
    Return the Legend of a shipped name (town, uavscenes, forest, cityscapes) or of a file.

    Raises
    ------
    PersemError
        When there is neither, or the file is not a legend.

    """
    shipped = shipped_legends()
    path = shipped.get(str(name)) or Path(name)
    if not str(name) or not path.is_file():
        raise PersemError(f'legend {str(name)!r}: neither a file nor a shipped legend'
                          f'{nearest(name, shipped)}; shipped: {", ".join(shipped)}')
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise PersemError(f'{path}: cannot be read as text: {_one_line(error)}') from None
    return Legend.from_yaml(text, str(path))


def shipped_legends() -> dict[str, Path]:
    """Return {name: path} of the legends that came with the package."""
    for folder in _folders():
        files = sorted(folder.glob('*.yaml'))
        if files:
            return {path.stem: path for path in files}
    raise PersemError('the shipped legends are missing: expected share/persem_ros/config/labels '
                      "below the installation's prefix; reinstall persem_ros")


def _folders() -> Iterator[Path]:
    """Yield where config/labels may be: source tree, environment, ROS prefixes."""
    root = Path(__file__).resolve().parents[2]
    yield root / 'config' / 'labels'
    prefixes: list[str | Path | None] = [
        sys.prefix, sysconfig.get_path('data'), site.getuserbase(), root,
        *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
    for prefix in prefixes:
        if prefix:
            yield Path(prefix) / 'share' / 'persem_ros' / 'config' / 'labels'


def _class(row: object, where: str) -> LegendClass:
    """Return the LegendClass of one row of the file, or refuse it."""
    if not isinstance(row, dict):
        raise PersemError(f'{where}: expected {{id, name, color, ...}}, got {short(row)}')
    for key in row:
        if key not in FIELDS:
            raise PersemError(f'{where}: unknown key {short(key)}{nearest(key, FIELDS)}; known: '
                              f'{", ".join(FIELDS)}')
    number, name = row.get('id'), row.get('name')
    if type(number) is not int or not 0 <= number <= UNKNOWN:
        raise PersemError(
            f'{where}: id: expected an integer 0 .. {UNKNOWN}, got {short(number)}')
    if not isinstance(name, str) or not name.strip():
        raise PersemError(f'{where}: name: expected text, got {short(name)} (quote words like no)')
    flags: dict[str, bool] = {}
    for flag in ('ignored', 'dynamic'):
        value = row.get(flag, False)
        if type(value) is not bool:
            raise PersemError(f'{where}: {flag}: expected true or false, got {short(value)}')
        flags[flag] = value
    numbers: dict[str, int | None] = {}
    for key in NUMBERS:
        value = row.get(key)
        if value is not None and (type(value) is not int or not 0 <= value <= NUMBERS[key]):
            raise PersemError(f'{where}: {key}: expected a whole number 0 .. {NUMBERS[key]}, got '
                              f'{short(value)}')
        numbers[key] = value
    if number > MAX_ID and not flags['ignored']:
        raise PersemError(f'{where}: id {number} means "no label": expected ignored: true')
    return LegendClass(number, name, _color(row.get('color'), number, where),
                       str(row.get('group') or name), flags['ignored'], flags['dynamic'],
                       numbers['cost'], numbers['las'], _height(row.get('height'), where))


def _height(value: object, where: str) -> tuple[float, float] | None:
    """Return (lowest, highest) of [low, high] in metres, None of nothing."""
    if value is None:
        return None
    if isinstance(value, list) and len(value) == 2 and \
            all(type(v) in (int, float) for v in value) and value[0] <= value[1]:   # false for NaN
        with suppress(OverflowError):
            return float(value[0]), float(value[1])
    raise PersemError(f'{where}: height: expected [lowest, highest] in metres above the ground, '
                      'the lowest first, infinity as .inf: for example [-1, 1] or [2, .inf]; got '
                      f'{short(value)}')


def _edge(value: float) -> str:
    """Return a number as YAML has it."""
    return repr(value) if math.isfinite(value) else f'{"-" * (value < 0)}.inf'


def _color(value: object, number: int, where: str) -> tuple[int, int, int]:
    """Return (red, green, blue) of [r, g, b], '#rrggbb' or nothing."""
    if value is None:
        red, green, blue = _made_up()[number].tolist()
        return red, green, blue
    if isinstance(value, str) and len(value) == 7 and value[0] == '#':
        try:
            red, green, blue = bytes.fromhex(value[1:])
            return red, green, blue
        except ValueError:
            pass
    if isinstance(value, list) and len(value) == 3 and \
            all(type(v) is int and 0 <= v <= 255 for v in value):
        return value[0], value[1], value[2]
    raise PersemError(f"{where}: color: expected [red, green, blue] of 0 .. 255 or '#rrggbb', "
                      f'got {short(value)}')


def _scalar(text: str) -> str:
    """Return *text* as a YAML scalar that fits into one line."""
    if text.isascii() and text.isprintable():       # a hundred times as fast
        return '"' + text.replace('\\', '\\\\').replace('"', '\\"') + '"'
    return yaml.safe_dump(text, default_style='"', width=1 << 20, allow_unicode=True).strip()


def _one_line(error: Exception) -> str:
    return ' '.join(str(error).split())
