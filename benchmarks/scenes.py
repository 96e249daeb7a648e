"""What the benchmarks measure on: a simulated flight and maps of any size."""

from dataclasses import replace

import numpy as np
from persem_ros.core.frame.images import backprojected
from persem_ros.core.frame.observe import Observations
from persem_ros.core.transforms import transformed
from persem_ros.settings.config import Config
from persem_ros.simulate.flight import Flight, Plan

SIZE = 640, 480
LARGE = 2448, 2048      # of a survey camera
CLASSES, MANY = 16, 150


def flight(frames, rate):
    """Return a Plan of 640 x 480 images that touch about 40 000 voxels of 0.5 m each."""
    return Plan(frames=frames, width=SIZE[0], height=SIZE[1], rate=rate)


def large(frames):
    """Return a Plan of the same view through a survey camera."""
    return Plan(frames=frames, width=LARGE[0], height=LARGE[1], rate=3.0)


def frames(plan):
    """Yield the flight's frames with 16 classes: every class is split in two by 40 m squares."""
    for frame in Flight(plan, workers=1).frames():
        i, j = squares(frame, 40.0)
        labels = frame.labels % (CLASSES // 2) + CLASSES // 2 * ((i + j) % 2 == 1)
        yield replace(frame, labels=np.where(frame.labels >= 0, labels, -1).astype(np.int32),
                      color=None, truth=None)


def with_many(frame):
    """Return one of these frames with up to 150 classes: 20 m squares split each anew."""
    i, j = squares(frame, 20.0)
    labels = (frame.labels + CLASSES * ((7 * i + 5 * j) % 12)) % MANY
    return replace(frame, labels=np.where(frame.labels >= 0, labels, -1).astype(np.int32))


def squares(frame, size):
    """Return the indices i, j, each (h, w) int64, of the squares of *size* m that pixels show."""
    points = backprojected(frame, Config().memory)
    where = transformed(points, frame.T_map_camera)
    index = np.floor(np.nan_to_num(where[:, :2]) / size).astype(np.int64)
    return (column.reshape(frame.labels.shape) for column in index.T)


def fill(memory, voxels, at=100_000):
    """Add observations of far away voxels, a plane two voxels thick, until there are *voxels*."""
    side, first = 1024, 0
    while memory.n_voxels < voxels:
        n = min(2 * side * side // 8, voxels - memory.n_voxels)
        index = np.arange(first, first + n)
        place = np.stack([at + index // 2 // side, index // 2 % side, index % 2], axis=1)
        memory.add(Observations(
            place.astype(np.int32), (index % CLASSES).astype(np.uint16),
            np.ones(n, np.float32), np.empty(0, np.int32), np.arange(CLASSES, dtype=np.uint16),
            -1 - first, np.eye(4), 'far'))
        first += n
