"""The noun path: where the aircraft's body is at any time; a lawn-mower pattern with turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TICK = 0.05         # seconds between the knots of the path


@dataclass(frozen=True, eq=False)
class Path:
    """
    A smooth flight, from time 0 on.

    Attributes
    ----------
    knots : ndarray, shape (n, 6)
        x, y, z in metres, roll, pitch, yaw in radians, every TICK seconds, the first one TICK
        before time 0.

    """

    knots: NDArray[np.float64]

    @property
    def duration(self) -> float:
        """Return the last time, in seconds, at which the path is known."""
        return (len(self.knots) - 4) * TICK

    def body(self, time: float) -> NDArray[np.float64]:
        """Return T_map_body, 4x4, at *time* in seconds; x forward, y left, z up."""
        x, y, z, roll, pitch, yaw = self._at(time)
        T = np.eye(4)
        T[:3, :3] = rotation(roll, pitch, yaw)
        T[:3, 3] = x, y, z
        return T

    def _at(self, time: float) -> NDArray[np.float64]:
        """Interpolate the knots by a cubic B-spline: no jump in velocity or acceleration."""
        k = min(max(int(time / TICK), 0), len(self.knots) - 4)
        u = time / TICK - k
        weights = np.array([(1 - u) ** 3, 3 * u ** 3 - 6 * u ** 2 + 4,
                            -3 * u ** 3 + 3 * u ** 2 + 3 * u + 1, u ** 3]) / 6
        return weights @ self.knots[k:k + 4]


def rotation(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the 3x3 rotation Rz(yaw) Ry(pitch) Rx(roll), radians."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])


def make_path(
        rng: np.random.Generator, duration: float, height: float, speed: float, leg: float = 92.0,
        spacing: float = 30.0, lines: int = 3, middle: float = -32.0) -> Path:
    """
    Return the Path of a survey.

    Parallel legs along x, joined by half circles, *lines* of them, then the same way back, and
    so on: a long flight comes back to what it saw.

    Parameters
    ----------
    rng : numpy.random.Generator
        For gusts.
    duration : float
        Seconds.
    height : float
        Metres above z = 0.
    speed : float
        Metres per second.
    leg, spacing : float
        Length of a leg and distance of two legs, metres.
    lines : int
        Legs until the pattern repeats.
    middle : float
        x of the middle of the legs, metres.

    """
    count = int(np.ceil(duration / TICK)) + 6
    smooth = max(1.0, 0.3 * spacing / speed)        # seconds over which a turn begins
    margin = int(4 * smooth / TICK)
    time = (np.arange(-margin, count + margin, dtype=np.float64) - 1) * TICK
    x, y, heading = _pattern(time * speed + 0.5 * speed, leg, spacing, lines)
    kernel = np.exp(-0.5 * (np.arange(-margin, margin + 1, dtype=np.float64) * TICK / smooth) ** 2)
    x, y, yaw = (np.convolve(v, kernel / kernel.sum(), 'valid') for v in (x, y, heading))
    time = time[margin:-margin]
    bank = -np.arctan(speed * np.gradient(yaw, TICK) / 9.81) * 0.6     # the gimbal takes the rest
    x = x + middle
    z = height + gusts(rng, time, 0.6, (7.0, 13.0))
    roll = bank + gusts(rng, time, np.radians(1.2), (1.9, 3.1, 5.3))
    pitch = gusts(rng, time, np.radians(1.0), (2.3, 3.7, 6.1)) + np.radians(1.5)
    yaw = yaw + gusts(rng, time, np.radians(0.9), (4.1, 7.9))
    return Path(np.column_stack([x, y, z, roll, pitch, yaw]))


def _pattern(
        way: NDArray[np.float64], leg: float, spacing: float, lines: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return (x, y, heading) at the distances *way* along the pattern, sharp where legs end."""
    bend = np.pi * spacing / 2
    number = np.floor(way / (leg + bend)).astype(int)
    rest = way - number * (leg + bend)
    line, turned = _lines(number, lines)
    side = np.where(number % 2 == 0, 1, -1)             # +1: flown eastwards
    angle = np.clip((rest - leg) / (spacing / 2), 0, np.pi)
    along = np.minimum(rest, leg) - leg / 2
    step = np.where((number // (lines - 1)) % 2 == 0, 1, -1)      # +1: to the next line north
    x = side * (along + spacing / 2 * np.sin(angle))
    y = (line - (lines - 1) / 2) * spacing + step * spacing / 2 * (1 - np.cos(angle))
    return x, y, turned + side * step * angle


def _lines(number: NDArray[np.int64], lines: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the line, 0 .. lines - 1, of leg *number*, and the heading turned until there."""
    period = 2 * (lines - 1)
    phase = number % period
    line = np.where(phase < lines, phase, period - phase)
    first = min(int(number.min()), 0)
    each = np.arange(first, int(number.max()) + 1)
    step = np.where((each // (lines - 1)) % 2 == 0, 1, -1)
    side = np.where(each % 2 == 0, 1, -1)
    turned = np.concatenate([[0.0], np.cumsum(np.pi * side * step)])
    turned -= turned[-first]
    return line, turned[number - first]


def gusts(rng: np.random.Generator, time: NDArray[np.float64], strength: float,
          periods: tuple[float, ...]) -> NDArray[np.float64]:
    """Return a smooth wobble of standard deviation *strength* at *time*, periods in seconds."""
    phase = rng.uniform(0, 2 * np.pi, len(periods))
    waves = [np.sin(2 * np.pi * time / period + p) for period, p in zip(periods, phase)]
    return strength * np.sqrt(2 / len(periods)) * np.sum(waves, axis=0)
