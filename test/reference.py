"""
What the package computes, in plain Python: dicts, lists and loops, as obvious as possible.

Written from the specification alone, paragraph by paragraph; each docstring names the section that
it restates. Nothing here knows the package's core, and nothing here is fast. A voxel is a tuple
(i, j, k), a class an int, a history a list of (c, s, t) with c the class, s the confidence as a
float and t the integer time. Frames: sensor frame for points, map frame for voxels, metres.

"""

from collections import Counter, defaultdict, namedtuple
from fractions import Fraction
from itertools import product
import math
import statistics

import geometry_reference
import numpy as np

TIE = 1e-9          # x ties y when |x - y| <= TIE; "> tau" means "> tau + TIE"
MAX_ID = 65534
UNKNOWN = 65535
MAJORITY, HISTORY, TRUST, CONTEXT, GEOMETRY = 0, 1, 2, 3, 4
FUSION = ('majority', 'unweighted', 'recency', 'consensus', 'probabilistic')
SELECTIVE = ('trust', 'context', 'history', 'context_history', 'persem')

Observation = namedtuple('Observation', 'c s t')


# ---- section 1: one frame


def resampled(image, height, width):
    """Section 1: an image (rows of values) on another grid of its aspect ratio, nearest."""
    rows, columns = len(image), len(image[0])
    return [[image[int((v + 0.5) * rows / height)][int((u + 0.5) * columns / width)]
             for u in range(width)] for v in range(height)]


def backproject(depth, rays, labels, ignored=(255, 65535), dynamic=(), min_depth=0.1,
                max_depth=200.0, stride=1):
    """
    Section 1: the points of a frame's pixels that count.

    Parameters
    ----------
    depth : rows of float, (h, w)
        Metres along the optical axis.
    rays : nested sequence, (h, w, 2)
        ((u - cx) / fx, (v - cy) / fy) of every pixel.
    labels : rows of int, (H, W)
        Class ids, resampled to the depth's grid when the size differs.
    ignored, dynamic : sequences of int
        Ids that are not integrated.
    min_depth, max_depth : float
        Range in which a pixel counts, both ends included.
    stride : int
        Every n-th pixel of every n-th row.

    Returns
    -------
    points : list of (x, y, z)
        Sensor frame, metres.
    labels : list of int
        The id of each point.

    """
    height, width = len(depth), len(depth[0])
    labels = resampled(labels, height, width)
    points, ids = [], []
    for v in range(0, height, stride):
        for u in range(0, width, stride):
            d, label = float(depth[v][u]), int(labels[v][u])
            measured = math.isfinite(d) and d > 0 and min_depth <= d <= max_depth
            if measured and countable(label) and label not in ignored and label not in dynamic:
                points.append((float(rays[v][u][0]) * d, float(rays[v][u][1]) * d, d))
                ids.append(label)
    return points, ids


def auto_stride(depth, focal, voxel_size, min_depth=0.1, max_depth=200.0):
    """Section 13: the stride that memory.stride 0 stands for; depth as in backproject()."""
    valid = [float(d) for row in depth for d in row
             if math.isfinite(d) and d > 0 and min_depth <= d <= max_depth]
    return max(1, math.floor(focal * voxel_size / (3 * statistics.median(valid)))) if valid else 1


def countable(label):
    """Section 1: negative ids are ignored pixels, 65534 is the largest id."""
    return 0 <= label <= MAX_ID


def voxel_of(point, T, voxel_size, origin=(0.0, 0.0, 0.0)):
    """Section 1: p_map = R p + t, voxel = floor(p_map / voxel_size) per axis."""
    voxel = []
    for axis in range(3):
        R, t = T[axis][:3], T[axis][3] - origin[axis]
        p_map = R[0] * point[0] + R[1] * point[1] + R[2] * point[2] + t
        voxel.append(math.floor(p_map / voxel_size))
    return tuple(voxel)


