"""Which way is up: a map's axes as i, j and the k that points up (refine.up)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Up(NamedTuple):
    """
    Places of i, j, k among x, y, z, and whether k is counted downwards.

    Axes that are turned round count from -1 down, so that blocks stay blocks.

    """

    i: int
    j: int
    k: int
    down: bool


AS_IT_IS = Up(0, 1, 2, False)


def up_of(name: str) -> Up:
    """Return the Up of a value of refine.up: x, y, z, -x, -y or -z."""
    k = 'xyz'.index(name[-1])
    i, j = (axis for axis in range(3) if axis != k)
    return Up(i, j, k, name[0] == '-')


def upright(index: NDArray[np.int32], up: Up) -> NDArray[np.int32]:
    """Return indices (n, 3) of voxels or blocks as (i, j, k) with k up."""
    if up == AS_IT_IS:
        return index
    turned = index[:, [up.i, up.j, up.k]]
    if up.down:
        turned[:, 2] = -1 - turned[:, 2]
    return np.ascontiguousarray(turned)
