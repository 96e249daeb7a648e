"""A voxel's history as a chain of links of six observations. Inlined into kernels."""

import numpy as np
from persem_ros.core.jit import inlined
from persem_ros.core.memory.pools import CHUNK

TOGETHER = 16           # histories that are best followed side by side


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


@inlined
def links_after(observations, first):
    """Return how many links a history has after its head."""
    return (np.int64(observations) - 1) // CHUNK - np.int64(first) // CHUNK


@inlined
def fetch(links, chains, left, n):
    """
    Follow n histories side by side, for the caches.

    Each link is somewhere else; the processor waits for several of them at once if none needs
    another. chains are their heads and left the links_after() them; both are used up.

    """
    while n > 0:
        m = 0
        for k in range(n):
            chains[m], left[m] = links[chains[k] - 1].next, left[k] - 1
            m += left[m] >= 0
        n = m
