"""
The method geometry in plain numpy: section 12 of the specification, paragraph by paragraph.

Nothing here knows the package's core. A history is a list of (c, s, o): the class, the confidence
and the position of the sensor in the map frame. Voxels are tuples (i, j, k) as the map counts
them; the k of section 12 is the axis that points up.

"""

from collections import namedtuple
from itertools import product

import numpy as np

TIE = 1e-9
ONE = 2 ** 32               # votes are multiples of 1 / ONE
TERM = 2 ** 30              # terms of sums are multiples of 1 / TERM
HEIGHTS = 1, 2, 3, 5, 8, 14, 24
TILTS = 0.5, 0.9
ROUGHNESS = 0.02, 0.06
MOST_DENSE = 64
CANDIDATES = 16

Constants = namedtuple(     # what refine.geometry.* holds
    'Constants', 'directions window cell weight smoothing prior shrink rounds groups heights',
    defaults=(8, 20, 32, 0.5, 6.0, 60.0, 0.1, 3, 'both', ''))
Parameters = namedtuple('Parameters', 'pi theta counts ratios rho')
Result = namedtuple('Result', 'voxels classes labels posterior parameters shape')


# ---- 1: one vote per viewing direction


def direction(centre, sensor, directions=8):
    """Return the bin of a viewing direction, three integers."""
    delta = np.asarray(centre, float) - np.asarray(sensor, float)
    length = np.sqrt(delta[0] * delta[0] + delta[1] * delta[1] + delta[2] * delta[2])
    r = directions / length if length > 0 else 0.0
    return tuple(int(x) for x in np.floor(delta * r + 1e-9))


def votes(history, centre, directions=8, max_history=0):
    """Return ({c: H(c)} in units of 2^-32, {c: plain count}) of a history."""
    newest = history[-max_history:] if max_history else history
    bins = [direction(centre, o, directions) for _, _, o in newest]
    weights, counts = {}, {}
    for (c, s, _), where in zip(newest, bins):
        w = int(np.rint(s / bins.count(where) * ONE))
        weights[c] = weights.get(c, 0) + w
        counts[c] = counts.get(c, 0) + 1
    return weights, counts


# ---- 2: shape, from occupancy alone


def upright(voxel, up='z'):
    """Return a voxel's index with k up."""
    axis = 'xyz'.index(up[-1])
    k = voxel[axis]
    rest = [voxel[a] for a in range(3) if a != axis]
    return (*rest, -1 - k if up[0] == '-' else k)


def heights(voxels, window=20):
    """Return the height above ground of each voxel (n, 3) whose k is up."""
    columns = voxels[:, :2] - voxels[:, :2].min(axis=0)
    z = np.full(columns.max(axis=0) + 1, np.inf)
    np.minimum.at(z, tuple(columns.T), voxels[:, 2])
    observed = np.isfinite(z)
    e = within(z, window, np.minimum, np.inf)
    g = within(np.where(observed, e, -np.inf), window, np.maximum, -np.inf)
    return voxels[:, 2] - g[tuple(columns.T)].astype(np.int64)


def within(grid, window, extreme, nothing):
    """Return the extreme over the (2 window + 1) x (2 window + 1) square around each column."""
    for axis in (0, 1):
        size = grid.shape[axis]
        padding = [(0, 0), (0, 0)]
        padding[axis] = window, window
        padded = np.pad(grid, padding, constant_values=nothing)
        grid = extreme.reduce([padded.take(range(d, d + size), axis)
                               for d in range(2 * window + 1)])
    return grid


def tilt_and_roughness(voxel, occupied):
    """Return (u, r) of the occupied voxels in 5 x 5 x 5 around a voxel; u None where none."""
    offsets = [d for d in product(range(-2, 3), repeat=3)
               if tuple(np.add(voxel, d).tolist()) in occupied]
    if len(offsets) < 4:
        return None, 0.0
    covariance = np.cov(np.array(offsets).T, bias=True)
    trace = np.trace(covariance)
    if trace == 0:
        return None, 0.0
    spread, axes = np.linalg.eigh(covariance)
    r = max(spread[0], 0.0) / trace
    if spread[1] - spread[0] <= 1e-6 * trace:
        return None, r
    return abs(axes[2, 0]), r


def edges_below(x, edges):
    """Return the number of edges + 1e-9 < x."""
    return sum(edge + TIE < x for edge in edges)


