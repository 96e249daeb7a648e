"""Finding the files of a data set by pattern, and reading its text files."""

from __future__ import annotations

from collections.abc import Collection
from itertools import islice
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError


def files_of(folder: Path, pattern: str) -> dict[str, Path]:
    """
    Return {key: path}, in natural order of the keys.

    Parameters
    ----------
    folder : Path
        Where a relative pattern starts.
    pattern : str
        A path with one '*' in its last part: the key is what the star stands for, without the
        file's ending where the star comes last. A folder means all its files.

    Raises
    ------
    PersemError
        For a pattern without exactly one star.

    """
    path = Path(folder) / pattern
    if path.is_dir():
        path = path / '*'
    if path.name.count('*') != 1 or '*' in str(path.parent):
        raise PersemError(f"pattern {pattern!r}: expected one '*' in the file name, which stands "
                          "for the frame, for example 'depth/*.png'")
    if not path.parent.is_dir():
        return {}
    prefix, suffix = path.name.split('*')
    found = {}
    for entry in path.parent.iterdir():
        name = entry.name
        if name.startswith('.') or len(name) < len(prefix) + len(suffix) or not entry.is_file() \
                or not (name.startswith(prefix) and name.endswith(suffix)):
            continue
        key = name[len(prefix):len(name) - len(suffix)]
        found[key if suffix else Path(key).stem] = entry
    return {key: found[key] for key in sorted(found, key=natural)}


def natural(key: str) -> list[int | str]:
    """Return a sort key under which 'frame-10' comes after 'frame-9'."""
    return [int(part) if part.isdecimal() else part for part in re.split(r'(\d+)', key)]


def canonical(key: str) -> str:
    """Return a key without leading zeros, so that 7 finds 000007."""
    return key.lstrip('0') or '0' if key.isdecimal() else key


def some(names: Collection[str], limit: int = 3) -> str:
    """Return the first few of *names* as text, with an ellipsis when there are more."""
    return ', '.join(islice(names, limit)) + (', …' if len(names) > limit else '')


def read_text(path: Path | str) -> str:
    """
    Return a text file's content.

    Raises
    ------
    PersemError
        When it is missing or not text.

    """
    try:
        return Path(path).read_text(encoding='utf-8')
    except OSError as error:
        raise PersemError(f'{path}: cannot be read: {error.strerror}') from error
    except UnicodeDecodeError:
        raise PersemError(f'{path}: expected a text file') from None


def read_lines(path: Path | str) -> list[tuple[int, list[str]]]:
    """Return [(line number, words)] of a text file; '#' starts a comment, ',' separates too."""
    lines = enumerate(read_text(path).splitlines(), 1)
    rows = [(number, line.split('#')[0].replace(',', ' ').split()) for number, line in lines]
    rows = [row for row in rows if row[1]]
    if not rows:
        raise PersemError(f'{path}: the file is empty')
    return rows


def numbers_of(words: list[str], where: Path | str) -> NDArray[np.float64]:
    """Return words as float64; infinities and NaN are numbers here."""
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        raise PersemError(f'{where}: expected numbers, got {" ".join(words)[:60]!r}') from None
