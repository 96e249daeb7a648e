"""Values and names from files in the sentences and tables that people read."""

import reprlib
from typing import Any

LONGEST = 1000          # characters of a sentence
_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = 60
_short.maxlevel, _short.maxlist, _short.maxtuple, _short.maxdict, _short.maxset = 2, 4, 4, 4, 4


def short(value: Any) -> str:
    """Return repr(value), cut before it is written out, however long or deep the value is."""
    return plain(_short.repr(value))


def plain(text: str, lines: bool = False) -> str:
    """
    Return a text without anything that a terminal would obey: control characters are escaped.

    Parameters
    ----------
    text : str
        From a file: a class name, a topic, a frame.
    lines : bool
        Keep line feeds and tabs.

    """
    if text.isprintable():
        return text
    kept = '\n\t' if lines else ''
    return ''.join(c if c.isprintable() or c in kept else _escaped(c) for c in text)


def sentence(text: str) -> str:
    """Return a text as one line that a terminal may show, cut where it is very long."""
    line = plain(' '.join(text[:20 * LONGEST].split()))
    return line if len(line) <= LONGEST else f'{line[:LONGEST // 2]} … {line[-LONGEST // 2:]}'


def _escaped(c: str) -> str:
    """Return a character as Python would write it; spaces of other scripts as they are."""
    if c.isspace() and ord(c) > 160 and c not in '\u2028\u2029':
        return c
    return c.encode('unicode_escape').decode()
