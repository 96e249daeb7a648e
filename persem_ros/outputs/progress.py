"""One progress bar for all that takes long: on a terminal only, with log lines above it."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager, ExitStack
import logging
import sys
from typing import TypeVar

from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm


Item = TypeVar('Item')


@contextmanager
def progress(
        items: Generator[Item, None, None], what: str, expected: int, unit: str = 'frames'
) -> Iterator[Iterable[Item]]:
    """
    Give *items* to be looped over, with a bar on a terminal and nothing elsewhere.

    Parameters
    ----------
    items : generator
        Closed at the end of the block, however that is left.
    what : str
        The word before the bar.
    expected : int
        About how many there are.
    unit : str
        What they are.

    """
    shown = sys.stderr.isatty()
    with ExitStack() as stack:
        stack.enter_context(closing(items))
        if shown:       # a log line would otherwise be written into the bar
            stack.enter_context(logging_redirect_tqdm([logging.getLogger('persem_ros')]))
        yield stack.enter_context(tqdm(items, what, expected, unit=f' {unit}', leave=False,
                                       dynamic_ncols=True, disable=not shown))
