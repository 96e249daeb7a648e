"""The shape of a place: how its surroundings lie, from which of the 5 x 5 x 5 are occupied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import inlined, kernel, split
from persem_ros.core.memory.blocks import hash3
from persem_ros.core.memory.evidence import TIE
from persem_ros.core.memory.pools import SIDE

TILTS = 0.5, 0.9            # |z| of the normal: upright, sloping, level
ROUGHNESS = 0.02, 0.06      # least share of the spread: smooth, rough, scattered
LEVELS = 3                  # of roughness
NO_TILT = 3                 # the fourth tilt: there is no normal
FEWEST = 4                  # occupied voxels that make a shape
RADIUS = 2
KNOWN = 1 << 13             # surroundings remembered
WIDE = SIDE + 2 * RADIUS
LANES = 64          # covariances that are turned side by side, a number of all in a row
XX, YY, ZZ, XY, XZ, YZ, TRACE, VX, VY, VZ, LEFT = range(0, 11 * LANES, LANES)


def shapes_of(blocks: NDArray[np.void], occupied: NDArray[np.uint8], block: NDArray[np.int64],
              cell: NDArray[np.int64], axis: int) -> NDArray[np.uint8]:
    """
    Return tilt * 3 + roughness of each voxel.

    Parameters
    ----------
    blocks : ndarray, core.memory.pools.BLOCK
        The map's blocks.
    occupied : ndarray, shape (blocks, 64), uint8
        A bit per cell, in rows of 8 along z: the voxels that count.
    block, cell : ndarray, shape (n,), int64
        The voxels, those of a block together.
    axis : int
        Which axis points up or down.

    """
    result = np.empty(len(block), np.uint8)
    split(describe, len(block), blocks, occupied, block, cell, axis, result)
    return result


@kernel
def occupy(block, cell, occupied):
    """Set the bits of the given voxels in occupied (blocks, 64)."""
    for r in range(len(block)):
        occupied[block[r], cell[r] >> 3] |= np.uint8(1 << (cell[r] & 7))


@kernel
def describe(begin, end, blocks, occupied, block, cell, axis, shape):
    """Write tilt * 3 + roughness of voxels begin .. end."""
    around = np.zeros((WIDE, WIDE), np.int64)       # rows of bits along z, two more on each side
    number, first, second = np.zeros(32, np.int64), np.zeros(32, np.int64), np.zeros(32, np.int64)
    for bits in range(32):
        for z in range(5):
            if bits >> z & 1:
                number[bits] += 1
                first[bits] += z - RADIUS
                second[bits] += (z - RADIUS) * (z - RADIUS)
    # Surroundings repeat: what came of the last ones with the same hash is at hand.
    known, result = np.zeros((KNOWN, 2), np.int64), np.zeros(KNOWN, np.uint8)
    # Those whose directions are to be found, side by side.
    spreads, found = np.empty(11 * LANES), np.empty(LANES, np.uint8)
    rows, places, patterns = (np.empty(LANES, np.int64), np.empty(LANES, np.int64),
                              np.empty((LANES, 2), np.int64))
    here, waiting = np.int64(-1), 0
    for r in range(begin, end):
        if block[r] != here:
            here = block[r]
            surround(blocks[here], occupied, around)
        x, y, z = cell[r] >> 6, cell[r] >> 3 & 7, cell[r] & 7
        low, high = pattern(around, x, y, z)
        place = np.int64(hash3(low, high, 0) & np.uint64(KNOWN - 1))
        if known[place, 0] == low and known[place, 1] == high:
            shape[r] = result[place]
            continue
        n, sx, sy, sz = 0, 0, 0, 0
        xx, yy, zz, xy, xz, yz = 0, 0, 0, 0, 0, 0
        for dx in range(-RADIUS, RADIUS + 1):
            for dy in range(-RADIUS, RADIUS + 1):
                bits = around[x + dx + RADIUS, y + dy + RADIUS] >> z & 31
                m, s = number[bits], first[bits]
                n += m
                sx += dx * m
                sy += dy * m
                sz += s
                xx += dx * dx * m
                yy += dy * dy * m
                zz += second[bits]
                xy += dx * dy * m
                xz += dx * s
                yz += dy * s
        if n < FEWEST:
            known[place, 0], known[place, 1] = low, high
            shape[r] = result[place] = NO_TILT * LEVELS
            continue
        # n^2 times the covariance: whole numbers, so that only what follows is rounded.
        spreads[XX + waiting] = n * xx - sx * sx
        spreads[YY + waiting] = n * yy - sy * sy
        spreads[ZZ + waiting] = n * zz - sz * sz
        spreads[XY + waiting] = n * xy - sx * sy
        spreads[XZ + waiting] = n * xz - sx * sz
        spreads[YZ + waiting] = n * yz - sy * sz
        rows[waiting], places[waiting] = r, place
        patterns[waiting, 0], patterns[waiting, 1] = low, high
        waiting += 1
        if waiting == LANES:
            find_shapes(waiting, spreads, axis, found)
            for k in range(waiting):
                known[places[k], 0], known[places[k], 1] = patterns[k, 0], patterns[k, 1]
                shape[rows[k]] = result[places[k]] = found[k]
            waiting = 0
    find_shapes(waiting, spreads, axis, found)
    for k in range(waiting):
        shape[rows[k]] = found[k]


@inlined
def pattern(around, x, y, z):
    """Return which of the 5 x 5 x 5 cells are occupied, 125 bits in two numbers, never 0."""
    low, high = np.int64(0), np.int64(0)
    for line in range(12):
        low = low << 5 | (around[x + line // 5, y + line % 5] >> z & 31)
    for line in range(12, 24):
        high = high << 5 | (around[x + line // 5, y + line % 5] >> z & 31)
    last = around[x + 4, y + 4] >> z & 31
    return low | (last & 7) << 60, high | (last >> 3) << 60


@inlined
def surround(block, occupied, around):
    """Gather the bits of a block and of two cells around it on all sides."""
    near = block.near
    for x in range(WIDE):
        for y in range(WIDE):
            column = (((x + SIDE - RADIUS) >> 3) * 3 + ((y + SIDE - RADIUS) >> 3)) * 3
            row = ((x - RADIUS) & 7) * SIDE + ((y - RADIUS) & 7)
            bits = np.int64(0)
            below, own, above = near[column], near[column + 1], near[column + 2]
            if below and np.int64(below) <= len(occupied):
                bits |= np.int64(occupied[np.int64(below) - 1, row]) >> 6
            if own and np.int64(own) <= len(occupied):
                bits |= np.int64(occupied[np.int64(own) - 1, row]) << 2
            if above and np.int64(above) <= len(occupied):
                bits |= (np.int64(occupied[np.int64(above) - 1, row]) & 3) << 10
            around[x, y] = bits


@kernel
def find_shapes(n, spreads, axis, found):
    """
    Write tilt * 3 + roughness of n covariances: Jacobi's method, to the last bits.

    They are turned side by side and without branches, which the compiler makes vector instructions
    of (places in one array at fixed distances, lest it fear that arrays overlap): 26 700 shapes
    take 6.1 ms in place of 10.5 in all. Whoever is done is left as it is.

    """
    for k in range(n):
        spreads[TRACE + k] = spreads[XX + k] + spreads[YY + k] + spreads[ZZ + k]
        spreads[VX + k] = 1.0 * (axis == 0)
        spreads[VY + k] = 1.0 * (axis == 1)
        spreads[VZ + k] = 1.0 * (axis == 2)
    for _ in range(30):
        left = 0.0
        for k in range(n):
            xy, xz, yz = spreads[XY + k], spreads[XZ + k], spreads[YZ + k]
            far = xy * xy + xz * xz + yz * yz > 1e-34 * spreads[TRACE + k] * spreads[TRACE + k]
            spreads[LEFT + k] = 1.0 if far else 0.0
        for k in range(n):
            left = max(left, spreads[LEFT + k])
        if left == 0.0:
            break
        turn(n, spreads, XX, YY, XY, XZ, YZ, VX, VY)
        turn(n, spreads, XX, ZZ, XZ, XY, YZ, VX, VZ)
        turn(n, spreads, YY, ZZ, YZ, XY, XZ, VY, VZ)
    for k in range(n):
        found[k] = tilt_and_roughness(
            spreads[XX + k], spreads[YY + k], spreads[ZZ + k], spreads[VX + k], spreads[VY + k],
            spreads[VZ + k], spreads[TRACE + k])


@inlined
def turn(n, spreads, p, q, pq, pr, qr, vp, vq):
    """Take away the element pq of n matrices by a rotation; vp and vq turn with it."""
    for k in range(n):
        a, b, ab = spreads[p + k], spreads[q + k], spreads[pq + k]
        ar, br, va, vb = spreads[pr + k], spreads[qr + k], spreads[vp + k], spreads[vq + k]
        theta = (b - a) / (2.0 * ab)
        t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
        t = -t if theta < 0.0 else t
        c = 1.0 / np.sqrt(t * t + 1.0)
        s = t * c
        turned = (spreads[LEFT + k] > 0.0) & (ab != 0.0)
        spreads[p + k] = a - t * ab if turned else a
        spreads[q + k] = b + t * ab if turned else b
        spreads[pq + k] = 0.0 if turned else ab
        spreads[pr + k] = c * ar - s * br if turned else ar
        spreads[qr + k] = s * ar + c * br if turned else br
        spreads[vp + k] = c * va - s * vb if turned else va
        spreads[vq + k] = s * va + c * vb if turned else vb


@inlined
def tilt_and_roughness(xx, yy, zz, vx, vy, vz, trace):
    """
    Return the class of a covariance that lies along the axes.

    v* is the row of the eigenvectors that belongs to the axis that points up.

    """
    if trace == 0.0:
        return NO_TILT * LEVELS
    if yy < xx:
        xx, yy, vx, vy = yy, xx, vy, vx
    if zz < xx:
        xx, zz, vx, vz = zz, xx, vz, vx
    least, next_least, up = max(xx, 0.0), min(yy, zz), abs(vx)
    share = least / trace
    roughness = 1 * (ROUGHNESS[0] + TIE < share) + 1 * (ROUGHNESS[1] + TIE < share)
    if next_least - xx <= 1e-6 * trace:
        return NO_TILT * LEVELS + roughness
    return (1 * (TILTS[0] + TIE < up) + 1 * (TILTS[1] + TIE < up)) * LEVELS + roughness