def observe(points, labels, T, voxel_size, min_pixels=1, origin=(0.0, 0.0, 0.0), weights=None):
    """
    Sections 1 and 11: the pixels of a voxel become ONE observation.

    Parameters
    ----------
    points : iterable of (x, y, z)
        Sensor frame, metres; a point that is not finite does not count.
    labels : iterable of int
        The id of each point; ids below 0 or above 65534 do not count.
    T : 4x4 matrix
        Maps sensor points to the map.
    voxel_size : float
        Metres.
    min_pixels : int
        A voxel with fewer counted pixels is not observed.
    origin : (x, y, z)
        Point of the map frame that is subtracted, metres.
    weights : iterable of float, optional
        The segmenter's confidence w of each point, 0 .. 1; NaN or 0 (rounded): it does not count.

    Returns
    -------
    dict
        {voxel: (label, s)}; s is the float32 of the label's share, as a float.

    """
    counts, numbers = defaultdict(Counter), Counter()
    weights = [1.0] * len(labels) if weights is None else weights
    for point, label, w in zip(points, labels, weights):
        w = 0 if math.isnan(w) else Fraction(round(min(max(w, 0), 1) * 2 ** 16), 2 ** 16)
        if countable(int(label)) and all(math.isfinite(x) for x in point) and w > 0:
            voxel = voxel_of(point, T, voxel_size, origin)
            counts[voxel][int(label)] += w
            numbers[voxel] += 1
    result = {}
    for voxel, counter in counts.items():
        counted = numbers[voxel]
        if counted >= min_pixels:
            most = max(counter.values())
            label = min(c for c in counter if counter[c] == most)
            result[voxel] = label, float(np.float32(most / counted))
    return result


# ---- section 2: memory


def argmax(values, preferred=None):
    """
    Section 2, fixed: the class with the largest value of {class: value}.

    A value ties the largest when it is at most 1e-9 below it. The preferred (majority) label wins
    a tie that it takes part in, otherwise the smaller id wins.

    """
    largest = max(values.values())
    tied = [c for c in values if largest - values[c] <= TIE]
    return preferred if preferred in tied else min(tied)


def exceeds(x, tau):
    """Section 2, fixed: "x > tau" means x > tau + 1e-9."""
    return x > tau + TIE


def offsets(n):
    """Section 2: the 6, 18 or 26 (dx, dy, dz) around a voxel, in lexicographic order."""
    steps = {6: 1, 18: 2, 26: 3}[n]
    return [d for d in product((-1, 0, 1), repeat=3) if 0 < sum(map(abs, d)) <= steps]


class Memory:
    """
    Section 2: every voxel's history, in order, and the table of frames.

    Attributes
    ----------
    voxel_size, origin : float, sequence of 3 float
        Metres; only section 12 asks.
    histories : dict
        {voxel: [(c, s, t), ...]}.
    rows : dict
        {voxel: [f, ...]}: the frame of each observation, a place in *frames*.
    frames : list
        (stamp, sensor, T) of every added frame; stamps are nanoseconds.
    stamps : dict
        The distinct stamps in order of integration, and t, the place in that order.
    ids : set
        The distinct ids of all counted pixels.

    """

    def __init__(self, voxel_size=0.5, origin=(0.0, 0.0, 0.0)):
        """Start empty."""
        self.voxel_size, self.origin = voxel_size, origin
        self.histories, self.rows = {}, {}
        self.frames = []
        self.stamps = {}
        self.ids = set()

    def add(self, observations, stamp, ids=(), sensor='', T=None):
        """Section 1: add {voxel: (c, s)} of one frame; *ids* are those of its counted pixels."""
        t = self.stamps.setdefault(stamp, len(self.stamps))
        self.frames.append((stamp, sensor, T))
        self.ids.update(int(c) for c in ids if countable(int(c)))
        for voxel, (c, s) in observations.items():
            self.ids.add(c)
            self.histories.setdefault(voxel, []).append(Observation(c, s, t))
            self.rows.setdefault(voxel, []).append(len(self.frames) - 1)

    def evidence(self, voxel):
        """Section 2: h_v(c), the sum of s_i over the observations of class c."""
        h = {}
        for c, s, _ in self.histories[voxel]:
            h[c] = h.get(c, 0.0) + s
        return h

    def share(self, voxel):
        """Section 2: p_v = h_v / sum of h_v."""
        h = self.evidence(voxel)
        total = sum(h.values())
        return {c: h[c] / total for c in h}

    def majority(self, voxel):
        """Section 2: c_M = argmax h_v, a tie goes to the smaller id."""
        return argmax(self.evidence(voxel))

    def neighbours(self, voxel, n):
        """Section 2: the observed voxels among the n around it, in lexicographic order."""
        around = [tuple(a + b for a, b in zip(voxel, d)) for d in offsets(n)]
        return [u for u in around if u in self.histories]

    def volatility(self):
        """Section 3: rho(c) over all consecutive pairs of all histories; absent means 0."""
        pairs, changes = Counter(), Counter()
        for history in self.histories.values():
            for one, following in zip(history, history[1:]):
                pairs[one.c] += 1
                changes[one.c] += following.c != one.c
        return {c: changes[c] / pairs[c] for c in pairs}


