"""What the figures show of a sequence: frames where methods differ, the map from above."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.frames import UNKNOWN

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.evaluate.measure.voxel_kinds import Kinds
    from persem_ros.evaluate.work.sequence import Sequence
    from persem_ros.frames import Frame

FRAMES = 4          # kept, one of each part of the flight
WIDTH = 480         # of a panel, pixels, at most
EDGE = 0.25         # of a part, at each end: frames there show what those of the next part do
CELLS = 700         # of the map from above, along its longer side, at most
METHODS = ('raw2d', 'ema2d', 'majority', 'trust', 'context_history', 'persem', 'geometry')


class Panels:
    """
    Of each part of a flight the frame in which the shown methods differ at most pixels.

    Parameters
    ----------
    sequence : sequence.Sequence
        Labelled.
    kinds : evaluate.measure.voxel_kinds.Kinds

    """

    def __init__(self, sequence: Sequence, kinds: Kinds) -> None:
        self._sequence, self._kinds = sequence, kinds
        self.shown = [m for m in METHODS if m in sequence.methods]
        columns = [sequence.methods.index(m) - len(sequence.images) for m in self.shown]
        columns = [c for c in columns if c >= 0]
        classes = kinds.classes[:, columns] if columns else kinds.classes[:, :0]
        self._differ = (classes != classes[:, :1]).any(1) if columns \
            else np.zeros(len(kinds.codes), bool)
        # By part: score, number of the frame, its panels.
        self._kept: dict[int, tuple[int, int, dict[str, NDArray[Any]]]] = {}
        self._number = 0

    def offer(self, frame: Frame, labels: NDArray[np.int32], truth: NDArray[np.int32] | None,
              voxels: NDArray[np.int32], images: list[NDArray[Any]]) -> None:
        """Keep a frame if its methods differ more than in the frame kept of its part."""
        kinds = np.where(voxels >= 0, self._kinds.of[voxels], 0)
        score = int(np.count_nonzero(self._differ[kinds]))
        number, self._number = self._number, self._number + 1
        part, place = divmod(FRAMES * (number + 0.5) / self._sequence.frames, 1)
        if self._sequence.frames >= 4 * FRAMES and not EDGE <= place <= 1 - EDGE:
            return
        if part not in self._kept or self._kept[int(part)][0] < score:
            self._kept[int(part)] = (score, number,
                                     self._panels(frame, labels, truth, voxels, images))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the panels as {'panel/<frame>/<what>': image}, in order of the frames."""
        return {f'panel/{number}/{what}': image for _, number, panels in (
            self._kept[part] for part in sorted(self._kept)) for what, image in panels.items()}

    def _panels(
            self, frame: Frame, labels: NDArray[np.int32], truth: NDArray[np.int32] | None,
            voxels: NDArray[np.int32], images: list[NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return the images of one frame by what they show, class ids as uint16."""
        step = -(-labels.shape[1] // WIDTH)
        here = (slice(None, None, step),) * 2
        panels: dict[str, NDArray[Any]] = {}
        if frame.color is not None:
            panels['color'] = _small(frame.color)
        if truth is not None:
            panels['truth'] = ids(truth[here])
        for name, image in zip(self._sequence.images, images):
            if name in self.shown:
                panels[name] = ids(image[here])
        voxels, labels = voxels[here], labels[here]
        moving = np.isin(labels, [c for c in self._sequence.task.config.memory.dynamic_labels
                                  if c >= 0])
        for name in self.shown:
            if name not in panels:
                of = self._sequence.labels_of(name)
                image = np.where(voxels >= 0, of[voxels], np.uint16(UNKNOWN))
                panels[name] = np.where(moving, labels, image).astype(np.uint16)
        return panels


def ids(image: NDArray[Any]) -> NDArray[np.uint16]:
    """Return labels as uint16, UNKNOWN for what is no id."""
    return np.where((image < 0) | (image > UNKNOWN), UNKNOWN, image).astype(np.uint16)


def top_view(memory: VoxelMemory, labels: NDArray[np.uint16], sources: NDArray[np.uint8],
             entropy: NDArray[np.float32], switch_rate: NDArray[np.float32]
             ) -> dict[str, NDArray[Any]]:
    """
    Return the map from above: of each column of voxels the top-most one.

    Returns
    -------
    dict
        'top/label' uint16 (UNKNOWN: nothing there), 'top/source' uint8, 'top/entropy' (nat) and
        'top/switch_rate' float32, each (rows, columns), y up; 'top/extent': left, right, bottom,
        top in metres.

    """
    columns = memory.voxels()
    at, number = columns['voxel'].astype(np.int64), columns['number']
    low, high = (np.quantile(at[:, :2], q, axis=0, method='nearest') for q in (0.001, 0.999))
    inside = np.all((at[:, :2] >= low) & (at[:, :2] <= high), axis=1)
    at, number = at[inside], number[inside]
    scale = int(-(-(high - low + 1).max() // CELLS))
    cell = (at[:, :2] - low) // scale
    width, height = ((high - low) // scale + 1).tolist()
    voxel = np.full((height, width), -1, np.int64)
    order = np.argsort(at[:, 2], kind='stable')         # written last: the highest
    voxel[height - 1 - cell[order, 1], cell[order, 0]] = number[order]
    known, size = voxel >= 0, memory.voxel_size
    return {'top/label': np.where(known, labels[voxel], np.uint16(UNKNOWN)),
            'top/source': sources[voxel], 'top/entropy': entropy[voxel],
            'top/switch_rate': switch_rate[voxel],
            'top/extent': np.array([low[0], low[0] + width * scale, low[1],
                                    low[1] + height * scale]) * size}


def _small(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a colour image (h, w, 3) at the width of a panel."""
    height, width = color.shape[:2]
    if width <= WIDTH:
        return np.ascontiguousarray(color)
    return np.asarray(cv2.resize(color, (WIDTH, round(height * WIDTH / width)),
                                 interpolation=cv2.INTER_AREA), np.uint8)
