"""Loops over voxels of the method for more than 64 classes: counting, scoring, deciding."""

import numpy as np
from persem_ros.core.geometry.candidates import gather
from persem_ros.core.geometry.dense import FAINT
from persem_ros.core.geometry.entries import count_in, FEW, FREE, value_of, wider
from persem_ros.core.geometry.parameters import OWN, TERM
from persem_ros.core.jit import kernel
from persem_ros.core.memory.blocks import step


@kernel
def count_shares(begin, end, start, count, place, share, total, rho, fine, coarse, shifted, K,
                 n_fine):
    """Return the sums over voxels begin .. end where Q is p."""
    C_keys, C = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    b_keys, b_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    s_keys, s_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    n_C, n_b, n_s = 0, 0, 0
    mass, R1 = np.zeros(K, np.int64), np.zeros((n_fine, K), np.int64)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        for e in range(start[r], start[r] + count[r]):
            z, q = np.int64(place[e]), share[e]
            for d in range(start[r], start[r] + count[r]):
                n_C += count_in(C_keys, C, z * K + place[d],
                                np.int64(np.rint(q * n * share[d] * TERM)))
                if 2 * n_C > len(C):
                    C_keys, C = wider(C_keys, C)
            whole = np.int64(np.rint(q * TERM))
            mass[z] += whole
            R1[fine[r], z] += whole
            n_b += count_in(b_keys, b_sums, np.int64(coarse[r]) * K + z, whole)
            if 2 * n_b > len(b_sums):
                b_keys, b_sums = wider(b_keys, b_sums)
            n_s += count_in(s_keys, s_sums, np.int64(shifted[r]) * K + z, whole)
            if 2 * n_s > len(s_sums):
                s_keys, s_sums = wider(s_keys, s_sums)
    return C_keys, C, mass, R1, b_keys, b_sums, s_keys, s_sums, np.zeros(K, np.int64), np.int64(0)


@kernel
def count_posteriors(begin, end, start, count, place, share, total, agreement, fine, coarse,
                     shifted, near_start, near, likely, log_pi, log_fine, theta_keys,
                     theta_values, rows, f, a, coarse_keys, coarse_values, coarse_rest,
                     shifted_keys, shifted_values, shifted_rest, rho, weight):
    """Return the sums over voxels begin .. end of a round without neighbours."""
    K = len(log_pi)
    C_keys, C = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    b_keys, b_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    s_keys, s_sums = np.full(FEW, FREE, np.int64), np.zeros(FEW, np.int64)
    n_C, n_b, n_s = 0, 0, 0
    mass, R1 = np.zeros(K, np.int64), np.zeros((len(log_fine), K), np.int64)
    alike, agreed = np.zeros(K, np.int64), np.int64(0)
    listed, Q = np.empty(K, np.int32), np.empty(K)
    for r in range(begin, end):
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        m = gather(near_start[r], near_start[r + 1], near, likely[fine[r]], listed, 0)
        most, whole = -np.inf, 0.0
        for j in range(m):
            z = np.int64(listed[j])
            likelihood = 0.0
            for e in range(start[r], start[r] + count[r]):
                c = np.int64(place[e])
                if c >= 0:
                    likelihood += share[e] * log_theta(theta_keys, theta_values, rows, f, a, K,
                                                       z, c)
            Q[j] = log_pi[z] + n * likelihood + weight * (
                log_fine[fine[r], z]
                + value_of(coarse_keys, coarse_values, np.int64(coarse[r]) * K + z,
                           coarse_rest[coarse[r]])
                + value_of(shifted_keys, shifted_values, np.int64(shifted[r]) * K + z,
                           shifted_rest[shifted[r]]))
            most = max(most, Q[j])
        for j in range(m):
            Q[j] = np.exp(Q[j] - most)
            whole += Q[j]
        for j in range(m):
            z, q = np.int64(listed[j]), Q[j] / whole
            term = np.int64(np.rint(q * TERM))
            mass[z] += term
            if q <= FAINT:
                continue
            for e in range(start[r], start[r] + count[r]):
                if place[e] < 0:
                    continue
                n_C += count_in(C_keys, C, z * K + place[e],
                                np.int64(np.rint(q * n * share[e] * TERM)))
                if 2 * n_C > len(C):
                    C_keys, C = wider(C_keys, C)
            R1[fine[r], z] += term
            n_b += count_in(b_keys, b_sums, np.int64(coarse[r]) * K + z, term)
            if 2 * n_b > len(b_sums):
                b_keys, b_sums = wider(b_keys, b_sums)
            n_s += count_in(s_keys, s_sums, np.int64(shifted[r]) * K + z, term)
            if 2 * n_s > len(s_sums):
                s_keys, s_sums = wider(s_keys, s_sums)
            if agreement[r] >= 0.0:
                alike[z] += term
                agreed += np.int64(np.rint(q * agreement[r] * TERM))
    return C_keys, C, mass, R1, b_keys, b_sums, s_keys, s_sums, alike, agreed