# ---- section 3: refinement, and section 4: the other methods


def mean_share(memory, around):
    """Section 3, step 1: q_v, the mean of p_u over the neighbours; empty where none is."""
    q = defaultdict(float)
    for u in around:
        for c, p in memory.share(u).items():
            q[c] += p
    return {c: total / len(around) for c, total in q.items()}


def hard_share(memory, around):
    """Section 3, step 3: S_hard(c), the share of the neighbours whose majority label is c."""
    votes = Counter(memory.majority(u) for u in around)
    return {c: n / len(around) for c, n in votes.items()}


def anchor(memory, voxel, settings):
    """Section 3, step 1: c_H = argmax (1 - eta) p_v + eta q_v; c_M with no neighbour."""
    majority = memory.majority(voxel)
    around = memory.neighbours(voxel, settings.neighbours)
    if not around:
        return majority
    p, q = memory.share(voxel), mean_share(memory, around)
    mixed = {c: (1 - settings.eta) * p.get(c, 0.0) + settings.eta * q.get(c, 0.0)
             for c in set(p) | set(q)}
    return argmax(mixed, majority)


def trusted_evidence(history, rho, settings):
    """Section 3, step 2: e after the replay of a history, {class: evidence}."""
    e = {}
    for i, (c, s, t) in enumerate(history):
        surprised = 1 if i > 0 and c != argmax(e) else 0
        gap = t - history[i - 1].t if i > 0 else 0
        w = (s * math.exp(-settings.lambda_volatility * rho.get(c, 0.0))
             * math.exp(-settings.lambda_disagreement * surprised)
             * math.exp(-settings.lambda_gap * gap))
        e = {known: settings.gamma * value for known, value in e.items()}
        e[c] = e.get(c, 0.0) + w
    return e


def proposal(memory, voxel, rho, settings, max_history=0):
    """Section 3, step 2: the class that the replay of the newest proposes, or None."""
    majority = memory.majority(voxel)
    newest = memory.histories[voxel][-max_history:]     # [-0:] is all of it
    e = trusted_evidence(newest, rho, settings)
    e.setdefault(majority, 0.0)
    best = argmax(e, majority)
    if best != majority and exceeds(e[best] - e[majority], settings.tau_replay):
        return best
    return None


def margins(memory, voxel, candidate, settings):
    """Section 3, step 3: candidate over c_M in S_hard and in S_hist; 0, 0 with no neighbour."""
    around = memory.neighbours(voxel, settings.neighbours)
    if not around:
        return 0.0, 0.0
    majority = memory.majority(voxel)
    hard, soft = hard_share(memory, around), mean_share(memory, around)
    return (hard.get(candidate, 0.0) - hard.get(majority, 0.0),
            soft.get(candidate, 0.0) - soft.get(majority, 0.0))


