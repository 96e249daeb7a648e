"""Sums by key where few keys of many occur: open addressing, for kernels and outside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel

FREE = -1
FEW = 1024


class Entries(NamedTuple):
    """Numbers (2^m,) by their keys (2^m,), int64 of 0 and more; FREE where a place is not used."""

    keys: NDArray[np.int64]
    values: NDArray[np.float64]


def entries_of(keys: NDArray[np.int64], values: NDArray[np.float64]) -> Entries:
    """Return the Entries of distinct keys."""
    size = 1 << max(4, int(2 * len(keys)).bit_length())
    found = Entries(np.full(size, FREE, np.int64), np.zeros(size))
    fill(keys, values, *found)
    return found


def listed(entries: Entries) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the sorted keys of Entries, and their values."""
    used = entries.keys != FREE
    order = np.argsort(entries.keys[used])
    return entries.keys[used][order], entries.values[used][order]


def merged(parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]],
           ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the sorted keys of several tables of sums, and the sums of their values."""
    keys, values = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    used = keys != FREE
    found, place = np.unique(keys[used], return_inverse=True)
    sums = np.zeros(len(found), np.int64)
    np.add.at(sums, place.reshape(-1), values[used])
    return found, sums


@inlined
def spot(keys, key):
    """Return the place of a key, or the free one where it belongs."""
    mask = np.uint64(len(keys) - 1)
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    place = (h ^ (h >> np.uint64(29))) & mask
    while keys[place] != FREE and keys[place] != key:
        place = (place + np.uint64(1)) & mask
    return place


@inlined
def value_of(keys, values, key, otherwise):
    """Return the value of a key, or *otherwise*."""
    place = spot(keys, key)
    return values[place] if keys[place] == key else otherwise


@inlined
def count_in(keys, sums, key, term):
    """Add a term to a key's sum; return 1 where the key is new."""
    place = spot(keys, key)
    sums[place] += term
    if keys[place] == key:
        return 0
    keys[place] = key
    return 1


@kernel
def wider(keys, sums):
    """Return the same table with twice the room."""
    more, theirs = np.full(2 * len(keys), FREE, np.int64), np.zeros(2 * len(keys), np.int64)
    for p in range(len(keys)):
        if keys[p] != FREE:
            count_in(more, theirs, keys[p], sums[p])
    return more, theirs


@kernel
def fill(some_keys, some_values, keys, values):
    """Enter distinct keys and their values."""
    for p in range(len(some_keys)):
        place = spot(keys, some_keys[p])
        keys[place] = some_keys[p]
        values[place] = some_values[p]
