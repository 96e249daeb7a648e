"""
Where the voxels of a frame are found: a hash of cubes of 4 x 4 x 4. Kernels only.

The hash has the cubes' names, and 64 places for each. The cubes of a frame are few and a level of
one is a cache line, which 16 voxels of a ground share; a hash of the voxels themselves took 3 ns a
pixel more, waiting for its places.

"""

import numpy as np
from persem_ros.core.frame.place import NOWHERE
from persem_ros.core.jit import inlined, kernel

CORNER = np.int64(3 << 42 | 3 << 21 | 3)    # what a key has beyond the name of its cube
CUBE = 64
MIX = np.uint64(0x9E3779B97F4A7C15)         # Fibonacci hashing
FIRST = 1 << 10     # places of the hash to begin with


@inlined
def no_cubes():
    """Return an empty hash of cubes: names, first places, places, and how many there are."""
    return (np.full(FIRST, NOWHERE), np.empty(FIRST, np.int32),
            np.empty(CUBE * FIRST // 2, np.int32), 0)


@kernel
def more_cubes(names, firsts, cells, needed):
    """Return a hash with the same cubes and room for as many as are *needed*, half full."""
    size = len(names)
    while size < 2 * needed:
        size *= 2
    new_names, new_firsts = np.full(size, NOWHERE), np.empty(size, np.int32)
    new_cells = np.empty(CUBE * size // 2, np.int32)
    new_cells[:len(cells)] = cells
    shift = shift_of(new_names)
    for s in range(len(names)):
        if names[s] != NOWHERE:
            slot = slot_of(names[s], new_names, shift)
            new_names[slot], new_firsts[slot] = names[s], firsts[s]
    return new_names, new_firsts, new_cells


@inlined
def shift_of(names):
    """Return by how much a product is shifted, so that its highest bits are a place."""
    shift, size = np.uint64(64), len(names)
    while size > 1:
        shift, size = shift - np.uint64(1), size >> 1
    return shift


@inlined
def slot_of(name, names, shift):
    """Return where the hash has a cube, or has room for it."""
    mask = np.uint64(len(names) - 1)
    slot = (np.uint64(name) * MIX) >> shift
    while names[slot] != name and names[slot] != NOWHERE:
        slot = (slot + np.uint64(1)) & mask
    return slot


@inlined
def find_places(m, keys, starts, names, firsts, cells, n_cubes, places):
    """Write where cells has the voxel of each of m runs, -1 for none; return the cubes' number."""
    shift = shift_of(names)
    for r in range(m):
        key = keys[starts[r]]
        if key == NOWHERE:
            places[r] = -1
            continue
        name = key & ~CORNER
        slot = slot_of(name, names, shift)
        if names[slot] == NOWHERE:
            names[slot] = name
            firsts[slot] = CUBE * n_cubes
            for k in range(CUBE):
                cells[CUBE * n_cubes + k] = 0
            n_cubes += 1
        places[r] = firsts[slot] + ((key & 3) << 4 | (key >> 42 & 3) << 2 | (key >> 21 & 3))
    return n_cubes