def verified(memory, voxel, candidate, settings):
    """Section 3, step 3: both margins exceed tau_context; never with no neighbour."""
    return (bool(memory.neighbours(voxel, settings.neighbours))
            and all(exceeds(m, settings.tau_context)
                    for m in margins(memory, voxel, candidate, settings)))


def context_candidate(memory, voxel, settings):
    """Section 4, context: argmax S_hard where it is taken from c_M, else None."""
    around = memory.neighbours(voxel, settings.neighbours)
    if not around:
        return None
    majority = memory.majority(voxel)
    candidate = argmax(hard_share(memory, around), majority)
    if candidate != majority and verified(memory, voxel, candidate, settings):
        return candidate
    return None


def selective(memory, voxel, method, rho, settings, max_history=0):
    """Sections 3 and 4: (label, source) of one recurrent voxel under a selective method."""
    majority = memory.majority(voxel)
    if method in ('history', 'context_history', 'persem'):
        found = anchor(memory, voxel, settings)
        if found != majority:
            return found, HISTORY
    if method in ('trust', 'persem'):
        found = proposal(memory, voxel, rho, settings, max_history)
        if found is not None and (method == 'trust'
                                  or verified(memory, voxel, found, settings)):
            return found, TRUST
    if method in ('context', 'context_history'):
        found = context_candidate(memory, voxel, settings)
        if found is not None:
            return found, CONTEXT
    return majority, MAJORITY


def fused(memory, voxel, method, settings, max_history=0):
    """Section 4: the label of one voxel under a fusion method; of what a bound has kept."""
    majority = memory.majority(voxel)
    if method == 'majority':
        return majority
    history = memory.histories[voxel][-max_history:]
    score = {}
    for i, (c, s, t) in enumerate(history):
        if method == 'probabilistic':
            others = memory.ids - {c}
            score[c] = score.get(c, 0.0) + s
            for other in others:
                score[other] = score.get(other, 0.0) + (1 - s) / len(others)
            continue
        weight = 1.0 if method == 'unweighted' else \
            s * math.exp(-settings.lambda_recency * (history[-1].t - t))
        if method == 'consensus' and i > 0 and c == argmax(score, majority):
            weight *= 1 + settings.beta
        score[c] = score.get(c, 0.0) + weight
    return argmax(score, majority)


def label(memory, method, settings, max_history=0, rho=None):
    """
    Sections 3 and 4: the label of every voxel.

    Parameters
    ----------
    memory : Memory
        What was seen.
    method : str
        One of FUSION and SELECTIVE, or geometry.
    settings : persem_ros.settings.config.Refine
        The constants.
    max_history : int
        The newest observations of a voxel that replays and fusion methods read; 0 = all.
    rho : dict, optional
        Class volatility; taken fresh by default.

    Returns
    -------
    dict
        {voxel: (label, source)}.

    """
    rho = memory.volatility() if rho is None else rho
    result = {}
    if method == 'geometry':
        return geometrical(memory, settings, max_history) if memory.histories else {}
    for voxel, history in memory.histories.items():
        if method in FUSION:
            result[voxel] = fused(memory, voxel, method, settings, max_history), MAJORITY
        elif len(history) < settings.min_observations:
            result[voxel] = memory.majority(voxel), MAJORITY
        else:
            result[voxel] = selective(memory, voxel, method, rho, settings, max_history)
    return result


def geometrical(memory, settings, max_history=0):
    """Section 12: {voxel: (label, source)}."""
    positions = [(0.0, 0.0, 0.0) if T is None else tuple(np.array(T)[:3, 3])
                 for _, _, T in memory.frames]
    found = geometry_reference.geometry(
        {v: [(c, s, positions[f]) for (c, s, _), f in zip(
            history, memory.rows[v][-len(history):])]
         for v, history in memory.histories.items()},
        memory.voxel_size, memory.origin, settings.up, max_history, settings.geometry)
    return {v: (label_, GEOMETRY if label_ != memory.majority(v) else MAJORITY)
            for v, label_ in zip(found.voxels, found.labels.tolist())}


