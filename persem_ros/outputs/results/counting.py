"""Kernels that count the pixels of one label image by true and predicted id, region and change."""

import numpy as np
from persem_ros.core.jit import kernel
from persem_ros.frames import UNKNOWN

CODES = 8               # sums of the bits of core.refine.regions.REGIONS
LANES = 4
FREE = np.uint64(2 ** 64 - 1)       # a free place in a table of counts


@kernel
def counted(labels, table, ids):
    """Write what each label counts as, UNKNOWN for none; return the largest id, UNKNOWN aside."""
    if len(table) == 0:
        for i in range(len(labels)):    # a negative label is a huge unsigned one
            ids[i] = np.uint16(min(np.uint32(labels[i]), np.uint32(UNKNOWN)))
    else:
        for i in range(len(labels)):
            ids[i] = table[min(np.uint32(labels[i]), np.uint32(UNKNOWN))]
    return widest(ids)


@kernel
def widest(ids):
    """Return the largest of some ids, UNKNOWN aside; -1 where there is none."""
    most = np.uint16(0)
    for i in range(len(ids)):
        most = max(most, np.uint16(ids[i] + np.uint16(1)))      # UNKNOWN becomes 0
    return np.int64(most) - 1


@kernel
def pack(ids, classes, codes, pairs, before, bits, keys):
    """
    Write all that is counted of each pixel as one number: change, region, true, predicted id.

    UNKNOWN becomes the last id of so many bits. Without branches, so that the compiler turns it
    into vector instructions.

    """
    b, mask = np.uint16(bits), np.uint16((1 << bits) - 1)
    for i in range(len(ids)):
        change = np.uint16(pairs[i] & (ids[i] != before[i]))
        keys[i] = (change << np.uint16(3) | np.uint16(codes[i])) << np.uint16(b + b) \
            | (classes[i] & mask) << b | (ids[i] & mask)
        before[i] = ids[i]


@kernel
def count_keys(keys, lanes):
    """
    Count the keys, every fourth in a lane of its own.

    Neighbours are mostly alike, and adding to a place that was just written waits for it.

    """
    whole = len(keys) // LANES * LANES
    for i in range(0, whole, LANES):
        lanes[0, keys[i]] += 1
        lanes[1, keys[i + 1]] += 1
        lanes[2, keys[i + 2]] += 1
        lanes[3, keys[i + 3]] += 1
    for i in range(whole, len(keys)):
        lanes[0, keys[i]] += 1


@kernel
def place_of(keys, key):
    """Return the place of *key* in the table, or the free place where it belongs."""
    mask = np.uint64(len(keys) - 1)
    place = (key * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(32)) & mask
    while keys[place] != key and keys[place] != FREE:
        place = (place + np.uint64(1)) & mask
    return place


@kernel
def refill(keys, counts, new_keys, new_counts):
    """Move all counts into a larger, empty table."""
    for i in range(len(keys)):
        if keys[i] != FREE:
            place = place_of(new_keys, keys[i])
            new_keys[place] = keys[i]
            new_counts[place] = counts[i]


@kernel
def count_image(start, ids, classes, codes, pairs, before, keys, counts, used, changed):
    """
    Count the pixels from *start* on; returns where it stopped, early when the table is full.

    before holds the previous frame's counted ids and is replaced on the way; pairs says where the
    two are to be compared. Unsigned all over: signed places are checked for negative ones at
    every access, which costs five times as much as the counting.

    """
    last, place = FREE, np.uint64(0)        # of the pixel before: nine in ten are like it
    code, alike, other = np.uint8(0), 0, 0      # so that it pays to add up like ones first
    for i in range(start, len(ids)):
        c = np.uint64(ids[i])
        if codes[i] != code:
            counts[place, code] += alike
            changed[code] += other
            code, alike, other = codes[i], 0, 0
        if classes[i] != UNKNOWN:
            key = np.uint64(classes[i]) << np.uint64(16) | c
            if key != last:
                counts[place, code] += alike
                last, place, alike = key, place_of(keys, key), 0
                if keys[place] == FREE:
                    if 2 * used[0] >= len(keys):
                        changed[code] += other
                        return i
                    keys[place] = key
                    used[0] += 1
            alike += 1
        other += pairs[i] & (c != before[i])
        before[i] = ids[i]
    counts[place, code] += alike
    changed[code] += other
    return len(ids)
