"""Reprojection: labels of voxels become a label image (spec section 5)."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.frame.place import NOWHERE, REACH
from persem_ros.core.jit import kernel, split
from persem_ros.core.memory.blocks import find_block
from persem_ros.core.memory.pools import SIDE
from persem_ros.frames import UNKNOWN

if TYPE_CHECKING:
    from persem_ros.core.frame.observe import Observations
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.settings.config import Memory


def voxel_image(
        memory: VoxelMemory, observations: Observations, shape: tuple[int, int]
) -> NDArray[np.int32]:
    """
    Return the voxel number of each pixel, shape *shape*, int32; -1: no depth or unknown.

    observations is what core.frame.observe.observe returned for the pixels' points.

    """
    numbers = memory.find(observations.voxels)
    image = np.empty(observations.where.shape, np.int32)
    split(_number, len(image), observations.where, numbers, image, grain=65536)
    return _present(memory, image).reshape(shape)


def voxel_image_of(memory: VoxelMemory, keys: NDArray[np.int64], base: NDArray[np.int64],
                   shape: tuple[int, int]) -> NDArray[np.int32]:
    """Return the same for pixels that were placed (core.frame.place) and not observed."""
    image = np.empty(len(keys), np.int32)
    split(_find, len(keys), memory.m.blocks, memory.table, keys, base, image, grain=32768)
    return _present(memory, image).reshape(shape)


def _present(memory: VoxelMemory, image: NDArray[np.int32]) -> NDArray[np.int32]:
    """Make voxels unknown whose content moved away, in place."""
    if memory.n_gone:
        split(hide_gone, len(image), memory.m.voxels, image, grain=65536)
    return image


def render(voxels: NDArray[np.int32], labels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """
    Return the label image of a voxel image.

    Parameters
    ----------
    voxels : ndarray, shape (h, w), int32
        Voxel numbers; -1: unknown.
    labels : ndarray, shape (voxels of the map,), uint16
        By voxel number.

    Returns
    -------
    ndarray, shape (h, w), uint16
        UNKNOWN (65535) where the map knows nothing.

    """
    voxels = np.require(voxels, np.int32, ('C', 'W'))
    labels = np.require(labels, np.uint16, ('C', 'W'))
    image = np.empty(voxels.shape, np.uint16)
    split(_label, voxels.size, voxels.reshape(-1), labels, image.reshape(-1), grain=65536)
    return image


def render_map(memory: VoxelMemory, voxels: NDArray[np.int32], source: bool = False,
               ) -> NDArray[np.uint16]:
    """Return the same by the map's own labels (or sources); only the pixels' voxels are read."""
    voxels = np.require(voxels, np.int32, ('C', 'W'))
    image = np.empty(voxels.shape, np.uint16)
    split(_label_of, voxels.size, voxels.reshape(-1), memory.m.voxels, source, image.reshape(-1),
          grain=65536)
    return image


def filled(image: NDArray[np.uint16], labels: NDArray[np.int32], settings: Memory,
           fill: str = 'input', unknown: int = UNKNOWN) -> NDArray[np.int32]:
    """
    Return the refined label image on the grid of the frame's labels, as int32.

    Parameters
    ----------
    image : ndarray, shape (h, w), uint16
        What render() returned, on the depth grid.
    labels : ndarray, shape (H, W), int32
        The frame's own labels.
    settings : persem_ros.settings.config.Memory
        Dynamic labels pass through unchanged.
    fill : {'input', 'unknown'}
        What a pixel gets that the map does not know: its own label or *unknown*.
    unknown : int
        The ignored id.

    """
    labels = np.require(labels, np.int32, ('C', 'W'))
    image = np.ascontiguousarray(nearest(image, labels.shape))
    result = np.empty(labels.shape, np.int32)
    moving = np.array([c for c in settings.dynamic_labels if c >= 0], np.int32)
    split(_fill, labels.size, image.reshape(-1), labels.reshape(-1), moving, fill == 'input',
          unknown, result.reshape(-1), grain=1 << 20)
    return result


def nearest(image: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Return *image* on a grid of another size, nearest pixel."""
    (h, w), (H, W) = image.shape, shape
    if (h, w) == (H, W):
        return image
    rows = np.minimum(((np.arange(H) + 0.5) * h / H).astype(np.int64), h - 1)
    columns = np.minimum(((np.arange(W) + 0.5) * w / W).astype(np.int64), w - 1)
    return image[rows[:, None], columns[None, :]]


@kernel
def _number(begin, end, where, numbers, image):
    """Write the voxel number of each point."""
    for p in range(begin, end):
        g = where[p]
        image[p] = numbers[g] if g >= 0 else -1


@kernel
def _find(begin, end, blocks, table, keys, base, image):
    """Write the voxel number of each key (core.frame.place)."""
    b = np.int64(-1)
    oi, oj, ok = np.int64(1 << 40), np.int64(0), np.int64(0)
    for p in range(begin, end):
        key = keys[p]
        image[p] = -1
        if key == NOWHERE:
            continue
        i = (key >> 42) - REACH + base[0]
        j = (key >> 21 & 0x1fffff) - REACH + base[1]
        k = (key & 0x1fffff) - REACH + base[2]
        if i >> 3 != oi or j >> 3 != oj or k >> 3 != ok:    # most follow one of the same block
            oi, oj, ok = i >> 3, j >> 3, k >> 3
            b = find_block(blocks, table, oi, oj, ok)
        if b >= 0:
            cells = blocks[b].cells
            image[p] = np.int64(cells[((i & 7) * SIDE + (j & 7)) * SIDE + (k & 7)]) - 1


@kernel
def hide_gone(begin, end, voxels, image):
    """Write -1 for voxels whose content moved away."""
    for p in range(begin, end):
        if image[p] >= 0 and voxels[image[p]].gone > 0:
            image[p] = -1


@kernel
def _label_of(begin, end, image, voxels, source, out):
    """Write the label, or the source of the label, of each pixel's voxel."""
    for p in range(begin, end):
        v = image[p]
        if v < 0:
            out[p] = UNKNOWN
        else:
            out[p] = voxels[v].source if source else voxels[v].label


@kernel
def _label(begin, end, voxels, labels, image):
    """Write the label of each pixel's voxel."""
    for p in range(begin, end):
        v = voxels[p]
        image[p] = labels[v] if v >= 0 else UNKNOWN


@kernel
def _fill(begin, end, image, labels, moving, by_input, unknown, out):
    """Write what filled() returns, by loops that the compiler turns into vector instructions."""
    image, labels, out = image[begin:end], labels[begin:end], out[begin:end]
    if by_input:
        for p in range(len(image)):
            out[p] = labels[p] if image[p] == UNKNOWN else np.int32(image[p])
    else:
        for p in range(len(image)):
            out[p] = np.int32(unknown) if image[p] == UNKNOWN else np.int32(image[p])
    for d in moving:
        for p in range(len(image)):
            out[p] = d if labels[p] == d else out[p]