def ema2d(images, alpha, ignored=(255, 65535)):
    """
    Section 4, ema2d: label images smoothed pixel by pixel; a list of lists of rows.

    A pixel's first label starts its p; where p does not exist yet the answer is -1.

    """
    results, shape, p = [], None, {}
    for image in images:
        if (len(image), len(image[0])) != shape:
            shape, p = (len(image), len(image[0])), {}
        result = [[-1] * shape[1] for _ in range(shape[0])]
        for v, u in product(range(shape[0]), range(shape[1])):
            c = int(image[v][u])
            if countable(c) and c not in ignored:
                if (v, u) in p:
                    p[v, u] = {k: alpha * x for k, x in p[v, u].items()}
                    p[v, u][c] = p[v, u].get(c, 0.0) + (1 - alpha)
                else:
                    p[v, u] = {c: 1.0}
            if (v, u) in p:
                result[v][u] = argmax(p[v, u])
        results.append(result)
    return results


# ---- section 5: reprojection


def render(refined, points, labels, T, voxel_size, fill='input', dynamic=(),
           origin=(0.0, 0.0, 0.0)):
    """
    Section 5: the refined label of every pixel.

    Parameters
    ----------
    refined : dict
        {voxel: label} of the map.
    points : iterable of (x, y, z) or None
        What each pixel sees, sensor frame; None for a pixel without depth.
    labels : iterable of int
        The frame's own labels.
    T, voxel_size, origin
        As in observe().
    fill : str
        'input': the frame's own label where the map knows nothing; 'unknown': UNKNOWN.
    dynamic : sequence of int
        Own labels that pass through unchanged.

    Returns
    -------
    list of int

    """
    result = []
    for point, own in zip(points, labels):
        voxel = None if point is None else voxel_of(point, T, voxel_size, origin)
        if own in dynamic:
            result.append(own)
        elif voxel in refined:
            result.append(refined[voxel])
        else:
            result.append(own if fill == 'input' else UNKNOWN)
    return result


# ---- section 6: metrics


# ---- section 10: clearing what moved away


def seen_through(depth, K, T, voxel, voxel_size, origin=(0.0, 0.0, 0.0), min_depth=0.1,
                 margin=1.5, slope=0.02, far=30.0):
    """
    Section 10: whether all that is measured around a voxel lies behind it.

    Parameters
    ----------
    depth : rows of float, (h, w)
        Metres; finite and >= min_depth: measured.
    K : nested sequence, (3, 3)
        The pinhole matrix.
    T : nested sequence, (4, 4)
        T_map_camera.
    voxel : tuple of int
        Its index.
    voxel_size, origin
        Metres.
    min_depth, far
        Metres along the optical axis, between which a voxel is looked at.
    margin
        Voxels by which the measured depth has to lie behind it.
    slope
        The same, as a share of the depth.

    """
    h, w = len(depth), len(depth[0])
    pixels, farthest = [], 0.0
    for corner in product((0, 1), repeat=3):
        d = [(i + c) * voxel_size + o - T[a][3]
             for a, (i, c, o) in enumerate(zip(voxel, corner, origin))]
        x, y, z = (sum(T[b][a] * d[b] for b in range(3)) for a in range(3))
        if z <= 0 or z > far:
            return False
        u, v = K[0][0] * x / z + K[0][2], K[1][1] * y / z + K[1][2]
        if not (-0.5 <= u < w - 0.5 and -0.5 <= v < h - 0.5):
            return False
        pixels.append((math.floor(u + 0.5), math.floor(v + 0.5)))
        farthest = max(farthest, z)
    (u0, v0), (u1, v1) = (tuple(f(a) for a in zip(*pixels)) for f in (min, max))
    around = [depth[v][u] for v in range(v0, v1 + 1) for u in range(u0, u1 + 1)]
    measured = [z for z in around if math.isfinite(z) and z >= min_depth and z > 0]
    bound = farthest + margin * voxel_size + slope * farthest
    return bool(measured) and 2 * len(measured) >= len(around) and all(
        z > bound for z in measured)


