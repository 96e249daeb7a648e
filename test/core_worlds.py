"""What the core's tests share: how many examples, random frames and bridges to the reference."""

import os
from functools import partial

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
import numpy as np

# A continuous-integration machine sees the same examples each time; a developer sees new ones.
examples = partial(settings, deadline=None, derandomize='CI' in os.environ,
                   suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])

# Ids on both ends of the range, and more of them than a voxel's own record has places for.
IDS = (0, 1, 2, 3, 5, 8, 13, 65533, 65534)
NO_IDS = (-1, -7, 65535, 70000)


def rotation(rng):
    """Return a random 3x3 rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def pose(rng, spread=3.0):
    """Return a random 4x4 pose whose position is within about *spread* metres."""
    T = np.eye(4)
    T[:3, :3] = rotation(rng)
    T[:3, 3] = rng.normal(scale=spread, size=3)
    return T


seeds = st.integers(0, 2 ** 32 - 1)
