"""
Posteriors of voxels, for up to 64 classes: what their votes and groups say, then their neighbours.

All of it in the order that section 12 gives. What votes and groups say is kept for the rounds in
which neighbours speak, and so are the lists of neighbours: three rounds take 39 ms of one
processor in place of 51 (67 600 voxels, 16 classes).

"""

import numpy as np
from persem_ros.core.geometry.neighbours import TOGETHER
from persem_ros.core.geometry.softmax import softmax
from persem_ros.core.jit import inlined, kernel

MOST = 64           # classes; more have few candidates a voxel (core.geometry.sparse)
TIED = 1e-9         # posteriors that differ by no more are equal
WORK = np.dtype([('Q', 'f8', MOST), ('scratch', 'f8', MOST), ('mean', 'f8', MOST)])
assert TOGETHER == 4, 'smooth() spells it out'


@inlined
def say(a, b, n, place, share, log_pi, log_theta, log_fine, one, log_coarse, two, log_shifted,
        three, weight, Q):
    """
    Write what votes a .. b and the groups of a voxel say of each class, unnormalised logs.

    Tables are flat, one, two and three where its groups' rows begin: a view of a row would cost
    two atomic operations, as arrays do that are not a record's and change from call to call.
    Unsigned places need no look at their sign, so that loops become vectors.

    """
    K, u1, u2, u3 = len(log_pi), np.uint64(one), np.uint64(two), np.uint64(three)
    for z in range(K):
        Q[z] = 0.0
    for e in range(a, b):
        if place[e] < 0:        # a class that the parameters do not know
            continue
        p, of = share[e], np.uint64(place[e]) * np.uint64(K)
        for z in range(K):
            Q[z] += p * log_theta[of + np.uint64(z)]
    for z in range(K):
        u = np.uint64(z)
        Q[z] = log_pi[z] + n * Q[z] + weight * (
            log_fine[u1 + u] + log_coarse[u2 + u] + log_shifted[u3 + u])


@kernel
def state(begin, end, work, wanted, start, count, place, share, total, fine, coarse, shifted,
          log_pi, log_theta, log_fine, log_coarse, log_shifted, rho, weight, said, after):
    """
    Write what votes and groups say of the rows wanted[begin:end], and Q by these alone.

    *said* and *after* are flat, K numbers a place in *wanted*; so are the tables, with K a group.

    """
    K = len(log_pi)
    Q, scratch = work[0].Q, work[0].scratch
    bits = scratch.view(np.int64)
    for w in range(begin, end):
        r = wanted[w]
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        say(start[r], start[r] + count[r], n, place, share, log_pi, log_theta, log_fine,
            fine[r] * K, log_coarse, coarse[r] * K, log_shifted, shifted[r] * K, weight, Q)
        mine = np.uint64(w) * np.uint64(K)
        for c in range(K):
            said[mine + np.uint64(c)] = Q[c]
        softmax(K, Q, scratch, bits)
        for c in range(K):
            after[mine + np.uint64(c)] = Q[c]


@kernel
def smooth(begin, end, work, wanted, where, said, K, listed, beside, before, smoothing, after,
           best, confidence):
    """
    Write Q of the rows wanted[begin:end] to *after*, at where[row], now that neighbours speak.

    *before* holds the Q of the last round and ends with a row of zeros; *listed* and *beside* are
    core.geometry.neighbours.list_neighbours(). Where *best* has room, the most probable class and
    its probability are written, by row, and not Q.

    """
    Q, scratch, mean = work[0].Q, work[0].scratch, work[0].mean
    bits, wide, decides = scratch.view(np.int64), np.uint64(K), len(best) > 0
    for w in range(begin, end):
        r = wanted[w]
        own = np.int64(where[r])
        mine, around = np.uint64(own) * wide, np.int64(beside[own])
        for c in range(K):
            mean[c] = 0.0
        for k in range(0, around, TOGETHER):        # four a pass, in the order of one a pass
            one, two = np.uint64(listed[own, k]) * wide, np.uint64(listed[own, k + 1]) * wide
            three = np.uint64(listed[own, k + 2]) * wide
            four = np.uint64(listed[own, k + 3]) * wide
            for c in range(K):
                u = np.uint64(c)
                mean[c] = (((mean[c] + before[one + u]) + before[two + u])
                           + before[three + u]) + before[four + u]
        for c in range(K):
            Q[c] = said[mine + np.uint64(c)]
        if around > 0:
            for c in range(K):
                Q[c] += smoothing * (mean[c] / around)
        softmax(K, Q, scratch, bits)
        if decides:
            z = most_probable(K, Q)
            best[r], confidence[r] = z, Q[z]
        else:
            for c in range(K):
                after[mine + np.uint64(c)] = Q[c]


@inlined
def most_probable(K, Q):
    """Return the most probable class; a tie goes to the smaller id."""
    most = Q[0]
    for z in range(1, K):
        most = max(most, Q[z])
    z = 0
    while most - Q[z] > TIED:
        z += 1
    return z
