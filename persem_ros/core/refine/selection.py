"""The selective methods of spec sections 3 and 4: recurrent voxels, anchor, trust, context."""

import numpy as np
from persem_ros.core.jit import inlined, kernel
from persem_ros.core.memory.blocks import step
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.memory.history import fetch, link_of, links_after, oldest, TOGETHER
from persem_ros.core.memory.pools import CHUNK
from persem_ros.core.refine.fusion import place_of, winner

MAJORITY, HISTORY, TRUST, CONTEXT = range(4)        # sources, spec section 8
NONE, PROPOSED, VERIFIED, CANDIDATE = range(4)      # what follows the anchor
# method: (history anchor first, what follows it)
METHODS = {'trust': (False, PROPOSED), 'context': (False, CANDIDATE), 'history': (True, NONE),
           'context_history': (True, CANDIDATE), 'persem': (True, VERIFIED)}
# Scratch of one thread: a record, because those are cheap to hand on (core.jit.inlined), made by
# the caller, because a record does not keep an array of the kernel's own alive.
SCRATCH = np.dtype([
    ('hist', 'f8', 65536), ('hard', 'f8', 65536),       # S_hist and S_hard by class
    ('touched', 'u2', 65536), ('mark', 'u1', 65536),    # the classes around, each once
    ('ids', 'u2', 65536), ('evidence', 'f8', 65536)])   # e of the replay
GAPS = 1024         # gaps in frames whose weight is looked up rather than computed


@kernel
def select(begin, end, scratch, blocks, links, frame_t, block, cell, row, start, classes, shares,
           majority, observations, first, head, neighbours, anchor, then, min_observations, eta,
           trust, gap, surprise, gamma, lambda_gap, tau_replay, tau_context, max_history, labels,
           sources):
    """
    Label rows begin .. end of a snapshot by the paper's refinement or a part of it.

    frame_t is t of every frame, trust (65536,) exp(-lambda_v rho(c)), gap (GAPS,)
    exp(-lambda_t dt), surprise exp(-lambda_s). Neighbours are visited only where they can
    matter, which they do for one voxel in five: an own lead that no neighbourhood can overturn
    settles the anchor.

    """
    work = scratch[0]
    chains, left = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    for r in range(begin, end):
        if (r - begin) % TOGETHER == 0 and (then == PROPOSED or then == VERIFIED):
            n = 0
            for q in range(r, min(r + TOGETHER, end)):
                if start[q + 1] - start[q] > 1 and observations[q] >= min_observations:
                    chains[n], left[n] = head[q], links_after(observations[q], first[q])
                    n += 1
            fetch(links, chains, left, n)
        c_M = np.int64(majority[r])
        labels[r] = c_M
        sources[r] = MAJORITY
        if observations[r] < min_observations:
            continue
        several = start[r + 1] - start[r] > 1
        around = -1                     # neighbours; -1: not visited yet
        n_touched = 0
        if anchor and not _safe(classes, shares, start[r], start[r + 1], c_M, eta):
            around, n_touched = _visit(blocks, block[r], cell[r], row, start, classes, shares,
                                       majority, neighbours, work)
            if around > 0:
                c_H = _anchor(classes, shares, start[r], start[r + 1], c_M, eta, work,
                              n_touched)
                if c_H != c_M:
                    labels[r] = c_H
                    sources[r] = HISTORY
                    _forget(work, n_touched)
                    continue
        if then == CANDIDATE:
            if around < 0:
                around, n_touched = _visit(blocks, block[r], cell[r], row, start, classes,
                                           shares, majority, neighbours, work)
            if around > 0:
                c = _hard_winner(work, n_touched, c_M)
                if c != c_M and _verified(work, c, c_M, tau_context):
                    labels[r] = c
                    sources[r] = CONTEXT
        elif several and (then == PROPOSED or then == VERIFIED):
            c = _replay(links, frame_t, observations[r], first[r], head[r], c_M, trust, gap,
                        surprise, gamma, lambda_gap, tau_replay, max_history, work)
            if c != c_M:
                if then == VERIFIED and around < 0:
                    around, n_touched = _visit(blocks, block[r], cell[r], row, start, classes,
                                               shares, majority, neighbours, work)
                if then == PROPOSED or (around > 0
                                        and _verified(work, c, c_M, tau_context)):
                    labels[r] = c
                    sources[r] = TRUST
        _forget(work, n_touched)


@inlined
def _safe(classes, shares, a, b, c_M, eta):
    """Return whether no neighbourhood can take the anchor from c_M."""
    own, second = 0.0, 0.0
    for e in range(a, b):
        if classes[e] == c_M:
            own = shares[e]
        else:
            second = max(second, shares[e])
    # (1 - eta) own >= (1 - eta) second + eta * 1; the slack covers rounding and TIE.
    return (1.0 - eta) * (own - second) > eta + 1e-6


