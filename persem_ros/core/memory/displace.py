"""Kernels that move points: which leave their voxels, and where they come to lie."""

import numpy as np
from persem_ros.core.jit import inlined, kernel

FINE = 65536        # of a voxel's edge: what the place of a point is counted in, 16 bits
COARSE = 256        # the same in offsets
LIMIT = 1 << 30     # voxels from the origin, beyond which nothing can be placed


@kernel
def leaving(voxels, owner, frames, offsets, turns, moves, size, leaves):
    """
    Mark in leaves (F,) the frames that move and of which an observation leaves its voxel.

    voxels (n, 3) int32 are those of the rows that owner (N,) names; turns (F, 12) is K by frame,
    about map.origin: nine numbers of the rotation, then the shift.

    """
    for p in range(len(owner)):
        f, o = frames[p], owner[p]
        if not moves[f] or leaves[f]:
            continue
        x = middle(voxels[o, 0], offsets[p, 0], size)
        y = middle(voxels[o, 1], offsets[p, 1], size)
        z = middle(voxels[o, 2], offsets[p, 2], size)
        for axis in range(3):
            at = (turns[f, 3 * axis] * x + turns[f, 3 * axis + 1] * y + turns[f, 3 * axis + 2] * z
                  + turns[f, 9 + axis]) / size
            if np.floor(at) != voxels[o, axis]:
                leaves[f] = 1


@inlined
def middle(voxel, offset, size):
    """Return where the points of an observation lay along an axis, metres from the origin."""
    return (voxel + (offset + 0.5) / COARSE) * size


@kernel
def displace(voxels, owner, frames, offsets, turns, leaves, size, out, places, low, high):
    """
    Write each observation's voxel to out (N, 3) int32 and its place there to places, uint16.

    Those of frames that are not in leaves stay. low and high (3,) int64 receive the smallest and
    the largest index of a block. Returns whether all have a place.

    """
    for axis in range(3):
        low[axis], high[axis] = LIMIT, -LIMIT
    for p in range(len(owner)):
        f, o = frames[p], owner[p]
        if leaves[f]:
            x = middle(voxels[o, 0], offsets[p, 0], size)
            y = middle(voxels[o, 1], offsets[p, 1], size)
            z = middle(voxels[o, 2], offsets[p, 2], size)
            for axis in range(3):
                at = (turns[f, 3 * axis] * x + turns[f, 3 * axis + 1] * y
                      + turns[f, 3 * axis + 2] * z + turns[f, 9 + axis]) / size
                voxel = np.floor(at)
                if not abs(voxel) < LIMIT:
                    return False
                out[p, axis] = np.int32(voxel)
                places[p, axis] = np.uint16(min((at - voxel) * FINE, FINE - 1.0))
        else:
            for axis in range(3):
                out[p, axis] = voxels[o, axis]
                places[p, axis] = offsets[p, axis] * np.int64(FINE // COARSE)
        for axis in range(3):
            block = np.int64(out[p, axis]) >> 3
            if block < low[axis]:
                low[axis] = block
            if block > high[axis]:
                high[axis] = block
    return True
