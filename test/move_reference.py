"""
Moved histories in plain Python (spec section 10, *Corrected trajectories*): dicts and lists.

A frame is (placed, best), two 4x4 matrices; a voxel a tuple; what was seen {voxel: [(f, c, s,
offset), ...]} with f the row of the frame table and the offset three numbers, 256ths of an edge.

"""

from collections import defaultdict
import math

import numpy as np
from reference import TIE


def place(voxel, offset, K, size):
    """Return the voxel of a moved point and its offset there, as fractions of an edge."""
    x = [(i + (o + 0.5) / 256) * size for i, o in zip(voxel, offset)]
    at = [(K[a][0] * x[0] + K[a][1] * x[1] + K[a][2] * x[2] + K[a][3]) / size for a in range(3)]
    low = [math.floor(a) for a in at]
    # in 65536ths: what is counted in whole numbers has no order of summation
    return tuple(low), tuple(min(int((a - i) * 65536), 65535) for a, i in zip(at, low))


def inverse(T):
    """Return the inverse of a rigid transform."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return result


def best_label(labels, shares):
    """Return the label with the largest sum of shares, a tie to the smaller, and that sum."""
    sums = defaultdict(float)
    for c, s in zip(labels, shares):
        sums[c] += s
    most = max(sums.values())
    best = min(c for c, total in sums.items() if most - total <= TIE)
    return best, sums[best]


def moved(seen, frames, rows, size):
    """
    Return what was seen and the placed poses after frames *rows* took their best poses.

    Observations of a frame that meet in a voxel become one; a frame of which no observation
    leaves its voxel stays as it is.

    """
    K = {f: frames[f][1] @ inverse(frames[f][0]) for f in rows}
    leaves = {f for voxel, history in seen.items() for f, _, _, offset in history
              if f in K and place(voxel, offset, K[f], size)[0] != voxel}
    meeting = defaultdict(list)
    for voxel in sorted(seen):
        for f, c, s, offset in seen[voxel]:
            if f in leaves:
                there, where = place(voxel, offset, K[f], size)
            else:
                there, where = voxel, tuple(256 * o for o in offset)
            meeting[there, f].append((c, s, where))
    result = defaultdict(list)
    for (voxel, f), several in sorted(meeting.items(), key=lambda item: item[0][1]):
        c, total = best_label([c for c, _, _ in several], [s for _, s, _ in several])
        offset = tuple(sum(where[a] for _, _, where in several) // (256 * len(several))
                       for a in range(3))
        share = several[0][1] if len(several) == 1 else float(np.float32(total / len(several)))
        result[voxel].append((f, c, share, offset))
    return dict(result), [best if f in leaves else placed
                          for f, (placed, best) in enumerate(frames)]
