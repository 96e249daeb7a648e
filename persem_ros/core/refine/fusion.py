"""The fusion methods of spec section 4: one label for every voxel, from its history alone."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.memory.history import link_of, oldest
from persem_ros.core.memory.pools import CHUNK

UNWEIGHTED, RECENCY, CONSENSUS, PROBABILISTIC = range(4)
MODES = {'unweighted': UNWEIGHTED, 'recency': RECENCY, 'consensus': CONSENSUS,
         'probabilistic': PROBABILISTIC}


# Scratch of one thread, as core.refine.selection.SCRATCH.
VOTES = np.dtype([('ids', 'u2', 65536), ('sums', 'f8', 65536)])


@inlined
def winner(classes, sums, n, preferred):
    """
    Return argmax of sums[:n]: *preferred* where it ties, else the smaller id (section 2).

    A preferred of -1 takes part in no tie.

    """
    most = sums[0]
    for k in range(1, n):
        most = max(most, sums[k])
    best = np.int64(65536)
    for k in range(n):
        if most - sums[k] <= TIE:
            if classes[k] == preferred:
                return np.int64(preferred)
            best = min(best, np.int64(classes[k]))
    return best


@inlined
def place_of(classes, n, c):
    """Return the place of class c in classes[:n], or n."""
    k = 0
    while k < n and classes[k] != c:
        k += 1
    return k


@inlined
def last_time(links, frame_t, head, first, n):
    """Return t of observation number n - 1."""
    link = link_of(links, head, first, n - 1)
    return np.int64(frame_t[links[link - 1].f[(n - 1) % CHUNK]])


@kernel
def fuse(begin, end, scratch, links, frame_t, start, majority, observations, first, head, mode,
         max_history, decay, beta, n_ids, labels):
    """
    Label rows begin .. end of a snapshot by weighted votes of their observations.

    frame_t is t of every frame, decay is lambda_r per frame, n_ids is K of the probabilistic
    method.

    """
    classes, sums = scratch[0].ids, scratch[0].sums
    for r in range(begin, end):
        c_M = np.int64(majority[r])
        if start[r + 1] - start[r] == 1:
            labels[r] = c_M
            continue
        n_classes = 0
        n = np.int64(observations[r])
        newest = last_time(links, frame_t, head[r], first[r], n)
        at = oldest(n, first[r], max_history)
        link = link_of(links, head[r], first[r], at)
        for i in range(at, n):
            if i > at and i % CHUNK == 0:
                link = np.int64(links[link - 1].next)
            ids, confidences, frames = links[link - 1].c, links[link - 1].s, links[link - 1].f
            c = np.int64(ids[i % CHUNK])
            s = np.float64(confidences[i % CHUNK])
            weight = s
            if mode == UNWEIGHTED:
                weight = 1.0
            elif mode == RECENCY or mode == CONSENSUS:
                weight = s * np.exp(-decay * (newest - frame_t[frames[i % CHUNK]]))
                if mode == CONSENSUS and i > at and winner(classes, sums, n_classes, c_M) == c:
                    weight *= 1.0 + beta
            elif n_ids >= 2:
                # Every class but c gets (1 - s) / (K - 1). What all of them get changes no
                # argmax: take it off c instead.
                weight = s - (1.0 - s) / (n_ids - 1)
            k = place_of(classes, n_classes, c)
            if k == n_classes:
                classes[k], sums[k] = c, 0.0
                n_classes += 1
            sums[k] += weight
        if mode == PROBABILISTIC and place_of(classes, n_classes, c_M) == n_classes:
            classes[n_classes], sums[n_classes] = c_M, 0.0      # beyond a bounded history
            n_classes += 1
        labels[r] = winner(classes, sums, n_classes, c_M)
