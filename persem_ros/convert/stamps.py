"""Stamps in integer nanoseconds, from text: floats since 1970 resolve only 240 ns."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal, InvalidOperation
from pathlib import Path
import re

from persem_ros.convert.files import canonical, read_lines
from persem_ros.errors import PersemError

MAX_SECONDS = 2**31             # builtin_interfaces/Time.sec is an int32
DIGITS_TO_NS = {10: 10**9, 13: 10**6, 16: 10**3, 19: 1}     # s, ms, us, ns since 1970


def seconds_to_ns(text: str, where: str = 'stamp') -> int:
    """
    Return decimal seconds as integer nanoseconds, exactly.

    Raises
    ------
    PersemError
        When the text is not a number of seconds from 0 to 2^31.

    """
    try:
        seconds = Decimal(str(text).strip())
    except InvalidOperation:
        seconds = Decimal('NaN')
    if not seconds.is_finite() or not 0 <= seconds < MAX_SECONDS:
        raise PersemError(f'{where}: expected seconds from 0 to 2^31, got {str(text)[:60]!r}')
    return int((seconds * 1_000_000_000).to_integral_value())


def stamp_of_name(name: str) -> int | None:
    """
    Return the stamp that a file name without its ending is, or None.

    Seconds with a decimal point, or 10, 13, 16 or 19 digits: seconds, milli-, micro- or
    nanoseconds.

    """
    if re.fullmatch(r'\d{1,10}\.\d+', name):
        return seconds_to_ns(name) if Decimal(name) < MAX_SECONDS else None
    if re.fullmatch(r'\d+', name) and len(name) in DIGITS_TO_NS:
        ns = int(name) * DIGITS_TO_NS[len(name)]
        return ns if ns < MAX_SECONDS * 10**9 else None
    return None


def number_of_name(name: str) -> int | None:
    """Return the last integer in a file name without its ending, or None."""
    numbers = re.findall(r'\d+', name)
    return int(numbers[-1]) if numbers else None


def stamps_from_names(keys: Iterable[str]) -> dict[str, int] | None:
    """Return {key: stamp} where all names are stamps, or None."""
    stamps = {}
    for key in keys:
        stamp = stamp_of_name(key)
        if stamp is None:
            return None
        stamps[key] = stamp
    return stamps


def stamps_from_rate(keys: list[str], rate: float, start: float) -> dict[str, int]:
    """
    Return {key: stamp}: the number in the name over *rate* [Hz], after *start* [s].

    Where names carry no number, or two the same one, the position in the list stands in.

    """
    named = [number_of_name(key) for key in keys]
    numbers = [number for number in named if number is not None]
    if len(set(numbers)) < len(keys):
        numbers = list(range(len(keys)))
    begin = round(start * 1e9)
    return {key: begin + round(Decimal(number) * 10**9 / Decimal(str(rate)))
            for key, number in zip(keys, numbers, strict=True)}


def stamps_from_file(path: Path | str, keys: list[str]) -> dict[str, int]:
    """
    Return {key: stamp} from a text file.

    Lines are "stamp name" in either order, a name with or without folder and ending, or a
    stamp alone: the i-th line for the i-th key.

    Raises
    ------
    PersemError
        When the file does not give every key a stamp.

    """
    rows = read_lines(path)
    if all(len(words) == 1 for _, words in rows):
        if len(rows) != len(keys):
            raise PersemError(f'{path}: {len(rows)} stamps for {len(keys)} frames; expected one '
                              'a line and frame, or lines of "stamp name"')
        return {key: seconds_to_ns(words[0], f'{path}, line {number}')
                for key, (number, words) in zip(keys, rows, strict=True)}
    known = {canonical(key): key for key in keys}
    stamps = {}
    for number, words in rows:
        for stamp, name in (words[:2], words[1::-1]):
            key = _key(name, known)
            if key is not None:
                stamps[key] = seconds_to_ns(stamp, f'{path}, line {number}')
                break
    missing = [key for key in keys if key not in stamps]
    if missing:
        raise PersemError(f'{path}: no stamp for {len(missing)} of {len(keys)} frames, the first '
                          f'is {missing[0]!r}; expected lines of "stamp name"')
    return stamps


def _key(name: str, known: dict[str, str]) -> str | None:
    """Return the key that a name, a path or a path without its ending stands for, or None."""
    path = Path(name)
    for form in (name, path.name, path.stem):
        if canonical(form) in known:
            return known[canonical(form)]
    numbers = re.findall(r'\d+', path.name.split('.')[0])
    return known.get(canonical(numbers[-1])) if numbers else None
