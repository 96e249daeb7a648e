"""A segmenter's mistakes: anchored in the world, coming with the view, at borders, salt."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.core.jit import cached
from persem_ros.simulate import materials as mat
from persem_ros.simulate.fields import make_field

if TYPE_CHECKING:
    from persem_ros.simulate.render import View

# What a class is taken for: (class, its share of mistakes at difficulty 1, first wrong class,
# second wrong class). The share is that of a surface at DISTANCE seen at a right angle.
_CONFUSION = (
    (mat.GRASS, .19, mat.FIELD, mat.SHRUB), (mat.FIELD, .24, mat.GRASS, mat.PAVEMENT),
    (mat.ROAD, .20, mat.PAVEMENT, mat.BUILDING), (mat.PAVEMENT, .30, mat.ROAD, mat.BUILDING),
    (mat.BUILDING, .19, mat.PAVEMENT, mat.ROAD), (mat.TREE, .16, mat.SHRUB, mat.GRASS),
    (mat.SHRUB, .42, mat.TREE, mat.GRASS), (mat.WATER, .17, mat.ROAD, mat.GRASS),
    (mat.FENCE, .45, mat.SHRUB, mat.PAVEMENT), (mat.VEHICLE, .25, mat.BUILDING, mat.ROAD))
DISTANCE = 75.0     # metres


@dataclass(frozen=True)
class Mistakes:
    """
    How the segmenter errs; the defaults are calibrated and frozen (docs/simulator.md).

    A pixel is mistaken where a latent error, a sum of three smooth random fields of total
    variance 1, exceeds the threshold of its class, distance and angle. A field that only the
    world decides makes surfaces that look wrong from everywhere; near the threshold the other
    two make them come and go.

    Attributes
    ----------
    difficulty : float
        Factor on all shares of mistakes; 0: no mistake at all, 1: calibrated.
    world_length : float
        Correlation length of the field anchored in the world, metres.
    world_variance : float
        Its share of the variance.
    view_length, view_angle : float
        Correlation lengths of the field that depends on the view: along the surface, metres,
        and of the direction of view, degrees.
    view_variance : float
        Its share of the variance.
    flash_length : float
        Correlation length, as a share of the image's width, of the field that is new in every
        frame and has what is left of the variance.
    choice_length : float
        Correlation length of the choice between the two wrong classes, metres.
    far : float
        By how much the threshold falls per DISTANCE, standard deviations.
    slanted : float
        By how much it falls from a right angle to a grazing view, standard deviations.
    border : float
        Standard deviation of the shift of borders, as a share of the image's width.
    border_length : float
        Correlation length of that shift in the image, as a share of the width.
    salt : float
        Share of pixels of random class.

    """

    difficulty: float = 1.0
    world_length: float = 6.0
    world_variance: float = 0.70
    view_length: float = 4.0
    view_angle: float = 14.0
    view_variance: float = 0.20
    flash_length: float = 0.06
    choice_length: float = 10.0
    far: float = 0.25
    slanted: float = 0.35
    border: float = 0.0025
    border_length: float = 0.02
    salt: float = 0.006


class Segmenter:
    """
    Turns the truth of a view into what a segmenter would say.

    Parameters
    ----------
    rng : numpy.random.Generator
        For the fields anchored in the world.
    mistakes : Mistakes

    """

    def __init__(self, rng: np.random.Generator, mistakes: Mistakes) -> None:
        m = self.mistakes = mistakes
        turn = 2 * np.sin(np.radians(m.view_angle) / 2)     # of unit vectors: a chord
        self.world = make_field(rng, [m.world_length] * 3, 40)
        self.view = make_field(rng, [m.view_length] * 3 + [turn] * 3, 28)
        self.choice = make_field(rng, [m.choice_length] * 3, 20)
        self._threshold = np.full(256, np.inf, np.float32)
        self._wrong = np.tile(np.arange(256, dtype=np.uint8)[:, None], (1, 2))
        for label, share, *wrong in _CONFUSION:
            share = min(share * m.difficulty, 0.95)
            if share > 0:
                self._threshold[label] = NormalDist().inv_cdf(1 - share)
                self._wrong[label] = wrong

    def labels(
            self, view: View, origin: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """
        Return the labels of a frame, shape (H, W), uint8.

        Parameters
        ----------
        view : persem_ros.simulate.render.View
            Its labels are the truth.
        origin : ndarray, shape (3,)
            Where the camera is in the map, metres.
        rng : numpy.random.Generator
            For this frame alone.

        """
        m = self.mistakes
        if m.difficulty <= 0:
            return view.labels.copy()
        height, width = view.labels.shape
        points = view.points.reshape(-1, 3)
        seen = np.empty((len(points), 6), np.float32)
        distance = directions(points, np.asarray(origin, np.float32), seen)
        latent = np.sqrt(m.world_variance) * self.world(points)
        latent += np.sqrt(m.view_variance) * self.view(seen)
        rest = max(0.0, 1 - m.world_variance - m.view_variance)
        latent += np.sqrt(rest) * picture_noise(rng, height, width, m.flash_length).ravel()
        latent += m.far * (distance / DISTANCE - 1) + m.slanted * (1 - view.facing.ravel())
        labels = np.empty(len(points), np.uint8)
        mistake(view.labels.ravel(), latent, self.choice(points), self._threshold, self._wrong,
                labels)
        labels = shifted_borders(rng, labels.reshape(height, width), m.border * m.difficulty,
                                 m.border_length)
        _sprinkle(rng, labels, m.salt * m.difficulty)
        labels[view.labels == mat.VOID] = mat.VOID
        return labels


def picture_noise(
        rng: np.random.Generator, height: int, width: int, length: float) -> NDArray[np.float32]:
    """
    Return smooth noise over a picture, shape (height, width), float32: mean 0, variance 1.

    *length* is its correlation length as a share of the width: the correlation of two pixels is
    exp(-0.5 * (distance / length)**2).

    """
    # White noise blurred by s has a correlation of length sqrt(2) s. Drawn coarse, then enlarged.
    step = max(1, int(length * width / 4))
    sigma = length * width / np.sqrt(2) / step
    margin = int(np.ceil(4 * sigma))
    shape = height // step + 2 + 2 * margin, width // step + 2 + 2 * margin
    white = rng.standard_normal(shape, np.float32)
    smooth = cv2.GaussianBlur(white, (2 * margin + 1, 2 * margin + 1), sigma)
    # The blur leaves a variance of 1 / (4 pi sigma**2).
    smooth = smooth[margin:shape[0] - margin, margin:shape[1] - margin] \
        * np.float32(2 * np.sqrt(np.pi) * sigma)
    large = cv2.resize(smooth, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(large[:height, :width])


def shifted_borders(rng: np.random.Generator, labels: NDArray[np.uint8], strength: float,
                    length: float) -> NDArray[np.uint8]:
    """Return *labels* with borders shifted; both numbers are shares of the width."""
    height, width = labels.shape
    shift = [picture_noise(rng, height, width, length) * np.float32(strength * width)
             for _ in range(2)]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return np.asarray(cv2.remap(labels, x + shift[0], y + shift[1], cv2.INTER_NEAREST,
                                borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _sprinkle(rng: np.random.Generator, labels: NDArray[np.uint8], share: float) -> None:
    """Give single pixels, and the one to their right, a random class."""
    count = rng.poisson(share * labels.size / 2)
    at = rng.integers(0, labels.size - 1, count)
    wrong = np.array([row[0] for row in _CONFUSION], np.uint8)[
        rng.integers(0, len(_CONFUSION), count)]
    labels.reshape(-1)[at] = wrong
    labels.reshape(-1)[at + 1] = wrong


@cached
def directions(points, origin, out):
    """Write (point, unit vector from it to *origin*) into *out*, (n, 6); return distances."""
    distance = np.empty(len(points), np.float32)
    for i in range(len(points)):
        total = np.float32(0.0)
        for j in range(3):
            out[i, j] = points[i, j]
            out[i, 3 + j] = origin[j] - points[i, j]
            total += out[i, 3 + j] ** 2
        distance[i] = np.sqrt(total)
        for j in range(3, 6):
            out[i, j] /= max(distance[i], np.float32(1e-3))
    return distance


@cached
def mistake(truth, latent, choice, threshold, wrong, labels):
    """Write the class that each pixel is taken for."""
    for i in range(len(truth)):
        label = truth[i]
        if latent[i] > threshold[label]:
            labels[i] = wrong[label, 0] if choice[i] > np.float32(-0.35) else wrong[label, 1]
        else:
            labels[i] = label
