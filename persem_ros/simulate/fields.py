"""Smooth random fields: a sum of waves whose correlation is a Gaussian of stated length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached


@dataclass(frozen=True, eq=False)
class Field:
    """
    A stationary random function of points with mean 0 and variance 1.

    Its correlation between two points is exp(-0.5 * sum((difference / length)**2)) over a draw
    of the field (random Fourier features).

    Attributes
    ----------
    waves : ndarray, shape (n, d)
        Wave vectors in turns per unit of each coordinate.
    phases : ndarray, shape (n,)
        In turns.

    """

    waves: NDArray[np.float32]
    phases: NDArray[np.float32]

    def __call__(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the field, shape (m,), at *points*, shape (m, d)."""
        out = np.empty(len(points), np.float32)
        sum_of_waves(points, self.waves, self.phases, out)
        return out


def make_field(rng: np.random.Generator, lengths: Sequence[float], waves: int = 32) -> Field:
    """
    Draw a Field from the generator *rng*.

    Parameters
    ----------
    rng : numpy.random.Generator
        Where the draw comes from.
    lengths : sequence of float, shape (d,)
        Correlation length along every coordinate, in its unit.
    waves : int
        Number of waves; more are closer to a Gaussian field and slower.

    """
    vectors = rng.standard_normal((waves, len(lengths)))
    vectors /= 2 * np.pi * np.asarray(lengths, float)
    return Field(vectors.astype(np.float32), rng.random(waves).astype(np.float32))


@cached
def sum_of_waves(points, waves, phases, out):
    """Write sqrt(2 / n) * sum_k wave(waves[k] . point + phases[k]) into *out*, (m,)."""
    count, dimensions = waves.shape
    scale = np.float32(np.sqrt(2.0 / count))
    half, one, eight = np.float32(0.5), np.float32(1.0), np.float32(8.0)
    sixteen, bend = np.float32(16.0), np.float32(0.224)
    turn, block = np.empty(256, np.float32), np.empty((dimensions, 256), np.float32)
    for start in range(0, len(points), 256):        # blocks: the inner loops become SIMD
        size = min(256, len(points) - start)
        total = out[start:start + size]
        for i in range(size):
            total[i] = np.float32(0.0)
            for j in range(dimensions):
                block[j, i] = points[start + i, j]
        for k in range(count):
            turn[:] = phases[k]
            for j in range(dimensions):
                factor, row = waves[k, j], block[j]
                for i in range(256):
                    turn[i] += factor * row[i]
            for i in range(size):
                # A sine by two parabolas: within 0.1 % of the true one, alike on every machine.
                part = turn[i] - np.floor(turn[i] + half)
                wave = part * (eight - sixteen * abs(part))
                total[i] += wave * (one - bend + bend * abs(wave))
        for i in range(size):
            total[i] *= scale
