"""The settings that two maps were made with: which of them differ, as far as the files say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, TYPE_CHECKING

from persem_ros.settings.config import settings
from persem_ros.settings.heights import NAME as HEIGHTS, OF_LEGEND
from persem_ros.settings.parameter_file import read_text, scalar

if TYPE_CHECKING:
    from persem_ros.outputs.map.stored import StoredMap

# What decides on no observation: places of voxels (refused where they differ), what is let go
# (seen in the map itself), when a node does what, names of a recording's topics, results.
ASIDE = ('render.', 'topics.', 'trajectory.', 'qos.', 'map.', 'grid.', 'ema.', 'frames.')
ALONE = ('memory.voxel_size', 'memory.max_history', 'memory.max_voxels', 'memory.keep_radius',
         'sync.hold', 'sync.queue', 'sync.queue_bytes', 'pose.max_ahead', 'labels.legend',
         'labels.topic', 'refine.period', 'refine.volatility_every', 'refine.sweep')
SWITCHES = ('topics.confidence', 'topics.depth_confidence')     # whatever they are called
CLEARING = ('memory.clear_margin', 'memory.clear_slope', 'memory.clear_range')
IDS = ('memory.ignore_labels', 'memory.dynamic_labels')
OF_GEOMETRY = ('refine.geometry.', 'refine.up')


class Differences(NamedTuple):
    """
    What two maps were made with, sentences.

    Attributes
    ----------
    observing : list of str
        Settings that differ and decide what goes into a map.
    refining : list of str
        Settings that differ and decide on labels only.
    unknown : list of str
        What was not compared.

    """

    observing: list[str]
    refining: list[str]
    unknown: list[str]


def differences(first: StoredMap, one: StoredMap, by_id: bool) -> Differences:
    """
    Return in what settings two maps differ.

    Parameters
    ----------
    first : StoredMap
        By whose settings both are refined.
    one : StoredMap
        The other.
    by_id : bool
        Ids mean the same in both; else what their legends call them.

    """
    said = [read_text(stored.settings, f'settings in {stored.path}') for stored in (first, one)]
    mine, other = (dict(_values(stored)) for stored in (first, one))
    compared = [name for name in mine if name in other and _counts(name, mine, other)]
    missing = {stored.path: [name for name in compared if name not in names]
               for stored, names in zip((first, one), said)}
    observing, refining = [], []
    for name in compared:
        if any(name in names for names in missing.values()):
            continue
        ours, theirs = mine[name], other[name]
        if name in IDS:
            same = _ids(ours) == (_ids(theirs) if by_id else _renamed(theirs, first, one))
            ours, theirs = _called(ours, first), _called(theirs, one)
        else:
            same = bool(ours) == bool(theirs) if name.endswith(SWITCHES) else ours == theirs
            ours, theirs = _shown(ours), _shown(theirs)
        if not same:
            made = f'{name} is {ours} in {first.path} and {theirs} in {one.path}'
            if not name.startswith('refine.') or name == HEIGHTS and _of_legend(mine[name]):
                observing.append(f'{made}: one run has one of them')
            else:
                refining.append(f'{made}: the map is refined by that of {first.path}')
    return Differences(observing, refining, [
        f'{path} does not say {_some(names)}, which was not compared'
        for path, names in missing.items() if names])


def of_many(stored: StoredMap) -> Iterator[str]:
    """Say of a map of several sessions that it knows the settings of one run."""
    n = len(stored.saved.frames.sessions)
    if n > 1:
        yield (f'{stored.path} has {n} sessions and the settings of its last run alone: whether '
               'all were made with these was not compared')


def _values(stored: StoredMap) -> Iterator[tuple[str, Any]]:
    """Yield the settings of a map, (dotted name, value)."""
    for name, value, _ in settings(stored.config()):
        yield name, value


def _counts(name: str, mine: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether a setting decides on anything in either map."""
    if name.endswith(SWITCHES):
        return True
    if name in ALONE or name.startswith(ASIDE) or '.topics.' in name:
        return False
    if name in CLEARING:
        return bool(mine['memory.clear_after'] or other['memory.clear_after'])
    if name.startswith(OF_GEOMETRY):
        return mine['refine.method'] == other['refine.method'] == 'geometry'
    return True


def _of_legend(text: str) -> bool:
    """Return whether heights are what a legend said: one run goes by the legend of all."""
    return not text or text.startswith(OF_LEGEND)


def _ids(ids: Iterable[int]) -> set[int | str]:
    """Return the ids among those of a setting, in which -1 stands for none."""
    return {c for c in ids if c >= 0}


def _renamed(ids: Iterable[int], first: StoredMap, one: StoredMap) -> set[int | str]:
    """Return what the ids of a map are in the first; the name of a class that it has not."""
    mine = {item.id: item.name for item in first.legend.classes}
    theirs = {item.id: item.name for item in one.legend.classes}
    numbers = {name: c for c, name in mine.items()}
    return {numbers.get(theirs[c], theirs[c] if c in mine else c) if c in theirs else c
            for c in ids if c >= 0}


def _called(ids: Iterable[int], stored: StoredMap) -> str:
    """Return ids with their names, where a map has them."""
    named = {item.id: f' ({item.name})' for item in stored.legend.classes}
    return ', '.join(f'{c}{named.get(c, "")}' for c in ids if c >= 0) or 'none'


def _shown(value: Any) -> str:
    """Return a value as --set takes it."""
    if isinstance(value, str):
        return value or 'empty'
    return str(scalar(value))


def _some(names: list[str]) -> str:
    """Return the first of some names, and how many more there are."""
    more = f' and {len(names) - 5} more' if len(names) > 5 else ''
    return ', '.join(names[:5]) + more
