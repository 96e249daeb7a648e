"""Several maps become one: as if their recordings had been mapped one after the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.sessions import (
    add_session, fingerprint, keep_looks, nothing_forgotten, whole)
from persem_ros.core.memory.voxel_memory import VoxelMemory
from persem_ros.errors import PersemError
from persem_ros.outputs.map.made_with import differences, of_many
from persem_ros.outputs.map.stored import StoredMap
from persem_ros.settings.legend import Legend
from persem_ros.settings.legend_class import LegendClass

LAST_ID = 65534


@dataclass
class Merged:
    """
    A merge under way.

    Attributes
    ----------
    memory : VoxelMemory
        The map so far.
    legend : Legend
    exact : bool
        Whether it equals one run over all recordings ...
    known : bool
        ... and whether that is known of all settings.
    notes : list of str
        What a user should know, a sentence each.

    """

    memory: VoxelMemory
    legend: Legend
    exact: bool
    known: bool
    notes: list[str]


def merge(maps: list[StoredMap], by_id: bool = False, legend: Legend | None = None) -> Merged:
    """
    Return what becomes of some maps, not yet refined.

    Parameters
    ----------
    maps : list of StoredMap
        In the order of their sessions.
    by_id : bool
        Ids mean the same in all of them, whatever their legends say.
    legend : Legend, optional
        Names the ids of all of them.

    Raises
    ------
    PersemError
        Where voxels or classes do not fit each other, or observations are missing.

    """
    for one in maps:
        if not whole(one.saved):
            raise PersemError(f'{one.path} has let go of observations (memory.max_history '
                              f'{one.saved.max_history}) and a merge adds all of them again; map '
                              'it anew with memory.max_history 0')
    first = maps[0]
    done = Merged(_unbounded(first), legend or first.legend, True, True, [])
    known = {session.uuid: (first, number)
             for number, session in first.saved.frames.sessions.items()}
    for one in maps:
        if not nothing_forgotten(one.saved):
            done.exact = False
            done.notes.append(f'{one.path} has let go of voxels, which are in no merge')
        if one.saved.passed.any():
            done.exact = False
            done.notes.append(f'{one.path} was looked through (memory.clear_after): its counts '
                              'are kept, those through voxels of the others are missing')
        for note in of_many(one):
            done.known = False
            done.notes.append(note)
    for k, one in enumerate(maps[1:], 1):
        shift = _shift(first, one)
        ids = np.arange(65536).astype(np.uint16) if by_id or legend is not None else \
            _ids(done, maps[:k], one)
        renamed = (ids != np.arange(65536)) & (one.saved.seen_ids > 0)
        done.exact &= not shift.any() and not renamed.any()
        added = False
        for number, session in sorted(one.saved.frames.sessions.items()):
            if session.uuid in known:
                _check_same(known[session.uuid], (one, number))
                done.notes.append(f'session {number} of {one.path} is in '
                                  f'{known[session.uuid][0].path}, too, and taken once')
                continue
            known[session.uuid] = one, number
            add_session(done.memory, one.saved, number, ids, shift)
            added = True
        if added:
            keep_looks(done.memory, one.saved, shift)
            _compare(done, first, one, by_id or legend is not None)
        done.memory.seen_ids[ids[np.flatnonzero(one.saved.seen_ids)]] = 1
    _check_bound(done, first)
    return done


def _compare(done: Merged, first: StoredMap, one: StoredMap, by_id: bool) -> None:
    """Note in what settings a map was made otherwise than the first."""
    found = differences(first, one, by_id)
    done.exact &= not found.observing
    done.known &= not found.unknown
    done.notes += [*found.observing, *found.refining, *found.unknown]


def _check_bound(done: Merged, first: StoredMap) -> None:
    """Note where one run would have let go of observations."""
    bound = first.config().memory.max_history
    most = int(done.memory.m.voxels['n'][:done.memory.n_numbers].max(initial=0))
    if 0 < bound < most:
        done.exact = False
        done.notes.append(f'voxels have up to {most} observations, of which one run with '
                          f'memory.max_history {bound}, as in {first.path}, keeps the newest')


def _unbounded(first: StoredMap) -> VoxelMemory:
    """Return the memory of a map, from which nothing is dropped."""
    memory = first.memory()
    memory.max_history = 0
    return memory


def _shift(first: StoredMap, one: StoredMap) -> NDArray[np.int64]:
    """Return what is added to voxel indices of a map to be those of the first; refuse others."""
    for name, mine, other in (
            ('memory.voxel_size', first.saved.voxel_size, one.saved.voxel_size),
            ('frames.map', first.map_frame, one.map_frame)):
        if mine != other:
            raise PersemError(f'{one.path} was made with {name} {other}, {first.path} with '
                              f'{mine}; map its recording anew with --set {name}={mine}')
    apart = (np.array(one.saved.origin) - first.saved.origin) / first.saved.voxel_size
    if np.abs(apart - np.rint(apart)).max() > 1e-6:
        raise PersemError(f'the origins of {first.path} and {one.path} are not whole voxels apart '
                          f'({" ".join(f"{x:.3f}" for x in apart)}); map one anew with --set '
                          f'map.origin={list(first.saved.origin)}')
    if np.abs(apart).max() > 2 ** 32:
        raise PersemError(f'the origins of {first.path} and {one.path} are '
                          f'{np.abs(apart).max():.3g} voxels apart, more than 2^32: they cannot '
                          'be one map')
    return np.rint(apart).astype(np.int64)


def _check_same(mine: tuple[StoredMap, int], other: tuple[StoredMap, int]) -> None:
    """Refuse two sessions of one name that saw something else."""
    if fingerprint(mine[0].saved, mine[1]) != fingerprint(other[0].saved, other[1]):
        raise PersemError(f'session {other[1]} of {other[0].path} and session {mine[1]} of '
                          f'{mine[0].path} are the same flight mapped differently; merge one of '
                          'them')


def _ids(done: Merged, before: list[StoredMap], one: StoredMap) -> NDArray[np.uint16]:
    """Return what the ids of a map become by the names of their classes; extend the legend."""
    ids = np.arange(65536).astype(np.uint16)
    used = np.flatnonzero(one.saved.seen_ids).tolist()
    if not done.legend.classes and not one.legend.classes:
        return ids
    settle = '--by-id takes ids as they are, --legend FILE names them'
    names = _names(done.legend, str(before[0].path), settle)
    theirs = {item.id: item for item in one.legend.classes}
    _names(one.legend, str(one.path), settle)
    for c in np.flatnonzero(done.memory.seen_ids).tolist():
        if c not in done.legend.ids:
            where = next((there.path for there in before if there.saved.seen_ids[c]), one.path)
            raise PersemError(f'{where}: id {c} is used and has no name; {settle}')
    taken = {*done.legend.ids, *one.legend.ids, *used, *np.flatnonzero(done.memory.seen_ids),
             *one.config().memory.ignore_labels, *one.config().memory.dynamic_labels}
    free, learned = (i for i in range(LAST_ID + 1) if i not in taken), list(done.legend.classes)
    for c in used:
        item: LegendClass | None = theirs.get(c)
        if item is None:
            raise PersemError(f'{one.path}: id {c} is used and has no name; {settle}')
        if item.name not in names:
            fresh = next(free, None)
            if fresh is None:
                raise PersemError(f'{one.path}: with its classes there would be more than '
                                  f'{LAST_ID + 1}, the most that ids can number; {settle}')
            names[item.name] = fresh
            learned.append(replace(item, id=fresh))
        ids[c] = names[item.name]
    done.legend = Legend(done.legend.title, tuple(learned))
    return ids


def _names(legend: Legend, where: str, settle: str) -> dict[str, int]:
    """Return {name: id}; refuse a name that two ids have."""
    names: dict[str, int] = {}
    for item in legend.classes:
        if item.name in names:
            raise PersemError(f'{where}: {item.name!r} is the name of id {names[item.name]} and '
                              f'of id {item.id}; {settle}')
        names[item.name] = item.id
    return names


def without(stored: StoredMap, session: int) -> VoxelMemory:
    """Return the memory that a map would have been without one session, not yet refined."""
    saved = stored.saved
    there = sorted(saved.frames.sessions)
    if session not in there:
        raise PersemError(f'{stored.path} has no session {session}; it has '
                          f'{", ".join(map(str, there)) or "none"}')
    if there == [session]:
        raise PersemError(f'{stored.path} has no other session than {session}; remove the file')
    if not nothing_forgotten(saved):
        raise PersemError(f'{stored.path} has let go of observations, so that what is left would '
                          'not be what the other sessions saw; map them anew')
    memory = VoxelMemory(saved.voxel_size, saved.origin)
    memory.session = -1
    every = np.arange(65536).astype(np.uint16)
    for number in there:
        if number != session:
            add_session(memory, saved, number, every, np.zeros(3, np.int64))
    keep_looks(memory, saved, np.zeros(3, np.int64))
    return memory