def shapes(voxels, window=20, cell=32):
    """
    Return heights, u (nan: none), r and the three groups of voxels (n, 3) whose k is up.

    A group is b1 as a number below 96, or (coarse kind, tilt, cell i, cell j): in the coarse
    groups what has no tilt counts as level.

    """
    h, occupied = heights(voxels, window), set(map(tuple, voxels.tolist()))
    found = [tilt_and_roughness(v, occupied) for v in voxels.tolist()]
    groups = []
    for (i, j, _), height, (u, r) in zip(voxels.tolist(), h.tolist(), found):
        tilt = len(TILTS) + 1 if u is None else edges_below(u, TILTS)
        b1 = (sum(edge <= height for edge in HEIGHTS) * 4 + tilt) * 3 + edges_below(r, ROUGHNESS)
        kind = 0 if height < 2 else 1 if height < 6 else 2
        coarse = [(kind, min(tilt, 2), (i + o) // cell, (j + o) // cell) for o in (0, cell // 2)]
        groups.append((b1, *coarse))
    return (h, np.array([np.nan if u is None else u for u, _ in found]),
            np.array([r for _, r in found]), groups)


def numbered(groups):
    """Return three arrays (n,) of numbers of groups, and how many there are of each."""
    columns = []
    for k in range(3):
        known = {}
        columns.append(np.array([known.setdefault(g[k], len(known)) for g in groups]))
    return columns, [int(c.max()) + 1 for c in columns]


# ---- 3: score


def looks(N, rho):
    """Return the effective numbers of independent looks."""
    return N / (1 + rho * np.maximum(N - 1, 0))


def hinted(heights, shapes, classes):
    """Return 0.01 where heights 'c low high; ...' rule a class out for a b1, else 1: (b, K)."""
    edges, factor = [-np.inf, *HEIGHTS, np.inf], np.ones((len(shapes), len(classes)))
    for c, low, high in (part.split() for part in heights.split(';') if part.strip()):
        for b, b1 in enumerate(shapes):
            below, above = edges[b1 // 12], edges[b1 // 12 + 1]     # height in [below, above)
            if int(c) in classes and (below > float(high) or above <= float(low)):
                factor[b, classes.index(int(c))] = 0.01
    return factor


def score(parameters, p, n, groups, allowed, constants, hint, neighbours=None):
    """
    Return Q (n, K): the softmax of the scores.

    allowed (n, K) says which classes are candidates; neighbours is (n, K), the mean of the
    neighbours' Q, 0 without any; hint (groups by shape, K) is hinted().

    """
    likelihood, log_theta = np.zeros_like(p), np.log(parameters.theta + 1e-6)
    for c in range(p.shape[1]):
        likelihood += p[:, c, None] * log_theta[None, :, c]
    shape = np.log(hint)[groups[0]]
    for k, (ratio, group) in enumerate(zip(parameters.ratios, groups)):
        if constants.groups in ('both', 'cells' if k else 'shapes'):
            shape += np.log(ratio / parameters.pi)[group]
    S = np.log(parameters.pi) + n[:, None] * likelihood + constants.weight * shape
    if neighbours is not None:
        S = S + constants.smoothing * neighbours
    S = np.where(allowed, S, -np.inf)
    Q = np.exp(S - S.max(axis=1)[:, None])
    total = np.zeros(len(Q))
    for z in range(Q.shape[1]):
        total += Q[:, z]
    return Q / total[:, None]


def around(voxels):
    """Return the rows of each voxel's N26, lexicographic."""
    row = {v: r for r, v in enumerate(map(tuple, voxels.tolist()))}
    steps = [d for d in product((-1, 0, 1), repeat=3) if any(d)]
    result = []
    for i, j, k in voxels.tolist():
        result.append([row[n] for n in ((i + a, j + b, k + c) for a, b, c in steps) if n in row])
    return result


def neighbour_mean(Q, near):
    """Return the mean of the neighbours' Q of each voxel, 0 without any."""
    mean = np.zeros_like(Q)
    for r, rows in enumerate(near):
        for u in rows:
            mean[r] += Q[u]
        if rows:
            mean[r] /= len(rows)
    return mean


def candidates(p, near, parameters, group, dense, hint):
    """Return (n, K): the classes that a voxel may be given."""
    n, K = p.shape
    if K <= dense:
        return np.ones((n, K), bool)
    seen = p > 0
    allowed = seen.copy()
    for r, rows in enumerate(near):
        for u in rows:
            allowed[r] |= seen[u]
    most = np.argsort(-parameters.ratios[0] * hint, axis=1, kind='stable')[:, :CANDIDATES]
    for r in range(n):
        allowed[r, most[group[r]]] = True
    return allowed


# ---- 4: parameters


def fixed(terms):
    """Return terms as whole multiples of 2^-30."""
    return np.rint(terms * TERM).astype(np.int64)


def estimate(Q, p, n, groups, sizes, rho, constants, everything=False):
    """Return the Parameters that follow from Q."""
    K, kept = Q.shape[1], np.where((Q > 1e-4) | everything, Q, 0.0)
    C = np.array([[fixed(kept[:, z] * n * p[:, c]).sum() for c in range(K)]
                  for z in range(K)]) / TERM
    total = C.sum()
    f, a = C.sum(axis=0) / total, constants.shrink * total / K
    prior = 0.7 * np.eye(K) + 0.3 * f
    theta = (C + a * prior) / (C.sum(axis=1)[:, None] + a)
    pi = fixed(Q).sum(axis=0) / TERM / len(Q) + 1e-9
    pi /= pi.sum()
    ratios = []
    for group, size in zip(groups, sizes):
        R = np.zeros((size, K), np.int64)
        np.add.at(R, group, fixed(kept))
        R = R / TERM
        ratios.append((R + constants.prior * pi)
                      / (R.sum(axis=1)[:, None] + constants.prior))
    return Parameters(pi, theta, C, ratios, rho)


# ---- 5: schedule


def correlation(Q, C, counts, enough, rho):
    """Return rho after the first round; counts (n, K) are plain, enough (n,) says N_v >= 2."""
    if not enough.any():
        return rho
    n_c, kept = counts[enough], np.where(Q > 1e-4, Q, 0.0)[enough]
    n = n_c.sum(axis=1)
    agree = ((n_c ** 2).sum(axis=1) - n) / np.maximum(n * (n - 1), 1)
    share = fixed(kept).sum(axis=0) / TERM
    A = fixed(kept * agree[:, None]).sum() / TERM / share.sum()
    rows = C.sum(axis=1)
    theta = C / np.where(rows > 0, rows, 1.0)[:, None]
    B = (share / share.sum() * (theta ** 2).sum(axis=1)).sum()
    return rho if 1 - B <= 1e-9 else float(np.clip(2 * (A - B) / (1 - B), 0.1, 0.6))


def geometry(histories, voxel_size, origin=(0.0, 0.0, 0.0), up='z', max_history=0,
             constants=None, dense=MOST_DENSE):
    """
    Section 12 as a whole.

    Parameters
    ----------
    histories : dict
        {voxel: [(c, s, o), ...]}, not empty.
    voxel_size : float
        Metres.
    origin : sequence of 3 float
        Of the voxels, metres.
    up : str
        Which axis points up.
    max_history : int
        Newest observations that count; 0: all.
    constants : Constants
        Those of refine.geometry; None: the defaults.
    dense : int
        The largest K of the dense form.

    Returns
    -------
    Result
        voxels in the order of *histories*, classes, labels (n,), posterior (n, K), the last
        Parameters and what shapes() returned.

    """
    constants = constants or Constants()
    names = list(histories)
    weights, plain = zip(*(votes(
        histories[v], (np.array(v) + 0.5) * voxel_size + np.array(origin), constants.directions,
        max_history) for v in names))
    classes = sorted(set().union(*weights))
    H = np.array([[w.get(c, 0) for c in classes] for w in weights], np.int64)
    counts = np.array([[w.get(c, 0) for c in classes] for w in plain], np.int64)
    N = H.sum(axis=1) / ONE
    p = H / ONE / N[:, None]
    voxels = np.array([upright(v, up) for v in names])
    shape = shapes(voxels, constants.window, constants.cell)
    groups, sizes = numbered(shape[3])
    near = around(np.array(names))
    hint = hinted(constants.heights, dict.fromkeys(g[0] for g in shape[3]), classes)

    Q, rho = p, 0.4
    parameters = estimate(Q, p, looks(N, rho), groups, sizes, rho, constants, everything=True)
    for number in range(constants.rounds):
        n = looks(N, rho)
        allowed = candidates(p, near, parameters, groups[0], dense, hint)
        Q = score(parameters, p, n, groups, allowed, constants, hint)
        parameters = estimate(Q, p, n, groups, sizes, rho, constants)
        if number == 0:
            rho = correlation(Q, parameters.counts, counts, N >= 2, rho)
    n = looks(N, rho)
    parameters = parameters._replace(rho=rho)
    allowed = candidates(p, near, parameters, groups[0], dense, hint)
    Q = score(parameters, p, n, groups, allowed, constants, hint)
    for _ in range(2):
        Q = score(parameters, p, n, groups, allowed, constants, hint, neighbour_mean(Q, near))
    labels = [classes[int(np.flatnonzero(row.max() - row <= TIE)[0])] for row in Q]
    return Result(names, classes, np.array(labels), Q, parameters, shape)
