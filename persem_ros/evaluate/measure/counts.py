"""What all measures are made of: pixels by class, changes, by region; in blocks of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from persem_ros.core.refine.regions import REGIONS
from persem_ros.outputs.results.counting import CODES
from persem_ros.outputs.results.tally import codes_of, EVERYWHERE

PLACES = (EVERYWHERE, *REGIONS)     # where is measured; the order of all arrays by region
ROOM = 16                           # classes at first; doubled when there are more


class Counts:
    """
    What all measures are made of, for methods on voxels and on images together.

    Parameters
    ----------
    methods : int
        Number of methods, those on images first.
    images : int
        Number of methods on images.

    Attributes
    ----------
    matrix : ndarray, shape (methods, CODES, classes, classes)
        Pixels by method, region code, true and predicted class.
    changed : ndarray, shape (methods + 1, CODES)
        Pixels whose label changed; the last row is the truth's.
    pairs, true_pairs, pixels : ndarray, shape (CODES,)
        Pixels that were compared, whose truth was compared, that were valid.

    """

    def __init__(self, methods: int, images: int, classes: int = ROOM) -> None:
        self.methods, self.n_images, self.size = methods, images, classes
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.matrix = np.zeros((self.methods, CODES, self.size, self.size), np.int64)
        self.changed = np.zeros((self.methods + 1, CODES), np.int64)
        self.pairs, self.true_pairs, self.pixels = np.zeros((3, CODES), np.int64)

    def grow(self, size: int) -> None:
        """Make room for more classes."""
        old, self.size = self.matrix, size
        self.matrix = np.zeros((self.methods, CODES, size, size), np.int64)
        self.matrix[:, :, :old.shape[2], :old.shape[3]] = old


@dataclass(eq=False)
class Block:
    """
    Counts by region of PLACES instead of by code.

    Attributes
    ----------
    hits, predicted : ndarray, shape (places, methods, classes)
        Pixels that were right and that were predicted, by class.
    true : ndarray, shape (places, classes)
        Pixels by true class.
    changed : ndarray, shape (places, methods + 1)
    pairs, true_pairs, pixels : ndarray, shape (places,)
    matrix : ndarray, shape (methods, classes, classes)
        Everywhere, by true and predicted class.

    """

    FIELDS = ('hits', 'predicted', 'true', 'changed', 'pairs', 'true_pairs', 'pixels')

    hits: NDArray[np.int64]
    predicted: NDArray[np.int64]
    true: NDArray[np.int64]
    changed: NDArray[np.int64]
    pairs: NDArray[np.int64]
    true_pairs: NDArray[np.int64]
    pixels: NDArray[np.int64]
    matrix: NDArray[np.int64]

    @classmethod
    def of(cls, counts: Counts) -> Block:
        """Return the Block of Counts."""
        codes = [codes_of(place) for place in PLACES]
        places = np.stack([counts.matrix[:, c].sum(1) for c in codes])
        return cls(hits=np.einsum('pmcc->pmc', places).copy(), predicted=places.sum(2),
                   true=places[:, 0].sum(2), matrix=places[0],
                   changed=np.stack([counts.changed[:, c].sum(1) for c in codes]),
                   **{name: np.array([getattr(counts, name)[c].sum() for c in codes])
                      for name in ('pairs', 'true_pairs', 'pixels')})


def stacked(blocks: list[Block], classes: int) -> dict[str, NDArray[np.int64]]:
    """Return the blocks' arrays with the blocks as first axis; matrix is their sum."""
    result = {}
    for name in Block.FIELDS:
        arrays = [getattr(block, name) for block in blocks]
        if name in ('hits', 'predicted', 'true'):
            arrays = [_wide(a, classes, (a.ndim - 1,)) for a in arrays]
        result[name] = np.stack(arrays)
    result['matrix'] = np.zeros((len(blocks[0].matrix), classes, classes), np.int64)
    for block in blocks:
        result['matrix'] += _wide(block.matrix, classes, (1, 2))
    return result


def _wide(array: NDArray[np.int64], size: int, axes: tuple[int, ...]) -> NDArray[np.int64]:
    """Return an array cut or filled up with zeros to *size* along *axes*."""
    shape = [size if a in axes else n for a, n in enumerate(array.shape)]
    result = np.zeros(shape, array.dtype)
    part = tuple(slice(0, min(m, n)) for m, n in zip(shape, array.shape))
    result[part] = array[part]
    return result
