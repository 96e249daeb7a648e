"""A voxel's evidence h_v: adding to it, reading it, its majority. Inlined into kernels."""

import numpy as np
from persem_ros.core.jit import inlined
from persem_ros.core.memory.pools import FIRST_SPILL, FREE_SPILLS, INLINE, SPILLS
from persem_ros.frames import UNKNOWN

TIE = 1e-9      # spec section 2: x ties y when |x - y| <= TIE


@inlined
def take_spill(spills, used):
    """Return the number of an unused spill record."""
    if used[FIRST_SPILL] > 0:       # one that was dropped
        number = used[FIRST_SPILL] - 1
        used[FIRST_SPILL] = spills[number].next
        used[FREE_SPILLS] -= 1
        spills[number].next = 0
    else:
        number = used[SPILLS]
        used[SPILLS] = number + 1
    return number


@inlined
def add_here(record, c, s):
    """
    h_v(c) += s in a voxel or spill record; False where other classes have all its places.

    Sums are float64 and in the order of the observations.

    """
    sums, classes = record.sums, record.classes
    for k in range(INLINE):
        if classes[k] == c and sums[k] != 0.0:
            sums[k] += s
            return True
        if sums[k] == 0.0:
            classes[k] = c
            sums[k] = s
            return True
    return False


@inlined
def add_spilt(voxel, spills, c, s):
    """h_v(c) += s outside the voxel's own record, which has no place for c; False: none has."""
    number = np.int64(voxel.more)
    while number > 0:
        if add_here(spills[number - 1], c, s):
            return True
        number = np.int64(spills[number - 1].next)
    return False


@inlined
def spill(voxel, spills, used, c, s):
    """h_v(c) += s in a new spill record, where no other has a place for c."""
    before = np.int64(voxel.more)
    while before > 0 and spills[before - 1].next > 0:
        before = np.int64(spills[before - 1].next)
    number = take_spill(spills, used) + 1
    add_here(spills[number - 1], c, s)
    if before > 0:
        spills[before - 1].next = number
    else:
        voxel.more = number


@inlined
def _read_here(place, classes, sums, n):
    """Write the evidence of a voxel or spill record to classes[n:], sums[n:]; return the end."""
    own_sums, own_classes = place.sums, place.classes
    for k in range(INLINE):
        if own_sums[k] != 0.0:
            classes[n] = own_classes[k]
            sums[n] = own_sums[k]
            n += 1
    return n


@inlined
def read_evidence(voxel, spills, classes, sums, n):
    """Write a voxel's evidence to classes[n:], sums[n:] in order of appearance; return the end."""
    n = _read_here(voxel, classes, sums, n)
    number = np.int64(voxel.more)
    while number > 0:
        n = _read_here(spills[number - 1], classes, sums, n)
        number = np.int64(spills[number - 1].next)
    return n


@inlined
def count_classes(voxel, spills):
    """Return the number of classes with evidence in a voxel."""
    n, sums = 0, voxel.sums
    for k in range(INLINE):
        n += sums[k] != 0.0
    number = np.int64(voxel.more)
    while number > 0:
        spilt = spills[number - 1].sums
        for k in range(INLINE):
            n += spilt[k] != 0.0
        number = np.int64(spills[number - 1].next)
    return n


@inlined
def _most(record, most):
    """Return the largest of *most* and a record's sums."""
    sums = record.sums
    for k in range(INLINE):
        most = max(most, sums[k])
    return most


@inlined
def _smallest(record, most, best):
    """Return the smallest of *best* and the record's ids whose evidence ties with *most*."""
    sums, classes = record.sums, record.classes
    for k in range(INLINE):
        if sums[k] > 0.0 and most - sums[k] <= TIE:
            best = min(best, np.int64(classes[k]))
    return best


@inlined
def majority_here(voxel):
    """Return c_M of a voxel without spilt evidence."""
    return _smallest(voxel, _most(voxel, 0.0), np.int64(UNKNOWN))


@inlined
def majority(voxel, spills):
    """c_M = argmax h_v; the smaller id wins a tie (spec section 2)."""
    most, number = _most(voxel, 0.0), np.int64(voxel.more)
    while number > 0:
        most, number = _most(spills[number - 1], most), np.int64(spills[number - 1].next)
    best, number = _smallest(voxel, most, np.int64(UNKNOWN)), np.int64(voxel.more)
    while number > 0:
        best = _smallest(spills[number - 1], most, best)
        number = np.int64(spills[number - 1].next)
    return best
