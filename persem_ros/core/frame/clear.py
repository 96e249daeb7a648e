"""
Clearing what moved away: voxels through which later frames look (spec section 10, *Clearing*).

A thing that was mapped and drove off leaves voxels behind which everything is measured from then
on. Looks through a voxel since its last observation are counted, one a second; where they are
enough the voxel is gone: it is not shown and no neighbour, but keeps its history, and one new
observation makes it present again.

"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.core.frame.view import View, warp_of
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.blocks import block_numbers
from persem_ros.core.memory.pools import CLOCK, ROWS, SIDE
from persem_ros.core.memory.records import mark

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Frame
    from persem_ros.settings.config import Memory

SLACK = 1e-9            # metres: what is nearer than this to a bound is not decided early


def clear(memory: VoxelMemory, frame: Frame, settings: Memory) -> int:
    """
    Count looks through voxels; return how many became gone. Call it after VoxelMemory.add().

    A voxel is seen through when its 8 corners project in front of the camera and into the depth
    image, at least half (and one) of the pixels of their bounding rectangle are measured (finite,
    min_depth or more), and all of these lie farther than the farthest corner's z by more than
    clear_margin voxels and clear_slope of that z. Labelled clouds have no such pixels.

    Parameters
    ----------
    memory : core.memory.voxel_memory.VoxelMemory
        The map; with a pager, the blocks in view come into memory.
    frame : persem_ros.frames.Frame
        All its pixels count, whatever the stride.
    settings : persem_ros.settings.config.Memory
        clear_after (0: nothing is done), clear_margin, clear_slope, clear_range, min_depth.

    """
    if not settings.clear_after or frame.points is not None:
        return 0
    view = View(frame, memory, settings.clear_range)
    index = view.blocks()
    if memory.pager is not None:
        memory.pager.need(index)
    numbers = block_numbers(memory, index)
    numbers = numbers[numbers >= 0]
    margin = settings.clear_margin * memory.voxel_size
    limits = np.array([max(settings.min_depth, np.nextafter(0.0, 1.0)), settings.clear_range,
                       margin, settings.clear_slope])
    memory.some_passed = True
    memory.m.used[CLOCK] += 1
    went: list[Any] = split(
        look_through, len(numbers), memory.m.blocks, memory.m.voxels, memory.m.stamps,
        memory.store.passed, memory.store.beliefs, numbers, view.depth, warp_of(frame.camera),
        view.turn, view.shift, view.lens, limits, settings.clear_after,
        frame.stamp // 1_000_000_000, memory.clock, grain=64)
    memory.n_gone += sum(went)
    return int(sum(went))


@kernel
def look_through(begin, end, blocks, voxels, stamps, passed, beliefs, numbers, depth, warp, turn,
                 shift, lens, limits, after, second, now):
    """Count the looks through the voxels of blocks numbers[begin:end]; return how many went."""
    least, far, margin, slope = limits
    fx, fy, cx, cy = lens
    ax, bx, kx, ay, by, ky = turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2]
    az, bz, kz = turn[2, 0], turn[2, 1], turn[2, 2]
    reach = 0.5 * (abs(az) + abs(bz) + abs(kz))
    behind, lead = reach + margin + slope * reach - SLACK, 1.0 + slope
    nearest, farthest = max(reach - SLACK, 0.0), far - reach + SLACK
    (h, w), went, warped = depth.shape, 0, len(warp) > 0
    for p in range(begin, end):
        b = numbers[p]
        cells, index = blocks[b].cells, blocks[b].index
        for row in range(ROWS):
            i = np.int64(index[0]) * SIDE + (row >> 3)
            j = np.int64(index[1]) * SIDE + (row & 7)
            k = np.int64(index[2]) * SIDE
            x0 = ax * (i + 0.5) + bx * (j + 0.5) + kx * (k + 0.5) + shift[0]
            y0 = ay * (i + 0.5) + by * (j + 0.5) + ky * (k + 0.5) + shift[1]
            z0 = az * (i + 0.5) + bz * (j + 0.5) + kz * (k + 0.5) + shift[2]
            for cell in range(SIDE):
                v = np.int64(cells[np.uint64(row * SIDE + cell)]) - 1
                if v < 0:
                    continue
                z = z0 + kz * cell
                if not nearest < z <= farthest:
                    continue
                # Most voxels are at the surface: their middle's own pixel says so.
                u, m = fx * (x0 + kx * cell) / z + cx, fy * (y0 + ky * cell) / z + cy
                if not (u >= -0.5 and m >= -0.5 and u < w - 0.5 and m < h - 0.5):
                    continue
                if not warped:
                    d = depth[np.uint64(m + 0.5), np.uint64(u + 0.5)]
                    if least <= d <= lead * z + behind:
                        continue
                if not seen_through(i, j, k + cell, depth, warp, turn, shift, lens, limits):
                    continue
                voxel, record = voxels[v], passed[v]
                if voxel.gone:
                    continue
                if record.n != voxel.n:
                    record.n = voxel.n
                    record.count = 0
                elif record.second == second:
                    continue
                record.second = second
                record.count += 1
                stamps[b].stored = now
                if record.count >= after and 10 * np.int64(record.count) >= np.int64(voxel.n):
                    voxel.gone = 1
                    voxel.label = voxel.majority
                    voxel.source = 0
                    beliefs[v].posterior = 0.0
                    mark(blocks[b], stamps[b], now, i, j, k + cell)
                    went += 1
    return went


@inlined
def seen_through(i, j, k, depth, warp, turn, shift, lens, limits):
    """Return whether all that is measured around voxel (i, j, k) lies behind it."""
    least, far, margin, slope = limits
    farthest = 0.0
    u0 = v0 = np.inf
    u1 = v1 = -np.inf
    for corner in range(8):
        a, b, c = i + (corner >> 2), j + (corner >> 1 & 1), k + (corner & 1)
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + shift[2]
        if not 0.0 < z <= far:
            return False
        x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + shift[0]
        y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + shift[1]
        inside, u, v = project(x, y, z, lens, warp, depth)
        if not inside:
            return False
        farthest = max(farthest, z)
        u0, u1 = min(u0, u), max(u1, u)
        v0, v1 = min(v0, v), max(v1, v)
    bound, measured, total = farthest + margin + slope * farthest, 0, 0
    for v in range(np.int64(v0 + 0.5), np.int64(v1 + 0.5) + 1):
        for u in range(np.int64(u0 + 0.5), np.int64(u1 + 0.5) + 1):
            total += 1
            d = depth[v, u]
            if d >= least and d < np.inf:
                if not d > bound:
                    return False
                measured += 1
    return measured > 0 and 2 * measured >= total


@inlined
def project(x, y, z, lens, warp, depth):
    """Return whether a point in front of the camera has a pixel, and its u and v."""
    u, v = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
    h, w = depth.shape
    inside = u >= -0.5 and v >= -0.5 and u < w - 0.5 and v < h - 0.5
    if inside and len(warp):
        at_u, at_v = min(max(np.int64(u), 0), w - 2), min(max(np.int64(v), 0), h - 2)
        a, b = u - at_u, v - at_v
        low, high = warp[at_v], warp[at_v + 1]
        p, q = low[at_u], low[at_u + 1]
        r, s = high[at_u], high[at_u + 1]
        u = (1 - a) * (1 - b) * p[0] + a * (1 - b) * q[0] + (1 - a) * b * r[0] + a * b * s[0]
        v = (1 - a) * (1 - b) * p[1] + a * (1 - b) * q[1] + (1 - a) * b * r[1] + a * b * s[1]
        inside = u >= -0.5 and v >= -0.5 and u < w - 0.5 and v < h - 0.5
    return inside, u, v
