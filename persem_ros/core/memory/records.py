"""Single records of the pools: taken, marked, written, let go. Kernels only."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.pools import (
    CHUNK, FIRST_VOXEL, FREE, FREE_VOXELS, LINKS, RETIRED, SIDE, VOXELS)


@inlined
def mark(block, stamp, now, i, j, k):
    """Mark the voxel with the index (i, j, k) as changed now, a tick of the clock."""
    changed = block.changed
    changed[(i & 7) * SIDE + (j & 7)] |= np.uint8(1 << (k & 7))
    stamp.evidence = now
    stamp.shown = now
    stamp.stored = now


@inlined
def take_voxel(voxels, used):
    """Return the number of an unused voxel."""
    v = used[VOXELS]
    if used[FIRST_VOXEL] > 0:       # one that was dropped
        v = used[FIRST_VOXEL] - 1
        used[FIRST_VOXEL] = voxels[v].head
        used[FREE_VOXELS] -= 1
        voxels[v].head = 0
    else:
        used[VOXELS] = v + 1
    return v


@inlined
def take_link(free, used):
    """Return the number of an unused link."""
    if used[FREE] > 0:
        used[FREE] -= 1
        return np.int64(free[used[FREE]])
    link = used[LINKS]
    used[LINKS] = link + 1
    return link


@inlined
def write_link(link, place, c, s, f):
    """Write an observation to a place of a link."""
    labels, confidences, frames = link.c, link.s, link.f
    labels[place] = c
    confidences[place] = s
    frames[place] = f


@inlined
def write_offset(record, place, x, y, z):
    """Write where an observation's points lay in its voxel, in 256ths of an edge."""
    xyz = record.xyz
    xyz[3 * place] = x
    xyz[3 * place + 1] = y
    xyz[3 * place + 2] = z


@inlined
def hang_link(voxel, link, before, number, n):
    """Hang a link for observation number n, by its number + 1, on a voxel's history."""
    link.next = 0
    if voxel.tail == 0:
        voxel.head = number
        voxel.first = n
    else:
        before.next = number
    voxel.tail = number


@inlined
def drop_oldest(voxel, link):
    """
    Take the first link off a voxel's history; return how many observations that lets go.

    It is retired, not freed: a refinement that began earlier may still read it, and follows its
    'next'. release_links() frees what is retired when no refinement is under way.

    """
    voxel.head = link.next
    first = np.int64(voxel.first)
    voxel.first = (first // CHUNK + 1) * CHUNK
    return np.int64(voxel.first) - first


@kernel
def release_links(free, retired, used):
    """Make retired links available again."""
    for r in range(used[RETIRED]):
        free[used[FREE]] = retired[r]
        used[FREE] += 1
    used[RETIRED] = 0
