"""Label images that show the depth's view cut, squeezed or between borders (labels.fit)."""

import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import Matching, same_aspect
from persem_ros.inputs.decode.messages import BadMessage


def matching(labels: tuple[int, int], depth: tuple[int, int], fit: str) -> Matching | None:
    """
    Return which pixels of a label image and of a depth image belong together.

    Parameters
    ----------
    labels, depth : (int, int)
        Rows and columns.
    fit : str
        The setting labels.fit: 'stretch' (the labels show all of the view, squeezed), 'crop' (its
        middle, not squeezed), 'letterbox' (all of it, with borders on two sides) or 'exact'.

    Returns
    -------
    Matching or None
        None where the sizes have one aspect ratio, whatever *fit*.

    Raises
    ------
    BadMessage
        With 'exact' and another aspect ratio.

    """
    (H, W), (h, w) = labels, depth
    if same_aspect((W, H), (w, h)):
        return None
    if fit == 'exact':
        raise BadMessage('labels and depth differ in shape',
                         f'a label image has the size {W} x {H}, its depth image {w} x {h}, '
                         'expected one aspect ratio; --set labels.fit=stretch where the network '
                         'squeezed the view, crop where it saw its middle, letterbox where it '
                         'added borders')
    scales = H / h, W / w       # label pixels per depth pixel
    if fit != 'stretch':
        scales = (max(scales) if fit == 'crop' else min(scales),) * 2
    rows, columns = (_along(n, m, scale) for n, m, scale in zip(depth, labels, scales))
    back_rows, back_columns = (_along(m, n, 1.0 / scale)
                               for n, m, scale in zip(depth, labels, scales))
    return Matching(_flat(rows, columns, W), _flat(back_rows, back_columns, w))


def _along(n: int, m: int, scale: float) -> NDArray[np.int64]:
    """Return the pixel of an axis of m that each of n shows, centred; -1 outside."""
    at = np.floor((np.arange(n) + 0.5 - n / 2) * scale + m / 2 + 1e-9).astype(np.int64)
    return np.where((at >= 0) & (at < m), at, -1)


def _flat(rows: NDArray[np.int64], columns: NDArray[np.int64], width: int) -> NDArray[np.int32]:
    """Return the numbers of pixels, row by row; -1 where one of the two is."""
    found = rows[:, None] * width + columns[None, :]
    return np.where((rows[:, None] < 0) | (columns[None, :] < 0), -1, found).astype(np.int32)
