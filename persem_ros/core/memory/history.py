"""A voxel's history as a chain of links of six observations. Inlined into kernels."""

import numpy as np
from persem_ros.core.jit import inlined
from persem_ros.core.memory.pools import CHUNK


@inlined
def link_of(links, head, first, i):
    """Return the link, + 1, that holds observation number i."""
    link = np.int64(head)
    for _ in range(i // CHUNK - np.int64(first) // CHUNK):
        link = np.int64(links[link - 1].next)
    return link


@inlined
def oldest(observations, first, max_history):
    """Return the number of the oldest observation that a refinement reads."""
    if max_history > 0:
        return max(np.int64(first), np.int64(observations) - max_history)
    return np.int64(first)
