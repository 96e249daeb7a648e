"""One picture of a replay for a README or a talk: a frame as every stage sees it, and the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from persem_ros.errors import PersemError
from persem_ros.outputs.files import write_bytes
from persem_ros.outputs.report import maps
from persem_ros.outputs.report.colors import VERDICT_COLORS
from persem_ros.outputs.report.strip import Strip, verdict
from persem_ros.outputs.report.watcher import offer

if TYPE_CHECKING:
    from persem_ros.core.memory.voxel_memory import VoxelMemory
    from persem_ros.frames import Frame
    from persem_ros.outputs.report.strip import Sample
    from persem_ros.outputs.results.mapped import Overview
    from persem_ros.passes import Replay
    from persem_ros.rendering import Rendering
    from persem_ros.settings.legend import Legend

WIDTH, GAP, TITLE = 1600, 14, 34        # pixels
INK, SOFT, PAPER = (27, 31, 36), (93, 102, 112), (252, 252, 252)
FORMATS = {'.png': (cv2.IMWRITE_PNG_COMPRESSION, 9), '.jpg': (cv2.IMWRITE_JPEG_QUALITY, 92),
           '.webp': (cv2.IMWRITE_WEBP_QUALITY, 92)}


class FigureWatcher:
    """Writes a figure, 1600 pixels wide, of a replay (persem_ros.passes.Replay)."""

    def __init__(self, path: Path | str) -> None:
        self._path = Path(path)
        self._strip: Strip | None = None
        if self._path.suffix.lower() not in FORMATS:
            raise PersemError(f'--figure {path}: expected a name that ends in '
                              f'{" or ".join(FORMATS)}')

    def frame(self, replay: Replay, frame: Frame, rendering: Rendering) -> None:
        """Keep some of the frames."""
        if self._strip is None:
            self._strip = Strip(replay.recording.expected)
        offer(self._strip, replay, frame, rendering)

    def finish(self, replay: Replay, result: dict[str, Any]) -> None:
        """Write the figure."""
        assert self._strip is not None, 'a replay without a frame is refused before its end'
        picture = figure(best(self._strip.chosen()), replay.config.refine.method, replay.legend,
                         replay.pipeline.memory, replay.mapped.overview())
        ending = self._path.suffix.lower()
        if ending == '.png':        # 32 levels a colour look the same and take a third less
            picture = picture & np.uint8(0xf8) | np.uint8(0x04)
        write_bytes(self._path, cv2.imencode(ending, picture[..., ::-1], FORMATS[ending])[1])


def best(samples: list[Sample]) -> Sample:
    """Return the Sample with the largest gain; without truth the one that changed most."""
    def gain(sample: Sample) -> float:
        if 'truth' not in sample.images:
            return float(np.mean(sample.images['refined'] != sample.images['input']))
        _, mended, spoilt = np.bincount(verdict(sample).ravel(), minlength=3).tolist()
        return (mended - spoilt) / max(1, np.count_nonzero(sample.valid))
    return max(samples, key=gain)


def figure(sample: Sample, method: str, legend: Legend, memory: VoxelMemory,
           overview: Overview) -> NDArray[np.uint8]:
    """Return the figure, (H, 1600, 3) uint8 red green blue."""
    panels = _panels(sample, method, legend)
    columns = -(-len(panels) // 2)
    height, width = sample.source.shape
    map_width = round(WIDTH * (0.36 if columns == 3 else 0.45))
    w = (WIDTH - map_width - GAP * (columns + 2)) // columns
    h = round(w * height / width)
    canvas = np.full((2 * (h + TITLE) + GAP, WIDTH, 3), PAPER, np.uint8)
    for k, (title, note, image) in enumerate(panels):
        x, y = GAP + k % columns * (w + GAP), k // columns * (h + TITLE)
        _write(canvas, title, x, y + 24, INK)
        _write(canvas, note, x + w, y + 24, SOFT, right=True)
        canvas[y + TITLE:y + TITLE + h, x:x + w] = cv2.resize(
            image, (w, h), interpolation=cv2.INTER_AREA)
    x = WIDTH - GAP - map_width
    _write(canvas, f'map from above, {overview.sources.sum():,} voxels', x, 24, INK)
    canvas[TITLE:-GAP, x:x + map_width] = _map(map_width, len(canvas) - TITLE - GAP, legend,
                                               memory, overview)
    return canvas


def _panels(
        sample: Sample, method: str, legend: Legend) -> list[tuple[str, str, NDArray[np.uint8]]]:
    """Return (title, note, picture) of image, input, majority, refined, truth and the change."""
    result = [] if sample.color is None else [('image', '', sample.color)]
    for key, title in (('input', 'input labels'), ('majority', 'majority'),
                       ('refined', f'refined ({method})'), ('truth', 'truth')):
        if key in sample.images:
            note = ''
            if 'truth' in sample.images and key != 'truth' and sample.valid.any():
                right = (sample.images[key] == sample.images['truth'])[sample.valid].mean()
                note = f'{100 * right:.0f} % right'
            result.append((title, note, legend.colors(sample.images[key])))
    if 'truth' in sample.images:
        gray = np.zeros(sample.source.shape, np.uint8) if sample.color is None else \
            cv2.cvtColor(sample.color, cv2.COLOR_RGB2GRAY)
        found = verdict(sample)
        palette = np.array([(0, 0, 0), *VERDICT_COLORS], np.uint8)
        change = np.where(found[..., None] > 0, palette[found], (gray // 2 + 40)[..., None])
        result.append(('mended (blue), spoilt (orange)', '', change.astype(np.uint8)))
    return result


def _map(width: int, height: int, legend: Legend, memory: VoxelMemory,
         overview: Overview) -> NDArray[np.uint8]:
    """Return the map from above with the camera's path and a scale bar, (height, width, 3)."""
    canvas = np.full((height, width, 3), (20, 24, 29), np.uint8)
    top = maps.top_view(overview.columns, overview.voxel_size, legend)
    pixels = top['layers'][0]['pixels']
    rgb = np.where(pixels[..., 3:] > 0, pixels[..., :3], canvas[0, 0])
    factor = min(width / top['width'], height / top['height'])
    size = round(top['width'] * factor), round(top['height'] * factor)
    x, y = (width - size[0]) // 2, (height - size[1]) // 2
    canvas[y:y + size[1], x:x + size[0]] = cv2.resize(
        rgb.astype(np.uint8), size,
        interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_NEAREST)
    for track in maps.tracks(memory):
        line = np.rint(maps.on_top(track, top) * size + (x, y)).astype(np.int32)[:, None]
        cv2.polylines(canvas, [line], False, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.polylines(canvas, [line], False, (255, 255, 255), 2, cv2.LINE_AA)
    metres = maps.scale_bar(np.ptp(top['x']))
    end = 14 + round(metres / np.ptp(top['x']) * size[0])
    cv2.rectangle(canvas, (14, height - 16), (end, height - 13), (255, 255, 255), -1)
    _write(canvas, f'{metres:g} m', 14, height - 24, (255, 255, 255))
    return canvas


def _write(canvas: NDArray[np.uint8], text: str, x: int, y: int, color: tuple[int, int, int],
           right: bool = False) -> None:
    """Write text with its lower left (or right) corner at (x, y)."""
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.58
    if right:
        x -= cv2.getTextSize(text, font, scale, 1)[0][0]
    cv2.putText(canvas, text, (x, y), font, scale, color, 1, cv2.LINE_AA)
