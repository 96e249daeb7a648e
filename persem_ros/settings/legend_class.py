"""One class of a legend: what it says, how a file says it, what is refused."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
import math

from persem_ros.errors import PersemError
from persem_ros.frames import MAX_ID, UNKNOWN
from persem_ros.guard.words import short
from persem_ros.settings.palette import made_up
from persem_ros.settings.setting import nearest
import yaml

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

    def to_yaml(self) -> str:
        """Return the class as one line of YAML text."""
        flags = ''.join(f', {flag}: true' for flag in ('ignored', 'dynamic')
                        if getattr(self, flag))
        flags += ''.join(f', {key}: {getattr(self, key)}' for key in NUMBERS
                         if getattr(self, key) is not None)
        if self.height is not None:
            flags += f', height: [{", ".join(map(_edge, self.height))}]'
        return (f'{{id: {self.id}, name: {quoted(self.name)}, '
                f'color: {list(self.color)}, group: {quoted(self.group)}{flags}}}')


def class_of(row: object, where: str) -> LegendClass:
    """
    Return the LegendClass of one row of a legend's file.

    Raises
    ------
    PersemError
        Where it is none; *where* names the row.

    """
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
    ignored, dynamic = (_flag(row, key, where) for key in ('ignored', 'dynamic'))
    cost, las = (_number(row, key, where) for key in NUMBERS)
    if number > MAX_ID and not ignored:
        raise PersemError(f'{where}: id {number} means "no label": expected ignored: true')
    return LegendClass(number, name, _color(row.get('color'), number, where),
                       str(row.get('group') or name), ignored, dynamic, cost, las,
                       _height(row.get('height'), where))


def _flag(row: dict[str, object], key: str, where: str) -> bool:
    """Return whether a row has a flag."""
    value = row.get(key, False)
    if type(value) is not bool:
        raise PersemError(f'{where}: {key}: expected true or false, got {short(value)}')
    return value


def _number(row: dict[str, object], key: str, where: str) -> int | None:
    """Return one of NUMBERS of a row, None where it has none."""
    value = row.get(key)
    if value is None:
        return None
    if type(value) is not int or not 0 <= value <= NUMBERS[key]:
        raise PersemError(f'{where}: {key}: expected a whole number 0 .. {NUMBERS[key]}, got '
                          f'{short(value)}')
    return value


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


def _color(value: object, number: int, where: str) -> tuple[int, int, int]:
    """Return (red, green, blue) of [r, g, b], '#rrggbb' or nothing."""
    if value is None:
        red, green, blue = made_up()[number].tolist()
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


def _edge(value: float) -> str:
    """Return a number as YAML has it."""
    return repr(value) if math.isfinite(value) else f'{"-" * (value < 0)}.inf'


def quoted(text: str) -> str:
    """Return *text* as a YAML scalar that fits into one line."""
    if text.isascii() and text.isprintable():       # a hundred times as fast
        return '"' + text.replace('\\', '\\\\').replace('"', '\\"') + '"'
    return yaml.safe_dump(text, default_style='"', width=1 << 20, allow_unicode=True).strip()
