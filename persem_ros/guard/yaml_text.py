"""
YAML from anywhere: no aliases, and bounds on its size, nodes and depth before anything is built.

Nine lines of aliases make a list of a billion items; nothing that people write here needs one.

"""

from collections.abc import Iterator
from contextlib import contextmanager
import gc
from typing import Any, NamedTuple

from persem_ros.errors import PersemError
from persem_ros.guard.words import sentence
import yaml

# With libyaml where there is one: ten times as fast.
PARSER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class Bounds(NamedTuple):
    """What a text may be: characters, nodes, levels, characters of a single value."""

    size: int
    nodes: int
    depth: int = 32
    scalar: int = 10_000
    aliases: bool = False       # allowed, and counted as what they stand for
    remedy: str = 'write less'


SETTINGS = Bounds(1 << 20, 20_000, remedy='leave out what has its default')
# All 65 536 classes, with long names.
LEGEND = Bounds(1 << 26, 2_000_000, remedy='no legend needs more')
# metadata.yaml: QoS texts are long, and writers name equal ones once.
RECORDING = Bounds(1 << 24, 1_000_000, scalar=1 << 20, aliases=True,
                   remedy='remove it: the files are read without')


def check(text: str, bounds: Bounds, parser: Any = PARSER) -> None:
    """
    Refuse a text that is out of bounds or no YAML.

    Raises
    ------
    ValueError
        A few words that name the bound.
    yaml.YAMLError
        For what is no YAML.

    """
    if len(text) > bounds.size:
        raise ValueError(f'longer than {bounds.size} characters; {bounds.remedy}')
    nodes = 0
    begun: list[tuple[str | None, int]] = []    # collections that are open: anchor, nodes before
    sizes: dict[str, int] = {}                  # nodes of what has an anchor
    for event in _events(text, bounds, parser):
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            name = event.anchor or ''       # the stubs know of aliases without one
            if not bounds.aliases or name not in sizes:
                raise ValueError(f'an alias (*{name[:20]}) in line {line}; write the '
                                 'value itself')
            nodes += sizes[name]
        elif isinstance(event, yaml.NodeEvent):
            nodes += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if nodes > bounds.nodes:
            raise ValueError(f'more than {bounds.nodes} values; {bounds.remedy}')
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > bounds.scalar:
            raise ValueError(f'a value of more than {bounds.scalar} characters in line {line}; '
                             f'{bounds.remedy}')
        if isinstance(event, yaml.CollectionStartEvent):
            if event.anchor is not None:
                sizes.pop(event.anchor)         # none of itself in it
            begun.append((event.anchor, nodes - 1))
            if len(begun) > bounds.depth:
                raise ValueError(f'more than {bounds.depth} levels in line {line}; '
                                 f'{bounds.remedy}')
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = begun.pop()
            if anchor is not None:
                sizes[anchor] = nodes - before


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector from walking over all nodes again and again: half of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _events(text: str, bounds: Bounds, parser: Any) -> Iterator[Any]:
    """Yield the parser's events; libyaml has a bound of its own on flow levels, which is ours."""
    try:
        yield from yaml.parse(text, Loader=parser)
    except yaml.YAMLError as error:
        if 'maximum nesting' in str(error):
            raise ValueError(f'more than {bounds.depth} levels; {bounds.remedy}') from None
        raise


def load(text: str, source: str, bounds: Bounds) -> Any:
    """
    Return the content of a YAML text from anywhere.

    Parameters
    ----------
    text : str
        The YAML.
    source : str
        Stands for the text in refusals.
    bounds : Bounds
        Beyond which it is refused.

    Raises
    ------
    PersemError
        For what is no YAML, and for what is out of bounds: which bound.

    """
    try:
        check(text, bounds)
        with _uncollected():
            return yaml.load(text, PARSER)
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        line = f' (line {mark.line + 1})' if mark else ''
        problem = getattr(error, 'problem', None) or str(error)[:200]
        raise PersemError(f'{source}: not YAML: {sentence(problem)}{line}') from None
    # Values with a tag that they do not fit (!!int "", !!timestamp x) raise almost anything.
    except Exception as error:
        raise PersemError(f'{source}: not YAML that can be read: '
                          f'{sentence(str(error)) or type(error).__name__}') from None
