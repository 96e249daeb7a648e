"""How a legend that somebody gave and the names that came with the ids differ: one sentence."""

from collections.abc import Collection, Iterable, Mapping

from persem_ros.guard.words import plain
from persem_ros.settings.config import Memory, NO_TABLE
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_class import LegendClass

SHOWN = 6       # classes in each part of the sentence


def difference(given: Legend, theirs: Legend, ids: Mapping[int, int] | None,
               ignored: Collection[int], whose: str = 'labels.legend') -> str:
    """
    Return what becomes of ids whose names are not those of a given legend, '' where all fit.

    Parameters
    ----------
    given : Legend
        That of labels.legend, or of a map; its ids are the map's.
    theirs : Legend
        What the recording, or a topic, calls its ids.
    ids : dict of int to int, or None
        The map's id of each of theirs; None: ids stay as they are.
    ignored : collection of int
        Ids that mean "nothing".
    whose : str
        What the given legend is to the user.

    """
    ours = {item.name: item.id for item in given.classes}
    called = {item.id: item.name for item in given.classes}
    named = [item for item in theirs.classes if item.id not in ignored and not item.ignored]
    names = {item.name for item in theirs.classes}
    strange = [item for item in named if item.name not in ours]
    missing = _list(f'{item.id} {_quoted(item.name)}' for item in given.classes
                    if item.name not in names and item.id not in ignored and not item.ignored)
    beside = f'; in {whose} only: {missing}' if missing else ''
    moved = [] if ids is None else [item for item in named if ids.get(item.id, item.id) != item.id]
    if ids is not None and moved:
        new = _list(f'{_quoted(item.name)} {item.id} is {ids[item.id]}' for item in moved)
        alone = _list(f'{item.id} {_quoted(item.name)}' for item in strange)
        alone = f'; without a name in {whose}: {alone}' if alone else ''
        return (f'ids follow their names, as {whose} has them: {new}{alone}{beside}; to keep ids '
                f'as they are: --set labels.topic={NO_TABLE}')
    if not strange:
        return ''
    return (f'{whose} and the recording name classes otherwise, ids stay as they are: '
            + _list(_called(item, called) for item in strange) + beside)


def outdated(memory: Memory, ours: Legend, theirs: Legend, ids: Mapping[int, int]) -> str:
    """
    Return which ids in settings are another class's where ids followed their names, or ''.

    memory.dynamic_labels are ids of the map; memory.ignore_labels are those of images, too, and
    so may leave out two classes.

    """
    called = {item.id: item for item in ours.classes}
    theirs_of = {item.id: item for item in theirs.classes}
    found = []
    for c in memory.dynamic_labels:
        new = ids.get(c, c)
        if c in theirs_of and new != c and new not in memory.dynamic_labels and not (
                c in called and called[c].dynamic):     # then the map's id was meant
            value = ','.join(str(ids.get(d, d)) for d in memory.dynamic_labels)
            now = _quoted(called[c].name) if c in called else 'no class'
            found.append(f'memory.dynamic_labels {c} is {now} now; '
                         f'{_quoted(theirs_of[c].name)} is {new}: '
                         f'--set memory.dynamic_labels={value}')
    numbers = {item.name: item.id for item in ours.classes}
    for c in memory.ignore_labels:
        both = [item.name for item in theirs.classes if item.id != c and ids.get(item.id) == c]
        if both and c in theirs_of and theirs_of[c].name not in (both[0], called[c].name):
            new = numbers.get(theirs_of[c].name, c)
            value = ','.join(str(new if d == c else d) for d in memory.ignore_labels)
            found.append(
                f'memory.ignore_labels {c} is {_quoted(both[0])} now, which is left out beside '
                f'{_quoted(theirs_of[c].name)}' + (
                    f'; {_quoted(theirs_of[c].name)} is {new}: --set memory.ignore_labels={value}'
                    if new != c and new not in theirs_of else ''))
    return '; '.join(found)


def _called(item: LegendClass, called: Mapping[int, str]) -> str:
    """Return what a class of theirs is called now."""
    now = called.get(item.id)
    return f'{item.id} {_quoted(item.name)} ' + (
        'has no name' if now is None else f'is {_quoted(now)}')


def _list(words: Iterable[str]) -> str:
    found = list(words)
    return ', '.join(found[:SHOWN]) + (f' and {len(found) - SHOWN} more'
                                       if len(found) > SHOWN else '')


def _quoted(name: str) -> str:
    return f"'{plain(name)[:60]}'"