@kernel
def log_theta(keys, values, rows, f, a, K, z, c):
    """Return log(theta(z, c) + 1e-6), from the table or from the prior alone."""
    found = value_of(keys, values, z * K + c, np.inf)
    if found != np.inf:
        return found
    return np.log(a * (OWN * (z == c) + (1.0 - OWN) * f[c]) / (rows[z] + a) + 1e-6)


@kernel
def score(begin, end, wanted, start, count, place, share, total, fine, coarse, shifted, log_pi,
          log_fine, theta_keys, theta_values, rows, f, a, coarse_keys, coarse_values, coarse_rest,
          shifted_keys, shifted_values, shifted_rest, rho, weight, blocks, block, cell, row,
          where, own_start, listed, before, smoothing, after):
    """
    Write Q of the candidates of the rows wanted[begin:end] to *after*.

    own_start and listed are the candidates by where[row]; with a smoothing other than 0 the
    neighbours' Q are read from *before*.

    """
    K = len(log_pi)
    mean = np.zeros(K)
    for w in range(begin, end):
        r = wanted[w]
        n = total[r] / (1.0 + rho * max(total[r] - 1.0, 0.0))
        first, last = own_start[where[r]], own_start[where[r] + 1]
        for j in range(first, last):
            z = np.int64(listed[j])
            likelihood = 0.0
            for e in range(start[r], start[r] + count[r]):
                c = np.int64(place[e])
                if c >= 0:
                    likelihood += share[e] * log_theta(theta_keys, theta_values, rows, f, a, K,
                                                       z, c)
            after[j] = log_pi[z] + n * likelihood + weight * (
                log_fine[fine[r], z]
                + value_of(coarse_keys, coarse_values, np.int64(coarse[r]) * K + z,
                           coarse_rest[coarse[r]])
                + value_of(shifted_keys, shifted_values, np.int64(shifted[r]) * K + z,
                           shifted_rest[shifted[r]]))
        if smoothing != 0.0:
            around = 0
            for j in range(first, last):
                mean[listed[j]] = 0.0
            here = blocks[block[r]]
            for d in range(27):
                other, at = step(here, cell[r], d)
                if d == 13 or other == 0:
                    continue
                v = np.int64(blocks[other - 1].cells[at])
                if v == 0 or v > len(row) or row[v - 1] == 0:
                    continue
                around += 1
                u = where[np.int64(row[v - 1]) - 1]
                for j in range(own_start[u], own_start[u + 1]):
                    mean[listed[j]] += before[j]
            if around > 0:
                for j in range(first, last):
                    after[j] += smoothing * (mean[listed[j]] / around)
        most, whole = -np.inf, 0.0
        for j in range(first, last):
            most = max(most, after[j])
        for j in range(first, last):
            after[j] = np.exp(after[j] - most)
            whole += after[j]
        for j in range(first, last):
            after[j] /= whole


@kernel
def decide(begin, end, wanted, where, own_start, listed, posterior, best, confidence):
    """Write the most probable class and its probability; a tie goes to the smaller id."""
    for w in range(begin, end):
        r = wanted[w]
        first, last = own_start[where[r]], own_start[where[r] + 1]
        most = 0.0
        for j in range(first, last):
            most = max(most, posterior[j])
        j = first
        while most - posterior[j] > 1e-9:
            j += 1
        best[r] = listed[j]
        confidence[r] = posterior[j]
