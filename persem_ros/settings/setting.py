"""One setting: how it is declared, and what its values must be: type, range, choices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field
import difflib
import math
from typing import Any

from persem_ros.errors import PersemError
from persem_ros.guard.words import short

ONE: dict[type, str] = {float: 'a number', int: 'a whole number', bool: 'true or false',
                        str: 'text'}
MANY: dict[type, str] = {float: 'numbers', int: 'whole numbers', str: 'texts'}


def setting(
        default: Any, text: str, unit: str = '', low: float | None = None,
        high: float | None = None, choices: tuple[str, ...] | None = None, live: bool = True
) -> Any:
    """
    Declare one setting.

    Parameters
    ----------
    default : bool, int, float, str or tuple
        The value where nothing else is given; its type is the setting's type.
    text : str
        The sentence shown in help texts, documentation and ROS parameter descriptions.
    unit : str
        Unit of the value, empty where it has none.
    low, high : number, optional
        Inclusive range of the value.
    choices : tuple of str, optional
        The only values allowed.
    live : bool
        False where a change while mapping would make the map inconsistent.

    """
    return field(default=default, metadata={
        'help': text, 'unit': unit, 'low': low, 'high': high, 'choices': choices, 'live': live})


def nearest(name: object, known: Iterable[object]) -> str:
    """Return ", did you mean 'x'?" for the name in *known* that is nearest, or ''."""
    word = str(name)[:200] if isinstance(name, (str, int, float)) else ''
    words = [str(k) for k in known]
    near = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    if not near:
        tail = word.rpartition('.')[2]
        near = [k for k in words if k.rpartition('.')[2] == tail][:1]
    return f', did you mean {near[0]!r}?' if near else ''


def checked(name: str, value: Any, default: Any, meta: Mapping[str, Any]) -> Any:
    """Return *value* in the type of *default*, or refuse it."""
    kind = type(default)
    if hasattr(value, 'tolist'):    # NumPy's numbers and arrays; nothing here imports it
        value = value.tolist()
    if kind is tuple:
        value = [value] if isinstance(value, (str, int, float)) else value
        inner = type(default[0])
        try:
            result = tuple(checked(name, item, default[0], {}) for item in value)
        except TypeError:
            raise PersemError(f'{name}: expected a list of {MANY[inner]}, for example '
                              f'{list(default)}, got {short(value)}') from None
        if name in ('map.origin', 'map.georeference', 'pose.extrinsic') and \
                len(result) != len(default):
            raise PersemError(f'{name}: expected {len(default)} numbers, got {len(result)}')
        return result or default[:0]
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind or (kind is float and not math.isfinite(value)):
        raise PersemError(f'{name}: expected {_words(kind, default, meta)}, got {short(value)}')
    if meta.get('choices') and value not in meta['choices']:
        raise PersemError(f'{name}: expected one of {", ".join(meta["choices"])}, '
                          f'got {short(value)}{nearest(value, meta["choices"])}')
    low, high = meta.get('low'), meta.get('high')
    if (low is not None and value < low) or (high is not None and value > high):
        unit = f' {meta["unit"]}' if meta.get('unit') else ''
        raise PersemError(f'{name}: expected {low} to {high}{unit}, got {short(value)}')
    return value


def _words(kind: type, default: object, meta: Mapping[str, Any]) -> str:
    """Return what a value should be, in words: a number (m), for example 0.5."""
    unit = f' ({meta["unit"]})' if meta.get('unit') else ''
    if kind in (bool, str):
        return ONE[kind]
    return f'{ONE[kind]}{unit}, for example {default!r}'