@inlined
def _visit(blocks, b, cell, row, start, classes, shares, majority, neighbours, work):
    """
    Sum up the neighbours' shares and majority labels, in lexicographic order.

    Returns their number and how many classes were touched; hist and hard are left as means.

    """
    hist, hard, touched, mark = work.hist, work.hard, work.touched, work.mark
    block = blocks[b]
    around, n = 0, 0
    for d in neighbours:
        other, place = step(block, cell, d)
        if other == 0:
            continue
        cells = blocks[other - 1].cells
        v = np.int64(cells[place])
        if v == 0 or v > len(row) or row[v - 1] == 0:   # none, or newer than the snapshot
            continue
        u = np.int64(row[v - 1]) - 1
        around += 1
        for e in range(start[u], start[u + 1]):
            c = np.int64(classes[e])
            if mark[c] == 0:        # not by hist: a share may be 0
                mark[c] = 1
                touched[n] = c
                n += 1
            hist[c] += shares[e]
        hard[np.int64(majority[u])] += 1.0
    for k in range(n):
        c = np.int64(touched[k])
        hist[c] /= around
        hard[c] /= around
    return around, n


@inlined
def _forget(work, n):
    """Clear the support of the touched classes."""
    hist, hard, touched, mark = work.hist, work.hard, work.touched, work.mark
    for k in range(n):
        c = np.int64(touched[k])
        mark[c] = 0
        hist[c] = 0.0
        hard[c] = 0.0


@inlined
def _own(classes, shares, a, b, c):
    """Return p_v(c)."""
    for e in range(a, b):
        if classes[e] == c:
            return shares[e]
    return 0.0


@inlined
def _anchor(classes, shares, a, b, c_M, eta, work, n):
    """c_H = argmax (1 - eta) p_v + eta q_v over the classes of the voxel and its neighbours."""
    hist, touched = work.hist, work.touched
    most = 0.0
    for e in range(a, b):
        most = max(most, (1.0 - eta) * shares[e] + eta * hist[np.int64(classes[e])])
    for k in range(n):
        c = np.int64(touched[k])
        most = max(most, (1.0 - eta) * _own(classes, shares, a, b, c) + eta * hist[c])
    own = (1.0 - eta) * _own(classes, shares, a, b, c_M) + eta * hist[c_M]
    if most - own <= TIE:
        return c_M
    best = np.int64(65536)
    for e in range(a, b):
        c = np.int64(classes[e])
        if most - ((1.0 - eta) * shares[e] + eta * hist[c]) <= TIE:
            best = min(best, c)
    for k in range(n):
        c = np.int64(touched[k])
        if most - ((1.0 - eta) * _own(classes, shares, a, b, c) + eta * hist[c]) <= TIE:
            best = min(best, c)
    return best


@inlined
def _hard_winner(work, n, c_M):
    """Return argmax S_hard; c_M wins a tie that it takes part in, else the smaller id."""
    hard, touched = work.hard, work.touched
    most = 0.0
    for k in range(n):
        most = max(most, hard[np.int64(touched[k])])
    if most - hard[c_M] <= TIE:
        return c_M
    best = np.int64(65536)
    for k in range(n):
        c = np.int64(touched[k])
        if most - hard[c] <= TIE:
            best = min(best, c)
    return best


@inlined
def _verified(work, c, c_M, tau):
    """Return whether hard and history support of c over c_M both exceed tau (section 3.3)."""
    hist, hard = work.hist, work.hard
    return hard[c] - hard[c_M] > tau + TIE and hist[c] - hist[c_M] > tau + TIE


@inlined
def _replay(links, frame_t, observations, first, head, c_M, trust, gap, surprise, gamma,
            lambda_gap, tau, max_history, work):
    """
    Replay a history (section 3.2); return c_T where it is a proposal, else c_M.

    evidence e decays by gamma before each observation is added to it.

    """
    ids, evidence, n_ids = work.ids, work.evidence, 0
    n = np.int64(observations)
    at = oldest(n, first, max_history)
    link = link_of(links, head, first, at)
    before = np.int64(0)
    for i in range(at, n):
        if i > at and i % CHUNK == 0:
            link = np.int64(links[link - 1].next)
        if i == at or i % CHUNK == 0:
            record = links[link - 1]
            labels, confidences, frames = record.c, record.s, record.f
        c, t = np.int64(labels[i % CHUNK]), np.int64(frame_t[frames[i % CHUNK]])
        weight = np.float64(confidences[i % CHUNK]) * trust[c]
        if i > at:
            if winner(ids, evidence, n_ids, -1) != c:
                weight *= surprise
            dt = t - before
            weight *= gap[dt] if 0 <= dt < GAPS else np.exp(-lambda_gap * dt)
        before = t
        for k in range(n_ids):
            evidence[k] *= gamma
        k = place_of(ids, n_ids, c)
        if k == n_ids:
            ids[k], evidence[k] = c, 0.0
            n_ids += 1
        evidence[k] += weight
    c_T = winner(ids, evidence, n_ids, c_M)
    if c_T == c_M:
        return c_M
    k = place_of(ids, n_ids, c_M)
    own = evidence[k] if k < n_ids else 0.0
    return c_T if evidence[place_of(ids, n_ids, c_T)] - own > tau + TIE else c_M