class Clearing:
    """
    Section 10: looks through voxels, and which voxels are gone.

    Parameters
    ----------
    after : int
        memory.clear_after.

    """

    def __init__(self, after):
        self.after, self.looks, self.gone = after, {}, set()

    def frame(self, observed, counts, stamp, through):
        """
        Take in a frame, after its own observations were added.

        Parameters
        ----------
        observed : iterable of voxel
            What the frame observed.
        counts : dict
            {voxel: N_v}.
        stamp : int
            Nanoseconds.
        through : callable
            through(voxel): whether the frame looks through it.

        """
        for voxel in observed:
            self.looks.pop(voxel, None)
            self.gone.discard(voxel)
        second = stamp // 10 ** 9
        for voxel in set(counts) - self.gone:
            n, last = self.looks.get(voxel, (0, None))
            if last != second and through(voxel):
                self.looks[voxel] = n + 1, second
                if n + 1 >= max(self.after, 0.1 * counts[voxel]):
                    self.gone.add(voxel)


def grouped(label_, table):
    """Section 6: the group of an id; None for an id outside the many-to-one table."""
    return table.get(label_)


def confusion(truths, predictions, valids):
    """Section 6: {(truth, prediction): pixels} of flat sequences over the valid pixels."""
    return Counter((t, p) for t, p, valid in zip(truths, predictions, valids) if valid)


def pixel_accuracy(table):
    """Section 6: correct pixels in percent; None where nothing is valid."""
    total = sum(table.values())
    return 100 * sum(n for (t, p), n in table.items() if t == p) / total if total else None


def iou(table):
    """Section 6: {class: intersection over union in percent} of the classes in the truth."""
    result = {}
    for c in {t for t, _ in table}:
        both = table.get((c, c), 0)
        either = sum(n for (t, p), n in table.items() if c in (t, p))
        result[c] = 100 * both / either
    return result


def miou(table):
    """Section 6: the mean IoU over the classes that occur in the truth; None where none does."""
    values = iou(table).values()
    return sum(values) / len(values) if values else None


def flicker(images, valids):
    """Section 6: percent of the pixels valid in consecutive frames whose label differs."""
    both = differ = 0
    for i in range(1, len(images)):
        for before, now, ok, fine in zip(images[i - 1], images[i], valids[i - 1], valids[i]):
            if ok and fine:
                both += 1
                differ += before != now
    return 100 * differ / both if both else None


def entropy(p):
    """Section 6: entropy of {class: share} in nat."""
    return -sum(x * math.log(x) for x in p.values() if x > 0)


def regions(memory, n):
    """
    Section 6: the difficult regions that each voxel belongs to, {voxel: set of names}.

    The names are boundary, high_switch and difficult_core; n is the neighbourhood.

    """
    result = {}
    for voxel, history in memory.histories.items():
        names, p = set(), memory.share(voxel)
        majority = memory.majority(voxel)
        if any(memory.majority(u) != majority for u in memory.neighbours(voxel, n)):
            names.add('boundary')
        changes = sum(a.c != b.c for a, b in zip(history, history[1:]))
        if len(history) > 1 and exceeds(changes / (len(history) - 1), 0.3):
            names.add('high_switch')
        first, second = sorted([*p.values(), 0.0], reverse=True)[:2]
        hints = [exceeds(entropy(p), 0.5), exceeds(0.3, first - second),
                 'high_switch' in names, 'boundary' in names]
        if sum(hints) >= 2:
            names.add('difficult_core')
        result[voxel] = names
    return result
